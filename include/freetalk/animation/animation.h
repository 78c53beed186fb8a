// A talking mesh: rest surface, one displacement per vertex and frame, the speech it was made from.
//
// Written by extension: .npz (everything, for NumPy), .glb and .gltf (morph targets, for viewers
// and DCC tools), "folder/*.obj" and "folder/*.ply" (one mesh per frame). Every write is atomic.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <cstdint>
#include <filesystem>
#include <string>

#include "freetalk/audio/audio.h"
#include "freetalk/mesh/mesh.h"

namespace freetalk::animation {

/// How the mesh's own unit and axes lie in the world.
struct MeshFrame {
  double metres_per_unit = 1.0;
  Eigen::Matrix3d to_y_up = Eigen::Matrix3d::Identity();  // mesh axes -> +Y up, +Z out of the face
};

struct SaveOptions {
  std::string format;               // "npz", "glb", "gltf", "obj", "ply"; empty: from the path
  int64_t max_morph_targets = 128;  // glTF: at most this many, 2 ... 1024
  double morph_tolerance_mm =
      0.05;  // glTF: largest vertex error at which no further target is added, > 0

  template <class V>
  void fields(V& v) {
    v("format", format);
    v("max_morph_targets", max_morph_targets);
    v("morph_tolerance_mm", morph_tolerance_mm);
  }
  void check() const;
};

/// What was written.
struct SaveReport {
  std::string format;
  int64_t num_files = 1;
  int64_t num_morph_targets = 0;  // glTF only
  double morph_error_mm = 0.0;    // glTF only: largest vertex error over all frames
};

struct Animation {
  mesh::Mesh mesh;
  at::Tensor displacements;  // (T, V, 3) float32, in the mesh's own unit and axes; frame t is shown
                             // at t / fps
  double fps = 30.0;
  audio::Audio audio;  // may be empty
  std::string metadata_json = "{}";
  MeshFrame frame;
  at::Tensor head;  // (T, 4, 4) float64 rigid motion [R t; 0 1] of the whole mesh, in its own unit
                    // and axes: a vertex is at R (v + d) + t; undefined: the head stays still

  int64_t num_frames() const { return displacements.defined() ? displacements.size(0) : 0; }
  double duration_s() const { return static_cast<double>(num_frames()) / fps; }

  /// (V, 3) vertex positions of a frame, the head's motion included. @throws std::invalid_argument
  /// if there is no such frame.
  Eigen::MatrixXd vertices_at(int64_t frame_index) const;

  /// @throws std::invalid_argument naming what does not fit: shapes, type, fps, metadata that is no
  /// JSON object.
  void check() const;

  /// Writes `path` by its extension; "folder/*.obj" or "folder/*.ply" (or a folder with format
  /// "obj" or "ply") writes frame_00000.obj ... into the folder. Files of an earlier, longer
  /// sequence there are removed.
  /// @throws std::invalid_argument for an unknown extension; std::runtime_error naming the path if
  /// it can't be
  ///   written: nothing half-written stays behind.
  SaveReport save(const std::filesystem::path& path, const SaveOptions& options = {}) const;
};

/// Reads what Animation::save wrote as .npz.
/// @throws std::runtime_error naming the file when it is missing, truncated or of another content.
Animation load_npz(const std::filesystem::path& path);

}  // namespace freetalk::animation
