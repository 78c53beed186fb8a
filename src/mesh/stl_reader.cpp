// STL through OpenMesh's reader, which joins the triangles' corners, into an importer of our own:
// OpenMesh's mesh refuses complex edges and would lose those faces.
#include <OpenMesh/Core/IO/IOManager.hh>
#include <OpenMesh/Core/IO/importer/BaseImporter.hh>
#include <OpenMesh/Core/IO/reader/STLReader.hh>
#include <OpenMesh/Core/System/omstream.hh>

#include <cstring>
#include <mutex>

#include "freetalk/core/error.h"
#include "mesh/mesh_file.h"

namespace freetalk::mesh {
namespace {

namespace om = OpenMesh;

/// Collects vertices, faces and vertex texture coordinates; ignores the rest.
class RawImporter final : public om::IO::BaseImporter {
 public:
  explicit RawImporter(RawMesh& mesh) : mesh_(mesh) {}

  om::VertexHandle add_vertex(const om::Vec3f& p) override { return push(p[0], p[1], p[2]); }
  om::VertexHandle add_vertex(const om::Vec3d& p) override { return push(p[0], p[1], p[2]); }
  om::VertexHandle add_vertex() override { return push(0.0, 0.0, 0.0); }
  om::HalfedgeHandle add_edge(om::VertexHandle, om::VertexHandle) override {
    return om::HalfedgeHandle();
  }
  om::FaceHandle add_face(const VHandles& corners) override {
    std::vector<int>& polygon = mesh_.polygons.emplace_back();
    polygon.reserve(corners.size());
    for (const om::VertexHandle& corner : corners) polygon.push_back(corner.idx());
    return om::FaceHandle(static_cast<int>(mesh_.polygons.size()) - 1);
  }
  om::FaceHandle add_face(om::HalfedgeHandle) override { return om::FaceHandle(); }
  void set_point(om::VertexHandle v, const om::Vec3f& p) override {
    if (has(v)) mesh_.vertices[v.idx()] = {p[0], p[1], p[2]};
  }
  void set_texcoord(om::VertexHandle v, const om::Vec2f& t) override {
    if (!has(v)) return;
    mesh_.texcoords.resize(mesh_.vertices.size(), Eigen::Vector2d::Zero());
    mesh_.texcoords[v.idx()] = {t[0], t[1]};
  }
  size_t n_vertices() const override { return mesh_.vertices.size(); }
  size_t n_faces() const override { return mesh_.polygons.size(); }
  size_t n_edges() const override { return 0; }

  void add_face_texcoords(om::FaceHandle, om::VertexHandle,
                          const std::vector<om::Vec2f>&) override {}
  void add_face_texcoords(om::FaceHandle, om::VertexHandle,
                          const std::vector<om::Vec3f>&) override {}
  void set_face_texindex(om::FaceHandle, int) override {}
  void set_halfedge(om::VertexHandle, om::HalfedgeHandle) override {}
  void set_normal(om::VertexHandle, const om::Vec3f&) override {}
  void set_normal(om::VertexHandle, const om::Vec3d&) override {}
  void set_normal(om::FaceHandle, const om::Vec3f&) override {}
  void set_normal(om::FaceHandle, const om::Vec3d&) override {}
  void set_color(om::VertexHandle, const om::Vec3uc&) override {}
  void set_color(om::VertexHandle, const om::Vec4uc&) override {}
  void set_color(om::VertexHandle, const om::Vec3f&) override {}
  void set_color(om::VertexHandle, const om::Vec4f&) override {}
  void set_color(om::EdgeHandle, const om::Vec3uc&) override {}
  void set_color(om::EdgeHandle, const om::Vec4uc&) override {}
  void set_color(om::EdgeHandle, const om::Vec3f&) override {}
  void set_color(om::EdgeHandle, const om::Vec4f&) override {}
  void set_color(om::FaceHandle, const om::Vec3uc&) override {}
  void set_color(om::FaceHandle, const om::Vec4uc&) override {}
  void set_color(om::FaceHandle, const om::Vec3f&) override {}
  void set_color(om::FaceHandle, const om::Vec4f&) override {}
  void set_status(om::VertexHandle, const om::Attributes::StatusInfo&) override {}
  void set_status(om::HalfedgeHandle, const om::Attributes::StatusInfo&) override {}
  void set_status(om::EdgeHandle, const om::Attributes::StatusInfo&) override {}
  void set_status(om::FaceHandle, const om::Attributes::StatusInfo&) override {}
  void set_next(om::HalfedgeHandle, om::HalfedgeHandle) override {}
  void set_face(om::HalfedgeHandle, om::FaceHandle) override {}
  void request_face_texcoords2D() override {}
  void set_texcoord(om::HalfedgeHandle, const om::Vec2f&) override {}
  void set_texcoord(om::VertexHandle, const om::Vec3f&) override {}
  void set_texcoord(om::HalfedgeHandle, const om::Vec3f&) override {}
  void add_texture_information(int, std::string) override {}

 private:
  om::VertexHandle push(double x, double y, double z) {
    mesh_.vertices.emplace_back(x, y, z);
    return om::VertexHandle(static_cast<int>(mesh_.vertices.size()) - 1);
  }
  bool has(om::VertexHandle v) const {
    return v.idx() >= 0 && v.idx() < static_cast<int>(mesh_.vertices.size());
  }

  RawMesh& mesh_;
};

/// The number of triangles a binary file says it holds, -1 for a text file.
int64_t declared_triangles(const std::string& bytes, const std::string& file) {
  constexpr size_t kHeader = 84, kTriangle = 50;
  const bool text = bytes.compare(0, 5, "solid") == 0 && bytes.find("facet") != std::string::npos;
  if (text) return -1;
  uint32_t count = 0;
  if (bytes.size() >= kHeader) std::memcpy(&count, bytes.data() + 80, sizeof(count));
  FREETALK_RUNTIME_CHECK(bytes.size() >= kHeader && count <= (bytes.size() - kHeader) / kTriangle,
                         "mesh file ", file,
                         " is not an STL file or is cut short; export it again");
  return count;
}

}  // namespace

RawMesh read_stl(const std::filesystem::path& path, const std::string& bytes) {
  const std::string file = path.string();
  const int64_t declared = declared_triangles(bytes, file);
  RawMesh mesh;
  RawImporter importer(mesh);
  bool read = false;
  {
    static std::mutex mutex;  // OpenMesh's readers are singletons that keep state while they read.
    const std::lock_guard<std::mutex> lock(mutex);
    ::omerr().disable();
    ::omlog().disable();
    om::IO::STLReader();  // Named so that the linker keeps the reader, which registers itself.
    om::IO::Options options;
    read = om::IO::IOManager().read(file, importer, options);
  }
  FREETALK_RUNTIME_CHECK(
      read && (declared < 0 || declared == static_cast<int64_t>(mesh.polygons.size())),
      "mesh file ", file, " is damaged or cut short; export it again");
  return mesh;
}

}  // namespace freetalk::mesh
