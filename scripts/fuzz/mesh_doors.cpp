// The mesh doors: every reader behind load_mesh, the report on what was read, and the materials and
// colours that exports look up in the file again.
#include <stdexcept>

#include "driver.h"
#include "freetalk/mesh/appearance.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/mesh/report.h"

namespace freetalk::fuzz {

bool open_door(const std::filesystem::path& file) {
  try {
    const mesh::Mesh mesh = mesh::load_mesh(file);
    const auto colours = mesh::load_appearance(mesh).colours.rows();
    return mesh::mesh_report(mesh).vertices == mesh.num_vertices() &&
           (colours == 0 || colours == mesh.num_vertices());
  } catch (const std::runtime_error&) {
    return false;  // Named and refused, which is as good.
  }
}

}  // namespace freetalk::fuzz
