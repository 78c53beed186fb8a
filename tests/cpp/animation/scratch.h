// A folder for one test, removed afterwards, and small meshes.
#pragma once

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "freetalk/animation/animation.h"

namespace freetalk::animation::testing {

class ScratchFolder {
 public:
  ScratchFolder() {
    const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
    path_ = std::filesystem::temp_directory_path() /
            (std::string("freetalk_") + test->test_suite_name() + "_" + test->name());
    std::filesystem::remove_all(path_);
    std::filesystem::create_directories(path_);
  }
  ~ScratchFolder() { std::filesystem::remove_all(path_); }
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  /// Everything in the folder, hidden files included.
  int64_t count() const {
    return std::distance(std::filesystem::recursive_directory_iterator(path_), {});
  }

 private:
  std::filesystem::path path_;
};

/// Two quads side by side whose shared edge is a texture seam.
inline mesh::Mesh seam_mesh() {
  Eigen::MatrixXd vertices(6, 3);
  vertices << 0, 0, 0, 1, 0, 0, 2, 0, 0, 0, 1, 0, 1, 1, 0, 2, 1, 0;
  Eigen::MatrixXd texcoords(8, 2);
  texcoords << 0, 0, 0.4, 0, 0.4, 1, 0, 1, 0.6, 0, 1, 0, 1, 1, 0.6, 1;
  return mesh::make_mesh(vertices, {{0, 1, 4, 3}, {1, 2, 5, 4}}, texcoords,
                         {{0, 1, 2, 3}, {4, 5, 6, 7}}, "two quads");
}

inline Animation seam_animation(int64_t frames) {
  Animation animation;
  animation.mesh = seam_mesh();
  animation.displacements = at::randn({frames, 6, 3}, at::detail::createCPUGenerator(3)) * 0.01;
  animation.fps = 25;
  animation.audio = {{0.5f, -0.25f, 0.125f}, 8000};
  animation.metadata_json = R"({"emotion":"gl\u00fccklich"})";
  animation.frame.metres_per_unit = 0.01;
  return animation;
}

}  // namespace freetalk::animation::testing
