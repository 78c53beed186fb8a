// The animation that a glTF file gets: channels that share the times of all frames.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

#include "freetalk/animation/animation.h"
#include "gltf_file.h"

namespace freetalk::animation {

class GltfTracks {
 public:
  GltfTracks(GltfBuffer& buffer, const Animation& animation)
      : buffer_(buffer), animation_(animation) {}

  /// @param values (T, K) float32. @param type of the accessor, "SCALAR" for weights.
  void add(int64_t node, const char* path, const at::Tensor& values, const char* type);
  /// Rotation and translation of the head. @param frame from the mesh's unit and axes to the
  /// file's.
  void add_head(int64_t node, const MeshFrame& frame);

  bool empty() const { return channels_.empty(); }
  Json json() const;

 private:
  GltfBuffer& buffer_;
  const Animation& animation_;
  Json samplers_ = Json::array(), channels_ = Json::array();
  int times_ = -1;  // accessor
};

}  // namespace freetalk::animation
