#include "freetalk/rig/face_rig.h"

#include <ATen/ATen.h>
#include <torch/torch.h>

#include "face_state.h"
#include "freetalk/core/error.h"
#include "geometry/content_hash.h"
#include "head_decoder.h"

namespace freetalk::talker {
namespace {

/// What tells the decoding of a face from that of any other.
std::string content_of(const Face::State& face) {
  geometry::ContentHash hash;
  const auto add = [&hash](const void* data, size_t bytes) {
    hash.update(&bytes, sizeof(bytes));
    hash.update(data, bytes);
  };
  const auto add_parameters = [&add](const torch::nn::Module& model) {
    for (const at::Tensor& parameter : model.parameters()) {
      const at::Tensor values = parameter.detach().to(at::kCPU).contiguous();
      add(values.const_data_ptr(), values.nbytes());
    }
  };
  add_parameters(*face.models->stm);
  const Eigen::MatrixXd& vertices = face.parts->face_vertices();
  const Eigen::MatrixXi& faces = face.parts->face_faces();
  add(vertices.data(), static_cast<size_t>(vertices.size()) * sizeof(double));
  add(faces.data(), static_cast<size_t>(faces.size()) * sizeof(int));
  if (face.follower) {
    for (const at::Tensor& part : {face.follower->weights(), face.follower->lengths()}) {
      const at::Tensor values = part.to(at::kCPU).contiguous();
      add(values.const_data_ptr(), values.nbytes());
    }
  }
  add(face.options.precision.data(), face.options.precision.size());
  if (const auto* head = dynamic_cast<const HeadDecoder*>(face.decoder.get())) {
    add_parameters(*head->head().head());
    const at::Tensor z_id = head->head().z_id().contiguous();
    add(z_id.const_data_ptr(), z_id.nbytes());
  }
  return hash.hex();
}

}  // namespace

const rig::FaceRig& Face::State::rig(const std::function<void(double)>& progress) const {
  FREETALK_RUNTIME_CHECK(!models->rig.names.empty(),
                         "these weights hold no rig_poses.safetensors, of which rigs are made");
  std::call_once(lazy_rig->once, [&] {
    const torch::NoGradGuard no_grad;
    const rig::FaceRig::Decode decode = [this](const at::Tensor& landmarks) {
      return decoder->fastest().decode(landmarks.to(device));
    };
    const auto& folder = options.cache_dir;
    lazy_rig->made = std::make_unique<const rig::FaceRig>(
        folder ? rig::FaceRig::cached(content_of(*this), *folder == "auto" ? "" : *folder, decode,
                                      models->rig, {}, progress)
               : rig::FaceRig::build(decode, models->rig, {}, progress));
  });
  return *lazy_rig->made;
}

const rig::FaceRig& Face::rig(const Progress& progress) const {
  return state_->rig([&progress](double share) {
    if (progress) progress("rig", share);
  });
}

animation::BlendShapes Face::blend_shapes(const animation::Animation& animation,
                                          const Progress& progress) const {
  FREETALK_CHECK(animation.landmarks.defined(),
                 "the animation doesn't say of which landmarks it was made");
  const torch::NoGradGuard no_grad;
  const rig::FaceRig& made = rig(progress);
  const int64_t count = made.num_shapes();
  animation::BlendShapes result;
  result.names.assign(made.names().begin(), made.names().begin() + count);
  result.targets = state_->in_mesh(made.targets().narrow(0, 0, count), state_->models->rig.shapes);
  result.weights =
      made.solve(state_->carried(animation.landmarks)).narrow(1, 0, count).contiguous();
  return result;
}

}  // namespace freetalk::talker
