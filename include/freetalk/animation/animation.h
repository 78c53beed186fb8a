// A talking mesh: rest surface, one displacement per vertex and frame, the speech it was made from.
//
// Written by extension, of any case: .npz (everything, for NumPy), .glb and .gltf (morph targets,
// for viewers and DCC tools), .usda (blend shapes), .pc2 (the vertices of every frame, for
// Blender's Mesh Cache), "folder/*.obj" and "folder/*.ply" (one mesh per frame). Every write is
// atomic.
#pragma once

#include <ATen/core/Tensor.h>
#include <Eigen/Core>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "freetalk/animation/morph.h"
#include "freetalk/audio/audio.h"
#include "freetalk/mesh/mesh.h"

namespace freetalk::animation {

/// How the mesh's own unit and axes lie in the world.
struct MeshFrame {
  double metres_per_unit = 1.0;
  Eigen::Matrix3d to_y_up = Eigen::Matrix3d::Identity();  // mesh axes -> +Y up, +Z out of the face
};

struct SaveOptions {
  std::string format;  // "npz", "glb", "gltf", "usda", "pc2", "obj", "ply"; empty: from
                       // the path
  int64_t max_morph_targets = 256;  // glTF, USD: at most this many beside given shapes, 2 ... 1024
  double morph_tolerance_mm =
      0.1;               // glTF, USD: largest vertex error at which no further target is added, > 0
  bool normals = true;   // glTF, USD: what each target does to the normals
  bool sound = true;     // glTF, USD: the speech beside as NAME.speech.wav; in the file of a .glb
  bool compact = false;  // glTF: 16-bit vertices and targets (KHR_mesh_quantization), half the
                         // size; not where the mesh's own glTF is written into

  template <class V>
  void fields(V& v) {
    v("format", format);
    v("max_morph_targets", max_morph_targets);
    v("morph_tolerance_mm", morph_tolerance_mm);
    v("normals", normals);
    v("sound", sound);
    v("compact", compact);
  }
  void check() const;
};

/// What was written.
struct SaveReport {
  std::string format;
  int64_t num_files = 1;
  int64_t num_morph_targets = 0;  // glTF and USD only
  double morph_error_mm = 0.0;    // glTF and USD only: largest vertex error over all frames
  bool into_source = false;       // glTF only: the mesh's own file with the motion added
};

/// Called with the finished share in [0, 1]. Whatever it throws ends the work: nothing is written.
using SaveProgress = std::function<void(double)>;

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
  at::Tensor landmarks;  // (T, 68, 3) float32 displacements in the canonical frame, m, of which the
                         // motion was made; undefined if not known

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
  ///
  /// glTF of a mesh that was read from glTF is that file with the motion added: its nodes, skins,
  /// materials and textures stay. Otherwise materials, textures and vertex colours come from the
  /// mesh's OBJ or PLY (mesh/appearance.h).
  /// @param shapes glTF, USD: named targets that the motion is made of as far as they go, such as
  /// talker::Face::blend_shapes() gives; the leading components of what they leave come after.
  /// @throws std::invalid_argument for an unknown extension; std::runtime_error naming the path if
  /// it can't be written: nothing half-written stays behind.
  SaveReport save(const std::filesystem::path& path, const SaveOptions& options = {},
                  const BlendShapes& shapes = {}, const SaveProgress& progress = {}) const;
};

/// Reads what Animation::save wrote as .npz.
/// @throws std::runtime_error naming the file when it is missing, truncated or of another content.
Animation load_npz(const std::filesystem::path& path);

/// Reads the animation of morph targets of a .glb or .gltf, of ours or any, with embedded sound if
/// it is ours; what a node that carries the whole mesh does is the head's motion. Vertices are
/// those of load_mesh: in the scene's metres and axes.
/// @param fps of the result; 0: that of our files, 30 for others.
/// @throws std::runtime_error naming the file when it can't be read or nothing moves in it.
Animation load_gltf(const std::filesystem::path& path, double fps = 0.0);

/// Reads a .pc2 cache of a mesh. @throws std::runtime_error naming the file when it is damaged or
/// of another number of vertices.
Animation load_pc2(const std::filesystem::path& path, const mesh::Mesh& mesh, double fps = 30.0);

/// Reads the meshes of a folder in the order of their names as frames; the first is the rest.
/// @throws std::runtime_error naming the file that differs in its vertices' number.
Animation load_sequence(const std::filesystem::path& folder, double fps = 30.0);

}  // namespace freetalk::animation
