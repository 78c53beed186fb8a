// Times the stages of a job and passes their progress on.
#pragma once

#include <chrono>
#include <string>

#include "freetalk/talker/face.h"

namespace freetalk::talker {

class Stages {
 public:
  Stages(const Progress& progress, Report& report) : progress_(progress), report_(report) {}

  void begin(const std::string& stage) {
    end();
    stage_ = stage;
    start_ = std::chrono::steady_clock::now();
    at(0);
  }
  void at(double fraction) const {
    if (progress_) progress_(stage_, fraction);
  }
  void end() {
    if (stage_.empty()) return;
    at(1);
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - start_;
    report_.timings.push_back({stage_, passed.count()});
    stage_.clear();
  }

 private:
  const Progress& progress_;
  Report& report_;
  std::string stage_;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace freetalk::talker
