#include "gltf_tracks.h"

#include <ATen/ATen.h>

#include "gltf_parts.h"
#include "head_track.h"

namespace freetalk::animation {

void GltfTracks::add(int64_t node, const char* path, const at::Tensor& values, const char* type) {
  if (times_ < 0) {
    const auto times =
        at::arange(animation_.num_frames(), at::kDouble).div(animation_.fps).to(at::kFloat);
    times_ = buffer_.add(times.view({-1, 1}), {"SCALAR", 0, true});
  }
  const int output = buffer_.add(values, {type});
  const Json target = {{"node", node}, {"path", path}};
  channels_.push_back({{"sampler", samplers_.size()}, {"target", target}});
  samplers_.push_back({{"input", times_}, {"interpolation", "LINEAR"}, {"output", output}});
}

Json GltfTracks::json() const {
  return {{"name", "talk"},
          {"samplers", samplers_},
          {"channels", channels_},
          {"extras", {{"generator", kGenerator}}}};
}

void GltfTracks::add_head(int64_t node, const MeshFrame& frame) {
  const HeadTrack head = head_track(animation_.head, frame);
  add(node, "rotation", head.turns, "VEC4");
  add(node, "translation", head.shifts, "VEC3");
}

}  // namespace freetalk::animation
