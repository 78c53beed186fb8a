// Speech and a face mesh of any topology in, a talking face out: the whole pipeline behind one
// object.
//
//   mesh -> canonical frame -> parts -> surface operators -> STM's features: a Face, once
//   speech -> features at the model's rate -> ATS -> landmark motion -> fps -> STM, frame by frame
//   -> parts -> mesh unit: an Animation, for each clip
#pragma once

#include <c10/core/Device.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "freetalk/talker/face.h"
#include "freetalk/talker/options.h"

namespace freetalk::talker {

struct TalkerModels;

/// The weights. Immutable: a copy is cheap and shares them, and all methods may be called from many
/// threads at once, on the CPU with the bits that one thread would get (on a GPU up to rounding).
class Talker {
 public:
  /// Reads talker.json, speech/, ats/, stm/ and template.safetensors, and facetalk/ and head/ where
  /// there are such.
  /// @param device nothing: the GPU if there is one.
  /// @throws std::runtime_error naming the file that is missing, broken or doesn't fit.
  static Talker from_pretrained(const std::filesystem::path& directory,
                                std::optional<c10::Device> device = std::nullopt);
  /// @param models see talker/models.h; moved to `device`, put into evaluation mode, and not to be
  /// changed afterwards.
  /// @throws std::invalid_argument where one is missing; std::runtime_error for a device that is
  /// not there.
  explicit Talker(TalkerModels models, c10::Device device = c10::kCPU);

  /// Everything that depends on the mesh alone: for several clips, seeds or live speech on one
  /// mesh.
  /// @param landmarks (68, 3) where they are, in the mesh's own unit and axes; empty: taken where
  /// the mean face has them.
  /// @throws std::invalid_argument for options out of range, landmarks of another shape or a
  /// surface without area; whatever `progress` throws.
  Face prepare(const mesh::Mesh& mesh, const FaceOptions& options = {},
               const Progress& progress = {}, const Eigen::MatrixXd& landmarks = {}) const;

  /// The code of a new identity of the weights' parametric head, (identity_dim,): the same for the
  /// same seed. @throws std::invalid_argument for weights without a head.
  at::Tensor sample_identity(uint64_t seed) const;

  /// A head that no mesh was given for: the surface of an identity of the weights' parametric head,
  /// in metres, +Y up, +Z out of the face. Include talker/models.h for the head and its codes.
  /// @param z_id (identity_dim,). @param resolution cells along each axis of the head's box, see
  /// head::SurfaceOptions.
  /// @throws std::invalid_argument for weights without a head, a code of another size, options out
  /// of range; std::runtime_error where the code has no surface.
  Face prepare_head(const at::Tensor& z_id, int64_t resolution = 128,
                    const FaceOptions& options = {}, const Progress& progress = {}) const;

  /// prepare() and Face::animate() in one call. @param report filled if given.
  animation::Animation animate(const audio::Audio& audio, const mesh::Mesh& mesh,
                               const TalkerOptions& options = {}, const Progress& progress = {},
                               Report* report = nullptr) const;
  /// prepare() and Face::animate_many() in one call.
  std::vector<animation::Animation> animate_many(const audio::Audio& audio, const mesh::Mesh& mesh,
                                                 const std::vector<int64_t>& seeds,
                                                 const TalkerOptions& options = {},
                                                 const Progress& progress = {},
                                                 Report* report = nullptr) const;

  /// Face::live(), on a face that this talker (or a copy of it) prepared; include talker/live.h.
  /// @throws std::invalid_argument for a face of other weights; what Live throws.
  Live live(const Face& face, const LiveOptions& options) const;

  /// How the mesh lies relative to the canonical frame.
  geometry::Alignment align(const mesh::Mesh& mesh,
                            const geometry::AlignOptions& options = {}) const;

  const std::vector<std::string>& emotions() const;
  /// The strongest intensity; the slightest is 1.
  double max_intensity() const;
  c10::Device device() const { return device_; }
  const TalkerModels& models() const { return *models_; }

 private:
  std::shared_ptr<const TalkerModels> models_;
  c10::Device device_;
};

}  // namespace freetalk::talker

namespace freetalk {
using talker::Face;
using talker::Talker;
using talker::TalkerOptions;
}  // namespace freetalk
