// What a mesh is like, defect by defect: nothing is repaired, everything is counted.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <string>
#include <vector>

#include "freetalk/mesh/mesh.h"

namespace freetalk::mesh {

/// Counts of what a mesh has. Edges are those of its polygons; a polygon that names a vertex twice
/// counts with the edges that are left.
struct MeshReport {
  int64_t vertices = 0;
  int64_t polygons = 0;
  int64_t triangles = 0;         ///< After polygons are cut.
  int64_t larger_polygons = 0;   ///< Polygons of more than three corners.
  int64_t lines_and_points = 0;  ///< Elements of the file with fewer corners, which are not kept.
  int64_t parts = 0;             ///< Connected by common vertices; unreferenced ones do not count.
  int64_t edges = 0;
  int64_t boundary_edges = 0;        ///< Of one polygon.
  int64_t boundaries = 0;            ///< Rims: connected sets of boundary edges.
  int64_t nonmanifold_edges = 0;     ///< Of three or more polygons.
  int64_t nonmanifold_vertices = 0;  ///< Whose polygons form more than one fan.
  int64_t inconsistent_edges = 0;    ///< Of two polygons that run along it the same way.
  int64_t unreferenced_vertices = 0;
  int64_t coincident_vertices = 0;       ///< At the place of an earlier vertex.
  int64_t repeated_corner_polygons = 0;  ///< That name a vertex twice.
  int64_t zero_area_triangles = 0;  ///< Thinner than 1e-6 of their longest edge, or in one point.
  int64_t duplicate_polygons = 0;   ///< With the vertices of an earlier polygon.
  Eigen::Vector3d extent = Eigen::Vector3d::Zero();  ///< Of the referenced vertices, file's unit.

  /// One line a finding, worst first, each with what it means here and what can be done; empty for
  /// a clean mesh.
  std::vector<std::string> findings() const;
};

MeshReport mesh_report(const Mesh& mesh);

}  // namespace freetalk::mesh
