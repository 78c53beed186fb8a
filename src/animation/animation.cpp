#include "freetalk/animation/animation.h"

#include <ATen/ATen.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>

#include "core/file.h"
#include "core/scratch.h"
#include "freetalk/core/conventions.h"
#include "freetalk/core/error.h"
#include "freetalk/core/torch_error.h"
#include "gltf.h"
#include "npz_animation.h"
#include "sound.h"
#include "usda.h"
#include "vertex_files.h"

namespace freetalk::animation {
namespace {

constexpr const char* kKnown =
    ".npz, .glb, .gltf, .usda, .pc2, folder/*.obj or folder/*.ply (more through the Python "
    "package)";
const std::vector<std::string> kFiles = {"npz", "glb", "gltf", "usda", "pc2"};

bool is_pattern(const std::filesystem::path& path) { return path.stem() == "*"; }

}  // namespace

void SaveOptions::check() const {
  const bool known = format.empty() || format == "obj" || format == "ply" ||
                     std::find(kFiles.begin(), kFiles.end(), format) != kFiles.end();
  FREETALK_CHECK(known, "unknown format '", format,
                 "'; known are npz, glb, gltf, usda, pc2, obj, ply");
  FREETALK_CHECK(max_morph_targets >= 2 && max_morph_targets <= 1024,
                 "max_morph_targets must be 2 ... 1024, found ", max_morph_targets);
  FREETALK_CHECK(morph_tolerance_mm > 0, "morph_tolerance_mm must be positive, found ",
                 morph_tolerance_mm);
}

Eigen::MatrixXd Animation::vertices_at(int64_t frame_index) const {
  FREETALK_CHECK(frame_index >= 0 && frame_index < num_frames(), "there is no frame ", frame_index,
                 "; the animation has ", num_frames());
  const auto moved = displacements[frame_index].contiguous();
  using Rows = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  Eigen::MatrixXd vertices =
      mesh.vertices +
      Eigen::Map<const Rows>(moved.data_ptr<float>(), moved.size(0), 3).cast<double>();
  core::release_pages(moved);
  if (head.defined()) {
    using Pose = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
    const Pose pose = Eigen::Map<const Pose>(head.const_data_ptr<double>() + 16 * frame_index);
    const Eigen::MatrixXd turned = vertices * pose.topLeftCorner<3, 3>().transpose();
    vertices = turned.rowwise() + pose.topRightCorner<3, 1>().transpose();
  }
  return vertices;
}

void Animation::check() const {
  FREETALK_CHECK(displacements.defined() && displacements.dim() == 3 && displacements.size(0) > 0 &&
                     displacements.size(2) == 3,
                 "displacements must be (T, V, 3) with T > 0");
  FREETALK_CHECK(displacements.size(1) == mesh.num_vertices(), "displacements move ",
                 displacements.size(1), " vertices; the mesh has ", mesh.num_vertices());
  FREETALK_CHECK(displacements.scalar_type() == at::kFloat && displacements.device().is_cpu() &&
                     displacements.is_contiguous(),
                 "displacements must be contiguous float32 on the CPU");
  FREETALK_CHECK(!head.defined() || (head.sizes() == at::IntArrayRef({num_frames(), 4, 4}) &&
                                     head.scalar_type() == at::kDouble && head.device().is_cpu() &&
                                     head.is_contiguous()),
                 "head must be (", num_frames(), ", 4, 4), contiguous float64 on the CPU");
  FREETALK_CHECK(std::isfinite(fps) && fps > 0, "fps must be positive, found ", fps);
  FREETALK_CHECK(!landmarks.defined() ||
                     (landmarks.dim() == 3 && landmarks.size(0) == num_frames() &&
                      landmarks.size(1) == core::kNumLandmarks && landmarks.size(2) == 3 &&
                      landmarks.scalar_type() == at::kFloat && landmarks.device().is_cpu()),
                 "landmarks must be (", num_frames(), ", ", core::kNumLandmarks,
                 ", 3) float32 on the CPU");
  FREETALK_CHECK(std::isfinite(frame.metres_per_unit) && frame.metres_per_unit > 0,
                 "metres_per_unit must be positive, found ", frame.metres_per_unit);
  FREETALK_CHECK(nlohmann::json::parse(metadata_json, nullptr, false).is_object(),
                 "metadata must be a JSON object, found ", metadata_json);
}

SaveReport Animation::save(const std::filesystem::path& path, const SaveOptions& options,
                           const BlendShapes& shapes, const SaveProgress& progress) const {
  return core::with_plain_errors("save", [&] {
    options.check();
    check();
    const std::string extension = core::lower_extension(path);
    const std::string format = options.format.empty() ? extension : options.format;
    if (format == "obj" || format == "ply") {
      FREETALK_CHECK(is_pattern(path) || extension != format, path.string(),
                     ": a sequence has one file a frame; give a folder, ",
                     (path.parent_path() / path.stem() / "*").string(), ".", format);
      const auto folder = is_pattern(path) ? path.parent_path() : path;
      return save_sequence(folder, format, *this, progress);
    }
    FREETALK_CHECK(std::find(kFiles.begin(), kFiles.end(), format) != kFiles.end(), path.string(),
                   ": can't tell the format from '", path.extension().string(), "'; known are ",
                   kKnown);
    FREETALK_CHECK(extension == format, path.string(), ": format ", format,
                   " needs a path ending in .", format);
    if (format == "pc2") return save_pc2(path, *this, progress);
    if (format == "npz") {
      save_npz(path, *this);
      return SaveReport{"npz"};
    }
    const double tolerance = options.morph_tolerance_mm / (1e3 * frame.metres_per_unit);
    const BlendShapes all =
        blend_shapes(displacements, shapes, tolerance, options.max_morph_targets);
    if (progress) progress(0.5);
    SaveReport report = format == "usda" ? save_usda(path, *this, all, options)
                                         : save_gltf(path, *this, all, options);
    if (options.sound && !audio.samples.empty()) {
      audio::save_wav(sound_beside(path), audio);
      ++report.num_files;
    }
    if (progress) progress(1.0);
    return report;
  });
}

}  // namespace freetalk::animation
