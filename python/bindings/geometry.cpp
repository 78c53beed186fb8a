#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/stl/filesystem.h>
#include <torch/extension.h>

#include "bind_options.h"
#include "freetalk/geometry/alignment.h"
#include "freetalk/geometry/eigenbasis.h"
#include "freetalk/geometry/isosurface.h"
#include "freetalk/geometry/operators.h"
#include "freetalk/geometry/poisson.h"
#include "freetalk/geometry/robust_laplacian.h"
#include "freetalk/geometry/signed_distance.h"
#include "freetalk/geometry/surface.h"

namespace {

namespace py = pybind11;
namespace geometry = freetalk::geometry;
using NoGil = py::call_guard<py::gil_scoped_release>;

void bind_surface(py::module_& m) {
  m.def("lumped_mass", &geometry::lumped_mass, py::arg("vertices"), py::arg("faces"), NoGil(),
        "(V,) lumped mass.");
  m.def(
      "cotan_laplacian",
      [](const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
         const std::string& regularization) {
        geometry::OperatorOptions options;
        options.regularization = regularization;
        options.check();
        return geometry::cotan_laplacian(vertices, faces,
                                         regularization == "absolute"
                                             ? geometry::Regularization::kAbsolute
                                             : geometry::Regularization::kRelative);
      },
      py::arg("vertices"), py::arg("faces"), py::kw_only(), py::arg("regularization") = "relative",
      "(V, V) cotangent Laplacian as a scipy sparse matrix, positive semi-definite.");
}

std::pair<at::ScalarType, c10::Device> dtype_and_device(const py::object& dtype,
                                                        const py::object& device) {
  return {torch::python::detail::py_object_to_dtype(dtype),
          torch::python::detail::py_object_to_device(
              py::module_::import("torch").attr("device")(device))};
}

py::tuple tensors_of(const geometry::SparseOperator& a) {
  return py::make_tuple(a.rows, a.columns, a.values, a.transposed_rows, a.transposed_columns,
                        a.transposed_values);
}

void bind_sparse_operator(py::module_& m) {
  using geometry::SparseOperator;
  py::class_<SparseOperator>(
      m, "SparseOperator",
      "A constant sparse matrix (R, V) and its transpose by compressed rows, for "
      "sparse_product.\n\n"
      "torch's own and scipy's matrices share its memory: ``matrix.to_sparse_csr()`` and\n"
      "``scipy.sparse.csr_array((matrix.values, matrix.columns, matrix.rows), matrix.shape)``.")
      .def(py::init([](const at::Tensor& matrix) {
             const at::Tensor coo = matrix.to_sparse().coalesce(), places = coo.indices();
             const at::Tensor rows = at::searchsorted(
                 places[0].contiguous(), at::arange(matrix.size(0) + 1, places.options()));
             return SparseOperator::from_rows(rows.to(at::kInt), places[1].to(at::kInt),
                                              coo.values().clone(), matrix.size(1));
           }),
           py::arg("matrix"), "Of a matrix (R, V), dense or of any of torch's sparse layouts.")
      .def_readonly("rows", &SparseOperator::rows,
                    "(R + 1,) first entry of each row, and the end; int32 or int64.")
      .def_readonly("columns", &SparseOperator::columns, "(N,).")
      .def_readonly("values", &SparseOperator::values, "(N,).")
      .def_property_readonly("shape",
                             [](const SparseOperator& self) {
                               return std::make_pair(self.num_rows(), self.num_columns());
                             })
      .def("transposed", &SparseOperator::transposed, "(V, R), nothing copied.")
      .def("tensors", &tensors_of,
           "(rows, columns, values) of the matrix, then of its transpose: what the operation\n"
           "torch.ops.freetalk.sparse_product takes before x, under torch.compile for instance.")
      .def("to_sparse_csr", &SparseOperator::to_sparse_csr,
           "torch's sparse CSR tensor (R, V), nothing copied.")
      .def(
          "to_dense", [](const SparseOperator& self) { return self.to_sparse_csr().to_dense(); },
          "(R, V).")
      .def(
          "to",
          [](const SparseOperator& self, const py::object& dtype, const py::object& device) {
            const auto [type, place] = dtype_and_device(dtype, device);
            return self.to(type, place);
          },
          py::arg("dtype"), py::arg("device") = "cpu", "A copy with another dtype and device.")
      .def("__repr__",
           [](const SparseOperator& self) {
             return "SparseOperator(shape=(" + std::to_string(self.num_rows()) + ", " +
                    std::to_string(self.num_columns()) +
                    "), entries=" + std::to_string(self.values.size(0)) + ")";
           })
      .def(py::pickle(&tensors_of, [](const py::tuple& state) {
        const auto tensor = [&](size_t i) { return state[i].cast<at::Tensor>(); };
        return SparseOperator{tensor(0), tensor(1), tensor(2), tensor(3), tensor(4), tensor(5)};
      }));
}

void bind_face_operators(py::module_& m) {
  using geometry::FaceOperators;
  py::class_<FaceOperators>(m, "FaceOperators", "Gradients and Poisson solver on triangles.")
      .def_readonly("faces", &FaceOperators::faces, "(F, 3) int64.")
      .def_readonly("areas", &FaceOperators::areas, "(F,) length^2.")
      .def_readonly("gradients", &FaceOperators::gradients,
                    "(2F, V): X, then Y components in the faces' tangent frames.")
      .def_readonly("frames", &FaceOperators::frames, "(F, 3, 3) rows X, Y, normal.")
      .def_readonly("components", &FaceOperators::components,
                    "(V,) int64, connected part of each vertex.");
  m.def("face_operators", &geometry::face_operators, py::arg("vertices"), py::arg("faces"),
        py::kw_only(), py::arg("vertex_of") = Eigen::VectorXi(), NoGil(),
        "Gradients on the faces of a mesh and its Poisson solver, float64.");
  m.def("unique_edges", &geometry::unique_edges, py::arg("faces"), NoGil(),
        "(E, 2) int64 unique undirected edges (i < j) of triangles.");
}

void bind_robust_laplacian(py::module_& m) {
  using Pair = std::pair<geometry::SparseMatrix, Eigen::VectorXd>;
  m.def(
      "robust_laplacian",
      [](const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces, double mollify_factor) {
        auto result = geometry::robust_laplacian(vertices, faces, mollify_factor);
        return Pair(std::move(result.laplacian), std::move(result.mass));
      },
      py::arg("vertices"), py::arg("faces"), py::kw_only(),
      py::arg("mollify_factor") = geometry::kMollifyFactor,
      "(V, V) tufted Laplacian of triangles as a scipy sparse matrix, and (V,) mass.");
  m.def(
      "point_cloud_laplacian",
      [](const Eigen::MatrixXd& points, double mollify_factor, int64_t num_neighbors,
         bool published_fit) {
        auto result = geometry::point_cloud_laplacian(
            points, mollify_factor, num_neighbors,
            published_fit ? geometry::CloudFit::kPublished : geometry::CloudFit::kExact);
        return Pair(std::move(result.laplacian), std::move(result.mass));
      },
      py::arg("points"), py::kw_only(), py::arg("mollify_factor") = geometry::kMollifyFactor,
      py::arg("num_neighbors") = 30, py::arg("published_fit") = true,
      "(V, V) tufted Laplacian of points as a scipy sparse matrix, and (V,) mass.");
}

void bind_operators(py::module_& m) {
  freetalk::bindings::bind_options<geometry::OperatorOptions>(
      m, "OperatorOptions", "What is computed of a surface, and how exactly.");
  using geometry::SurfaceOperators;
  py::class_<SurfaceOperators>(m, "SurfaceOperators",
                               "Mass, eigenbasis and gradients of a surface.")
      .def_readonly("mass", &SurfaceOperators::mass, "(V,) length^2.")
      .def_readonly("evals", &SurfaceOperators::evals, "(K,) 1 / length^2, ascending.")
      .def_readonly("evecs", &SurfaceOperators::evecs, "(V, K) 1 / length, mass-orthonormal.")
      .def_readonly("gradients", &SurfaceOperators::gradients,
                    "(2V, V): X, then Y components in the tangent frames.")
      .def_readonly("normals", &SurfaceOperators::normals, "(V, 3).")
      .def_readonly("frames", &SurfaceOperators::frames, "(V, 3, 3) rows X, Y, normal.")
      .def_readonly("residuals", &SurfaceOperators::residuals, "(K,) relative eigen-residuals.")
      .def("scaled", &SurfaceOperators::scaled, py::arg("factor"),
           "Operators of the same surface scaled uniformly.")
      .def("turned", &SurfaceOperators::turned, py::arg("rotation"), NoGil(),
           "Operators of the same surface turned by a rotation (3, 3).")
      .def("faces", &SurfaceOperators::faces, NoGil(),
           "What lives on the faces: gradients and the Poisson solver.")
      .def_readonly("offsets", &SurfaceOperators::offsets,
                    "First vertex of each mesh of a batch and the end; empty for one mesh.")
      .def(
          "to",
          [](const SurfaceOperators& self, const py::object& dtype, const py::object& device) {
            const auto [type, place] = dtype_and_device(dtype, device);
            return self.to(type, place);
          },
          py::arg("dtype"), py::arg("device") = "cpu", "A copy with another dtype and device.")
      .def("__repr__", [](const SurfaceOperators& self) {
        return "SurfaceOperators(vertices=" + std::to_string(self.num_vertices()) +
               ", k_eig=" + std::to_string(self.k_eig()) + ")";
      });
  m.def("concatenate",
        py::overload_cast<const std::vector<geometry::SurfaceOperators>&>(&geometry::concatenate),
        py::arg("parts"), NoGil(), "Operators of several meshes as one block-diagonal batch.");
  m.def("surface_operators", &geometry::surface_operators, py::arg("vertices"), py::arg("faces"),
        py::kw_only(), py::arg("options") = geometry::OperatorOptions{}, py::arg("name") = "mesh",
        py::arg("progress") = std::function<void(double)>(), NoGil(),
        "Operators of a surface, computed.");
  m.def("cached_surface_operators", &geometry::cached_surface_operators, py::arg("vertices"),
        py::arg("faces"), py::kw_only(), py::arg("options") = geometry::OperatorOptions{},
        py::arg("cache_dir") = std::filesystem::path(), py::arg("name") = "mesh",
        py::arg("max_bytes") = int64_t{4} << 30,
        py::arg("progress") = std::function<void(double)>(), NoGil(),
        "Operators of a surface, from the disk cache where they are there.");
}

void bind_eigenbasis(py::module_& m) {
  freetalk::bindings::bind_options<geometry::EigenbasisOptions>(
      m, "EigenbasisOptions", "How many eigenpairs, how exactly, by which solver.");
  using geometry::Eigenbasis;
  py::class_<Eigenbasis>(m, "Eigenbasis", "The smallest eigenpairs of a Laplacian.")
      .def_readonly("evals", &Eigenbasis::evals, "(K,) ascending, 1 / length^2.")
      .def_readonly("evecs", &Eigenbasis::evecs, "(V, K) mass-orthonormal, 1 / length.")
      .def_readonly("residuals", &Eigenbasis::residuals, "(K,) relative eigen-residuals.")
      .def("__repr__", [](const Eigenbasis& self) {
        return "Eigenbasis(vertices=" + std::to_string(self.evecs.rows()) +
               ", k=" + std::to_string(self.evals.size()) + ")";
      });
  m.def("eigenbasis",
        py::overload_cast<const geometry::SparseMatrix&, const Eigen::VectorXd&,
                          const geometry::EigenbasisOptions&, const std::string&,
                          const std::function<void(double)>&>(&geometry::eigenbasis),
        py::arg("laplacian"), py::arg("mass"), py::kw_only(),
        py::arg("options") = geometry::EigenbasisOptions{}, py::arg("name") = "mesh",
        py::arg("progress") = std::function<void(double)>(), NoGil(),
        "The smallest eigenpairs of L phi = lambda M phi.");
}

void bind_isosurface(py::module_& m) {
  using Surface = std::pair<Eigen::MatrixXd, Eigen::MatrixXi>;
  const auto arrays = [](geometry::Isosurface&& surface) {
    return Surface(std::move(surface.vertices), std::move(surface.faces));
  };
  m.def(
      "isosurface",
      [arrays](const py::array_t<float, py::array::c_style | py::array::forcecast>& values,
               double level, const Eigen::Vector3d& origin, const Eigen::Vector3d& spacing) {
        if (values.ndim() != 3) throw py::value_error("values must have the shape (X, Y, Z)");
        const float* data = values.data();
        const std::array<int64_t, 3> shape{values.shape(0), values.shape(1), values.shape(2)};
        const py::gil_scoped_release release;
        return arrays(geometry::isosurface(data, shape, {level, origin, spacing}));
      },
      py::arg("values"), py::kw_only(), py::arg("level") = 0.0,
      py::arg("origin") = Eigen::Vector3d(Eigen::Vector3d::Zero()),
      py::arg("spacing") = Eigen::Vector3d(Eigen::Vector3d::Ones()),
      "(V, 3) vertices and (F, 3) faces of a level of a field (X, Y, Z).");
  m.def(
      "isosurface_of_cells",
      [arrays](const Eigen::MatrixXd& corners, const Eigen::VectorXf& values,
               const geometry::CellCorners& cells, double level) {
        return arrays(geometry::isosurface_of_cells(corners, values, cells, level));
      },
      py::arg("corners"), py::arg("values"), py::kw_only(), py::arg("cells"),
      py::arg("level") = 0.0, NoGil(),
      "(V, 3) vertices and (F, 3) faces of a level of a field within chosen cells.");
}

void bind_surface_tree(py::module_& m) {
  using geometry::SurfaceTree;
  py::class_<SurfaceTree>(m, "SurfaceTree", "A triangle mesh made ready for nearest points.")
      .def(py::init<const Eigen::MatrixXd&, const Eigen::MatrixXi&>(), py::arg("vertices"),
           py::arg("faces"), NoGil())
      .def(
          "nearest",
          [](const SurfaceTree& self, const Eigen::MatrixXd& points) {
            auto found = self.nearest(points);
            return std::make_tuple(std::move(found.points), std::move(found.distances),
                                   std::move(found.faces));
          },
          py::arg("points"), NoGil(),
          "(N, 3) nearest points of the surface, (N,) distances, (N,) faces.")
      .def("winding_number", &SurfaceTree::winding_number, py::arg("points"), py::kw_only(),
           py::arg("accuracy") = 2.0, NoGil(),
           "(N,) how often the surface winds around each point.")
      .def("signed_distance", &SurfaceTree::signed_distance, py::arg("points"), NoGil(),
           "(N,) distance, negative where the winding number is at least 1/2.");
}

void bind_alignment(py::module_& m) {
  freetalk::bindings::bind_options<geometry::AlignOptions>(m, "AlignOptions",
                                                           "What is known of a mesh's frame.");
  using geometry::Alignment;
  using geometry::Similarity;
  py::class_<Similarity>(m, "Similarity", "x -> scale * rotation * x + translation.")
      .def(py::init([](double scale, const Eigen::Matrix3d& rotation,
                       const Eigen::Vector3d& translation) {
             return Similarity{scale, rotation, translation};
           }),
           py::arg("scale") = 1.0,
           py::arg("rotation") = Eigen::Matrix3d(Eigen::Matrix3d::Identity()), py::kw_only(),
           py::arg("translation") = Eigen::Vector3d(Eigen::Vector3d::Zero()))
      .def_readonly("scale", &Similarity::scale)
      .def_readonly("rotation", &Similarity::rotation, "(3, 3).")
      .def_readonly("translation", &Similarity::translation, "(3,).")
      .def("apply", &Similarity::apply, py::arg("points"), "(N, 3) points moved.")
      .def("apply_vectors", &Similarity::apply_vectors, py::arg("vectors"),
           "(N, 3) vectors turned and scaled, not translated.")
      .def("inverse", &Similarity::inverse)
      .def("compose", &Similarity::compose, py::arg("first"), "First `first`, then this.");
  py::class_<Alignment>(m, "Alignment", "A mesh's way to the canonical frame.")
      .def_readonly("to_canonical", &Alignment::to_canonical)
      .def_readonly("unit", &Alignment::unit)
      .def_readonly("up", &Alignment::up)
      .def_readonly("forward", &Alignment::forward)
      .def_readonly("guessed", &Alignment::guessed)
      .def_readonly("residual_m", &Alignment::residual_m)
      .def_readonly("normal_degrees", &Alignment::normal_degrees)
      .def_readonly("face_like", &Alignment::face_like)
      .def_readonly("summary", &Alignment::summary)
      .def("__repr__", [](const Alignment& self) { return "Alignment(" + self.summary + ")"; });
  m.def("align_to_template", &geometry::align_to_template, py::arg("vertices"), py::arg("faces"),
        py::kw_only(), py::arg("template_points"), py::arg("template_normals"),
        py::arg("options") = geometry::AlignOptions{}, NoGil(),
        "Brings a face or head of any unit and pose to a template's frame.");
  m.def(
      "sample_surface",
      [](const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces, int64_t num_points,
         uint64_t seed) {
        auto samples = geometry::sample_surface(vertices, faces, num_points, seed);
        return std::make_pair(std::move(samples.points), std::move(samples.normals));
      },
      py::arg("vertices"), py::arg("faces"), py::kw_only(), py::arg("num_points"),
      py::arg("seed") = 0, NoGil(), "Points and normals spread evenly over a surface.");
}

}  // namespace

void bind_geometry(py::module_& m) {
  bind_surface(m);
  bind_robust_laplacian(m);
  bind_sparse_operator(m);
  bind_face_operators(m);
  bind_operators(m);
  bind_eigenbasis(m);
  bind_isosurface(m);
  bind_surface_tree(m);
  bind_alignment(m);
}
