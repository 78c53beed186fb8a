// Which vertices of a mesh read from glTF stand for which accessor of its file.
#pragma once

#include <Eigen/Geometry>

#include <cstdint>
#include <vector>

#include "mesh/gltf_buffers.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {

/// One primitive as a node shows it.
struct GltfPart {
  int64_t node = -1;  ///< -1 in a file without nodes
  int64_t mesh = 0;
  int64_t primitive = 0;
  int64_t positions = 0;   ///< accessor; parts of one node that share it share their vertices
  int first_vertex = 0;    ///< of the mesh as read
  Eigen::Matrix3d linear;  ///< from the accessor's axes and unit to those of the mesh as read
};

/// The mesh that the scene shows, as load_mesh reads it. @param parts filled if given.
/// @throws std::runtime_error naming the file, or json::exception.
RawMesh read_gltf_scene(const GltfDocument& document, std::vector<GltfPart>* parts = nullptr);

}  // namespace freetalk::mesh
