// OFF and STL through OpenMesh's readers, into an importer of our own: OpenMesh's mesh refuses
// complex edges and would lose those faces. Its readers trust what a file says of itself, so counts
// and characters are checked too.
#include <OpenMesh/Core/IO/IOManager.hh>
#include <OpenMesh/Core/IO/importer/BaseImporter.hh>
#include <OpenMesh/Core/IO/reader/OFFReader.hh>
#include <OpenMesh/Core/IO/reader/STLReader.hh>
#include <OpenMesh/Core/System/omstream.hh>

#include <cstring>
#include <mutex>
#include <sstream>
#include <string_view>

#include "freetalk/core/error.h"
#include "mesh_file.h"

namespace freetalk::geometry {
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

/// What a file says it holds; -1 where it does not.
struct Declared {
  int64_t vertices = -1;
  int64_t faces = -1;
  std::string_view text;  // the part that must be numbers; empty for binary files
};

Declared declared_off(const std::string& bytes, const std::string& file) {
  const size_t line_end = std::min(bytes.find('\n'), bytes.size());
  const std::string first = bytes.substr(0, line_end);
  const size_t keyword = first.find("OFF");
  FREETALK_RUNTIME_CHECK(keyword != std::string::npos, "mesh file ", file,
                         " is not an OFF file (it does not start with OFF); check it or export it "
                         "again");
  Declared declared;
  if (first.find("BINARY") != std::string::npos) return declared;
  declared.text = std::string_view(bytes).substr(keyword + 3);
  std::string counts;
  for (size_t at = keyword + 3; at < bytes.size() && counts.size() < 64; ++at) {
    if (bytes[at] == '#') at = std::min(bytes.find('\n', at), bytes.size() - 1);
    counts.push_back(bytes[at]);
  }
  std::istringstream(counts) >> declared.vertices >> declared.faces;
  const auto size = static_cast<int64_t>(bytes.size());
  FREETALK_RUNTIME_CHECK(declared.vertices >= 0 && declared.faces >= 0 &&
                             declared.vertices <= size && declared.faces <= size,
                         "mesh file ", file,
                         " promises more elements than it can hold; export it again");
  return declared;
}

Declared declared_stl(const std::string& bytes, const std::string& file) {
  Declared declared;
  constexpr size_t kHeader = 84, kTriangle = 50;
  const bool text = bytes.compare(0, 5, "solid") == 0 && bytes.find("facet") != std::string::npos;
  if (text) return declared;
  uint32_t count = 0;
  if (bytes.size() >= kHeader) std::memcpy(&count, bytes.data() + 80, sizeof(count));
  FREETALK_RUNTIME_CHECK(bytes.size() >= kHeader && count <= (bytes.size() - kHeader) / kTriangle,
                         "mesh file ", file,
                         " is not an STL file or is cut short; export it again");
  declared.faces = count;
  return declared;
}

/// Number streams stop at the first character that is no number and would fill the rest with
/// repetitions.
/// @returns how many numbers there are.
int64_t count_numbers(std::string_view text, const std::string& file) {
  int64_t numbers = 0;
  bool within = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '#') {
      i = std::min(text.find('\n', i), text.size());
      within = false;
      continue;
    }
    const bool blank = c == ' ' || c == '\t' || c == '\r' || c == '\n';
    const bool digit =
        (c >= '0' && c <= '9') || c == '+' || c == '-' || c == '.' || c == 'e' || c == 'E';
    if (blank || digit) {
      numbers += digit && !within ? 1 : 0;
      within = digit;
      continue;
    }
    const std::string_view word = text.substr(i, 3);
    const bool not_finite = word == "nan" || word == "NaN" || word == "NAN" || word == "inf" ||
                            word == "Inf" || word == "INF";
    FREETALK_RUNTIME_CHECK(!not_finite, "mesh file ", file,
                           " has vertices that are not finite numbers; repair it in a mesh editor");
    FREETALK_RUNTIME_CHECK(false, "mesh file ", file,
                           " has text where numbers are expected; export it again");
  }
  return numbers;
}

/// How many numbers the text of a mesh must hold at least: three counts, the points, the faces.
int64_t numbers_needed(const RawMesh& mesh) {
  int64_t needed = 3 + 3 * static_cast<int64_t>(mesh.vertices.size());
  for (const std::vector<int>& polygon : mesh.polygons) {
    needed += 1 + static_cast<int64_t>(polygon.size());
  }
  return needed;
}

}  // namespace

RawMesh read_openmesh(const std::filesystem::path& path, const std::string& extension,
                      const std::string& bytes) {
  const std::string file = path.string();
  const Declared declared =
      extension == "off" ? declared_off(bytes, file) : declared_stl(bytes, file);
  const int64_t numbers = count_numbers(declared.text, file);
  RawMesh mesh;
  RawImporter importer(mesh);
  bool read = false;
  {
    static std::mutex mutex;  // OpenMesh's readers are singletons that keep state while they read.
    const std::lock_guard<std::mutex> lock(mutex);
    ::omerr().disable();
    ::omlog().disable();
    om::IO::OFFReader();  // Named so that the linker keeps the readers, which register themselves.
    om::IO::STLReader();
    om::IO::Options options = om::IO::Options::VertexTexCoord;
    std::istringstream stream(bytes, std::ios::binary);
    read = extension == "stl"
               ? om::IO::IOManager().read(file, importer, options)
               : om::IO::IOManager().read(stream, "." + extension, importer, options);
  }
  const auto matches = [](int64_t count, size_t found) {
    return count < 0 || count == static_cast<int64_t>(found);
  };
  FREETALK_RUNTIME_CHECK(read && matches(declared.vertices, mesh.vertices.size()) &&
                             matches(declared.faces, mesh.polygons.size()) &&
                             (declared.text.empty() || numbers_needed(mesh) <= numbers),
                         "mesh file ", file, " is damaged or cut short; export it again");
  if (!mesh.texcoords.empty()) {
    mesh.texcoords.resize(mesh.vertices.size(), Eigen::Vector2d::Zero());
    mesh.polygon_texcoords = mesh.polygons;
  }
  return mesh;
}

}  // namespace freetalk::geometry
