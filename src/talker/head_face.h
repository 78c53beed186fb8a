// Faces of the head engine: a mesh that a parametric head is fitted to, and a head by itself.
#pragma once

#include <memory>

#include "face_state.h"
#include "stages.h"

namespace freetalk::talker {

/// The head that fits the skin best moves it, its landmarks as the face's follower has them. A
/// notice says how far the two are apart.
/// @param face with its alignment, parts and follower. @throws std::invalid_argument for a mesh
/// that has nothing where the head is.
std::unique_ptr<const stm::LandmarkDecoder> head_of_mesh(const Face::State& face, Report& report,
                                                         const Stages& stages);

/// What of these weights a head needs. @throws std::invalid_argument for weights without it.
void check_head(const TalkerModels& models);

}  // namespace freetalk::talker
