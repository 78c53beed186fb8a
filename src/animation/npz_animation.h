// An animation as one .npz.
#pragma once

#include <filesystem>

#include "freetalk/animation/animation.h"

namespace freetalk::animation {

/// Keys: vertices (V, 3) f8, faces (F, 3) i4, displacements (T, V, 3) f4, fps, audio (S,) f4,
/// sample_rate_hz, metadata (JSON text), name, metres_per_unit, to_y_up (3, 3); where the mesh has
/// them polygon_sizes, polygon_vertices, texcoords (Vt, 2) f8, texcoord_sizes, polygon_texcoords.
void save_npz(const std::filesystem::path& path, const Animation& animation);

}  // namespace freetalk::animation
