// The networks of a talker, for those who bring their own; everyone else needs talker.h alone.
#pragma once

#include <Eigen/Core>

#include "freetalk/ats/ats.h"
#include "freetalk/ats/generate.h"
#include "freetalk/facetalk/facetalk.h"
#include "freetalk/facetalk/generate.h"
#include "freetalk/head/parametric_head.h"
#include "freetalk/rig/face_rig.h"
#include "freetalk/speech/encoder.h"
#include "freetalk/stm/stm.h"

namespace freetalk::talker {

/// Samples of the mean face in the canonical frame, used for alignment and to tell parts apart.
struct Template {
  Eigen::MatrixXd points;       // (P, 3) m
  Eigen::MatrixXd normals;      // (P, 3)
  Eigen::MatrixXd landmarks68;  // (68, 3) m
  Eigen::MatrixXd outward68;    // (68, 3) normals there; zero where unknown
};

/// How FaceTalk's motion is sampled and used.
struct CodeMotionOptions : facetalk::GenerateOptions {
  double articulation = 1.0;  // in (0, 3], gain of the mouth's motion, see ats::articulate()
  CodeMotionOptions() {
    sampler = "dpmpp";
    num_steps = 20;
  }
  template <class V>
  void fields(V& v) {
    facetalk::GenerateOptions::fields(v);
    v("articulation", articulation);
  }
  void check() const;
};

struct TalkerModels {
  speech::SpeechEncoder speech{nullptr};
  ats::Ats ats{nullptr};
  facetalk::FaceTalk facetalk{nullptr};  // of AnimateOptions::motion "facetalk"; empty: none
  stm::Stm stm{nullptr};
  head::ParametricHead head{nullptr};  // of FaceOptions::engine "head", on the CPU; empty: none
  Template face;
  ats::GenerateOptions generate;  // the weights' own sampling options
  CodeMotionOptions code_motion;  // and what they say of AnimateOptions::motion "facetalk"
  rig::RigPoses rig;              // of the rigs of faces; without names: none
};

}  // namespace freetalk::talker
