// The mesh doors: every reader behind load_mesh, and the report on what was read.
#include <stdexcept>

#include "driver.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/mesh/report.h"

namespace freetalk::fuzz {

bool open_door(const std::filesystem::path& file) {
  try {
    const mesh::Mesh mesh = mesh::load_mesh(file);
    return mesh::mesh_report(mesh).vertices == mesh.num_vertices();
  } catch (const std::runtime_error&) {
    return false;  // Named and refused, which is as good.
  }
}

}  // namespace freetalk::fuzz
