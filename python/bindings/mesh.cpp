#include <pybind11/eigen.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_options.h"
#include "freetalk/core/error.h"
#include "freetalk/mesh/appearance.h"
#include "freetalk/mesh/close_holes.h"
#include "freetalk/mesh/components.h"
#include "freetalk/mesh/lip_slit.h"
#include "freetalk/mesh/mesh.h"
#include "freetalk/mesh/normals.h"
#include "freetalk/mesh/report.h"
#include "freetalk/mesh/vertex_budget.h"

namespace {

namespace py = pybind11;
namespace mesh = freetalk::mesh;
using NoGil = py::call_guard<py::gil_scoped_release>;

void bind_mesh_class(py::module_& m) {
  py::class_<mesh::Mesh>(m, "Mesh", "A polygon mesh as its file has it, plus its triangles.")
      .def(py::init(&mesh::make_mesh), py::arg("vertices"), py::arg("polygons"), py::kw_only(),
           py::arg("texcoords") = Eigen::MatrixXd(0, 2),
           py::arg("polygon_texcoords") = std::vector<std::vector<int>>(), py::arg("name") = "mesh",
           NoGil())
      .def_property(
          "vertices",
          [](const mesh::Mesh& mesh) -> const Eigen::MatrixXd& { return mesh.vertices; },
          [](mesh::Mesh& mesh, const Eigen::MatrixXd& vertices) {
            FREETALK_CHECK(vertices.rows() == mesh.vertices.rows() && vertices.cols() == 3,
                           "vertices of ", mesh.name, " must keep their shape (",
                           mesh.vertices.rows(), ", 3), found (", vertices.rows(), ", ",
                           vertices.cols(), ")");
            mesh.vertices = vertices;
          },
          "(V, 3) float64, the file's unit.")
      .def_readonly("faces", &mesh::Mesh::faces, "(F, 3) int32 triangles.")
      .def_readonly("polygons", &mesh::Mesh::polygons,
                    "Vertex indices of each polygon as in the file; empty if all are triangles.")
      .def_readonly("texcoords", &mesh::Mesh::texcoords, "(Vt, 2) float64; (0, 2) without.")
      .def_readonly("polygon_texcoords", &mesh::Mesh::polygon_texcoords,
                    "Rows of texcoords of each polygon's corners.")
      .def_readonly("face_polygon", &mesh::Mesh::face_polygon,
                    "(F,) the polygon each triangle was cut from.")
      .def_readwrite("name", &mesh::Mesh::name, "The file's name, for messages.")
      .def_readwrite("source", &mesh::Mesh::source,
                     "The file it was read from, whose materials writers keep; empty without.")
      .def("__repr__", [](const mesh::Mesh& mesh) {
        return "Mesh(name='" + mesh.name + "', vertices=" + std::to_string(mesh.num_vertices()) +
               ", polygons=" + std::to_string(mesh.num_polygons()) +
               ", triangles=" + std::to_string(mesh.num_faces()) + ")";
      });
  m.def("load_mesh", &mesh::load_mesh, py::arg("path"), NoGil(),
        "Reads an OBJ, PLY, OFF, STL or glTF file.");
  py::class_<mesh::Appearance>(m, "Appearance", "How the surface of a mesh file looks.")
      .def(
          "carried",
          [](mesh::Appearance self, const std::vector<int>& polygon_origin,
             const Eigen::MatrixXd& colours) {
            if (!self.materials.empty()) {
              std::vector<int> material;
              for (const int p : polygon_origin) {
                material.push_back(p < 0 ? -1 : self.polygon_material.at(static_cast<size_t>(p)));
              }
              self.polygon_material = std::move(material);
            }
            self.colours = colours;
            return self;
          },
          py::arg("polygon_origin"), py::arg("colours"),
          "The same on a mesh whose polygons look like those (-1: like none), vertices like that.")
      .def(
          "with_parts",
          [](mesh::Appearance self, size_t num_polygons,
             const std::vector<std::pair<std::string, Eigen::Vector3d>>& materials,
             const std::vector<int>& polygon_material, Eigen::Index num_vertices) {
            if (self.materials.empty()) self.polygon_material.assign(num_polygons, -1);
            const auto first = static_cast<int>(self.materials.size());
            for (const auto& [name, colour] : materials) {
              self.materials.push_back({name, {colour[0], colour[1], colour[2], 1.0}, {}});
            }
            for (const int number : polygon_material) {
              FREETALK_CHECK(number >= 0 && number < static_cast<int>(materials.size()),
                             "there is no material ", number);
              self.polygon_material.push_back(first + number);
            }
            if (self.colours.rows() > 0) {
              const Eigen::Index before = self.colours.rows();
              self.colours.conservativeResize(before + num_vertices, Eigen::NoChange);
              self.colours.bottomRows(num_vertices).setOnes();
            }
            return self;
          },
          py::arg("num_polygons"), py::arg("materials"), py::arg("polygon_material"),
          py::arg("num_vertices"),
          "The same of a mesh of so many polygons to which others of further materials (name, "
          "linear colour) were "
          "added, and so many vertices.")
      .def_readonly("polygon_material", &mesh::Appearance::polygon_material,
                    "(P,) of each polygon, -1 for none; empty without materials.")
      .def_property_readonly(
          "colours",
          [](const mesh::Appearance& self) -> const Eigen::MatrixXd& { return self.colours; },
          "(V, 4) of the vertices in [0, 1], sRGB; empty without.");
  m.def("load_appearance", &mesh::load_appearance, py::arg("mesh"), NoGil(),
        "Materials, textures and colours of the file that a mesh was read from.");
  m.def("save_mesh",
        py::overload_cast<const std::filesystem::path&, const mesh::Mesh&>(&mesh::save_mesh),
        py::arg("path"), py::arg("mesh"), NoGil(), "Writes an OBJ or PLY file atomically.");
  m.def("save_mesh",
        py::overload_cast<const std::filesystem::path&, const mesh::Mesh&, const mesh::Appearance&>(
            &mesh::save_mesh),
        py::arg("path"), py::arg("mesh"), py::arg("appearance"), NoGil(),
        "The same with the look of the surface.");
}

void bind_mesh_report(py::module_& m) {
  using mesh::MeshReport;
  py::class_<MeshReport>(m, "MeshReport", "What a mesh is like, defect by defect.")
      .def_readonly("vertices", &MeshReport::vertices)
      .def_readonly("polygons", &MeshReport::polygons)
      .def_readonly("triangles", &MeshReport::triangles, "After polygons are cut.")
      .def_readonly("larger_polygons", &MeshReport::larger_polygons, "Of more than three corners.")
      .def_readonly("lines_and_points", &MeshReport::lines_and_points, "Not kept: no faces.")
      .def_readonly("parts", &MeshReport::parts, "Connected by common vertices.")
      .def_readonly("edges", &MeshReport::edges)
      .def_readonly("boundary_edges", &MeshReport::boundary_edges, "Of one polygon.")
      .def_readonly("boundaries", &MeshReport::boundaries, "Rims of boundary edges.")
      .def_readonly("nonmanifold_edges", &MeshReport::nonmanifold_edges, "Of three or more.")
      .def_readonly("nonmanifold_vertices", &MeshReport::nonmanifold_vertices,
                    "Where surfaces touch in a point only.")
      .def_readonly("inconsistent_edges", &MeshReport::inconsistent_edges,
                    "Whose two polygons turn opposite ways.")
      .def_readonly("unreferenced_vertices", &MeshReport::unreferenced_vertices, "In no face.")
      .def_readonly("coincident_vertices", &MeshReport::coincident_vertices,
                    "At the place of an earlier vertex.")
      .def_readonly("repeated_corner_polygons", &MeshReport::repeated_corner_polygons,
                    "That name a vertex twice.")
      .def_readonly("zero_area_triangles", &MeshReport::zero_area_triangles)
      .def_readonly("duplicate_polygons", &MeshReport::duplicate_polygons,
                    "With the vertices of an earlier one.")
      .def_readonly("extent", &MeshReport::extent, "(3,) of the referenced vertices, file's unit.")
      .def("findings", &MeshReport::findings, "One line a finding, worst first.");
  m.def("mesh_report", &mesh::mesh_report, py::arg("mesh"), NoGil(),
        "What a mesh is like, defect by defect.");
}

void bind_normals(py::module_& m) {
  m.def("vertex_normals", &mesh::vertex_normals, py::arg("vertices"), py::arg("faces"), NoGil(),
        "(V, 3) unit vertex normals.");
  m.def("face_areas", &mesh::face_areas, py::arg("vertices"), py::arg("faces"), NoGil(),
        "(F,) areas.");
  m.def("connected_components", &mesh::connected_components, py::arg("num_vertices"),
        py::arg("faces"), NoGil(), "(V,) component of each vertex.");
}

void bind_holes(py::module_& m) {
  m.def("boundary_loops", &mesh::boundary_loops, py::arg("polygons"), NoGil(),
        "The simple loops of edges of one polygon only, as vertices in the polygons' direction.");
  m.def(
      "close_holes",
      [](const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces, int64_t max_edges) {
        auto closed = mesh::close_holes(vertices, faces, max_edges);
        return std::make_tuple(std::move(closed.vertices), std::move(closed.faces), closed.left);
      },
      py::arg("vertices"), py::arg("faces"), py::kw_only(),
      py::arg("max_edges") = std::numeric_limits<int64_t>::max(), NoGil(),
      "(V + H, 3) vertices, (F', 3) faces and the number of edges that stay open.");
}

void bind_surgery(py::module_& m) {
  using mesh::LipSlit;
  freetalk::bindings::bind_options<mesh::SlitOptions>(m, "SlitOptions", "How cut_lips cuts.");
  using mesh::Reshaped;
  py::class_<Reshaped>(m, "Reshaped", "A mesh made of another one.")
      .def_readonly("mesh", &Reshaped::mesh, "Old vertices in their order, then new ones.")
      .def_readonly("polygon_origin", &Reshaped::polygon_origin,
                    "(P',) the given polygon whose look each has.")
      .def_property_readonly(
          "vertex_origin",
          [](const Reshaped& made) {
            std::vector<std::tuple<int, int, double>> rows;
            for (const auto& [a, b, share] : made.added) rows.emplace_back(a, b, share);
            return rows;
          },
          "Of each new vertex (a, b, share): it looks like (1 - share) a + share b, those given "
          "and "
          "earlier ones.");
  py::class_<LipSlit, Reshaped>(m, "LipSlit", "A mesh whose lips were cut apart.")
      .def_readonly("edges", &LipSlit::edges, "Of the slit.")
      .def_readonly("pocket_polygons", &LipSlit::pocket_polygons, "The last ones: the pocket's.")
      .def_readonly("pocket_vertices", &LipSlit::pocket_vertices, "The last ones: the pocket's.");
  m.def("lips_are_joined", &mesh::lips_are_joined, py::arg("vertices"), py::arg("faces"),
        py::arg("landmarks"), NoGil(), "Whether upper and lower lip are one skin.");
  m.def("cut_lips", &mesh::cut_lips, py::arg("mesh"), py::arg("landmarks"), py::kw_only(),
        py::arg("options") = mesh::SlitOptions{}, NoGil(),
        "Cuts a slit between lips that are one skin and sews a pocket behind it.");
  py::class_<mesh::Budgeted, Reshaped>(m, "Budgeted", "A mesh of about as many vertices as wanted.")
      .def_readonly("vertex_map", &mesh::Budgeted::vertex_map,
                    "(V,) the new vertex of each old one, -1 where it is gone.");
  m.def("to_vertex_budget", &mesh::to_vertex_budget, py::arg("mesh"), py::arg("vertices"),
        py::arg("importance") = Eigen::VectorXd(), NoGil(),
        "Thins a mesh out or halves its edges until it has about as many vertices.");
}

}  // namespace

void bind_mesh(py::module_& m) {
  bind_mesh_class(m);
  bind_mesh_report(m);
  bind_normals(m);
  bind_holes(m);
  bind_surgery(m);
}
