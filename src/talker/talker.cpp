#include "freetalk/talker/talker.h"

#include <torch/torch.h>

#include "face_state.h"
#include "freetalk/core/error.h"
#include "freetalk/core/random.h"
#include "freetalk/core/torch_error.h"
#include "freetalk/talker/models.h"
#include "head_face.h"
#include "motion.h"

namespace freetalk::talker {

Talker::Talker(TalkerModels models, c10::Device device) : device_(device) {
  core::with_plain_errors("Talker", [&] {
    FREETALK_CHECK(models.speech && models.ats && models.stm,
                   "Talker needs a speech encoder, an ATS and an STM");
    const auto settle = [&](torch::nn::Module& model) {
      model.to(device);
      model.eval();
    };
    settle(*models.speech);
    settle(*models.ats);
    settle(*models.stm);
    if (models.facetalk) settle(*models.facetalk);
    if (models.head) models.head->eval();
    models_ = std::make_shared<const TalkerModels>(std::move(models));
  });
}

const std::vector<std::string>& Talker::emotions() const {
  return models_->ats->options().emotions;
}

double Talker::max_intensity() const {
  return static_cast<double>(models_->ats->options().num_intensities);
}

geometry::Alignment Talker::align(const mesh::Mesh& mesh,
                                  const geometry::AlignOptions& options) const {
  return geometry::align_to_template(mesh.vertices, mesh.faces, models_->face.points,
                                     models_->face.normals, options);
}

Face Talker::prepare(const mesh::Mesh& mesh, const FaceOptions& options, const Progress& progress,
                     const Eigen::MatrixXd& landmarks) const {
  return Face(core::with_plain_errors("prepare", [&] {
    return Face::State::prepare(models_, device_, mesh, options, progress, landmarks);
  }));
}

at::Tensor Talker::sample_identity(uint64_t seed) const {
  const torch::NoGradGuard no_grad;
  check_head(*models_);
  head::ParametricHead head = models_->head;
  return head->sample_identity(1, core::make_generator(seed))[0];
}

Face Talker::prepare_head(const at::Tensor& z_id, int64_t resolution, const FaceOptions& options,
                          const Progress& progress) const {
  return Face(core::with_plain_errors("prepare_head", [&] {
    return Face::State::of_head(models_, z_id, resolution, options, progress);
  }));
}

animation::Animation Talker::animate(const audio::Audio& audio, const mesh::Mesh& mesh,
                                     const TalkerOptions& options, const Progress& progress,
                                     Report* report) const {
  return animate_many(audio, mesh, {options.seed}, options, progress, report).front();
}

std::vector<animation::Animation> Talker::animate_many(
    const audio::Audio& audio, const mesh::Mesh& mesh, const std::vector<int64_t>& seeds,
    const TalkerOptions& options, const Progress& progress, Report* report) const {
  check_performance(audio, seeds, options, options.precision, *models_);
  const Face face = prepare(mesh, options, progress);
  auto animations = face.animate_many(audio, seeds, options, progress, report);
  if (report != nullptr) {
    const auto& prepared = face.report().timings;
    report->timings.insert(report->timings.begin(), prepared.begin(), prepared.end());
  }
  return animations;
}

}  // namespace freetalk::talker
