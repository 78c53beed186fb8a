#include "freetalk/geometry/operators.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "../mesh/shapes.h"
#include "core/file.h"
#include "freetalk/geometry/eigenbasis.h"
#include "freetalk/geometry/surface.h"

namespace freetalk::geometry {
namespace {

namespace fs = std::filesystem;
using testing::grid;
using testing::join;
using testing::message_of;
using testing::Shape;
using testing::sphere;
using testing::TemporaryFolder;

Eigenbasis basis_of(const Shape& shape, int64_t k) {
  return eigenbasis(cotan_laplacian(shape.vertices, shape.faces),
                    lumped_mass(shape.vertices, shape.faces), {k, 1e-6, "auto"});
}

TEST(Eigenbasis, OfTheSphereHasEigenvaluesOfItsHarmonics) {
  const Eigenbasis basis = basis_of(sphere(4), 16);  // 1026 vertices
  int index = 0;
  for (int l = 0; l < 4; ++l) {
    for (int m = 0; m < 2 * l + 1; ++m, ++index) {
      // Linear elements on edges h of 0.1 are off by some h^2 l (l + 1) / 12, relatively: 1-2 %
      // here.
      EXPECT_NEAR(basis.evals[index], l * (l + 1.0), 0.02 * l * (l + 1.0) + 1e-5) << index;
    }
  }
}

TEST(Eigenbasis, IsMassOrthonormalWithSmallResiduals) {
  for (const int levels : {2, 4}) {  // 66 vertices: dense; 1026: Lanczos
    const Shape shape = sphere(levels);
    const Eigen::VectorXd mass = lumped_mass(shape.vertices, shape.faces);
    const Eigenbasis basis = basis_of(shape, 40);
    const Eigen::MatrixXd gram = basis.evecs.transpose() * mass.asDiagonal() * basis.evecs;
    EXPECT_TRUE(gram.isIdentity(1e-9));
    EXPECT_LE(basis.residuals.maxCoeff(), 1e-6);
    EXPECT_TRUE(std::is_sorted(basis.evals.data(), basis.evals.data() + 40));
  }
}

TEST(Eigenbasis, FindsEveryCopyOfRepeatedEigenvalues) {
  Shape shape = join(sphere(3), sphere(3));  // 516 vertices: Lanczos
  shape = join(shape, sphere(3));
  const Eigenbasis one = basis_of(sphere(3), 12);
  const Eigenbasis three = basis_of(shape, 36);
  for (int i = 0; i < 36; ++i) {
    EXPECT_NEAR(three.evals[i], one.evals[i / 3], 1e-6) << i;
  }
}

TEST(Eigenbasis, OfDisconnectedPartsHasAZeroForEach) {
  Shape shape = join(sphere(3), grid(20));
  shape.vertices.bottomRows(400).col(2).array() += 3.0;
  const Eigenbasis basis = basis_of(shape, 5);
  EXPECT_LT(basis.evals[1], 1e-5);
  EXPECT_GT(basis.evals[2], 0.5);
}

TEST(Eigenbasis, OfMorePairsThanVerticesIsRefused) {
  const Shape shape = grid(4);
  EXPECT_NO_THROW(basis_of(shape, 16));
  EXPECT_THROW(basis_of(shape, 17), std::invalid_argument);
}

TEST(SurfaceOperators, FollowAUniformScale) {
  const Shape shape = sphere(3);
  OperatorOptions options;
  options.k_eig = 20;
  const SurfaceOperators scaled =
      surface_operators(shape.vertices, shape.faces, options).scaled(0.01);
  const SurfaceOperators direct = surface_operators(0.01 * shape.vertices, shape.faces, options);
  EXPECT_TRUE(at::allclose(scaled.mass, direct.mass, 1e-10, 0.0));
  // The first eigenvalue is rounding around zero; 1e-6 of the next is its measure.
  EXPECT_TRUE(
      at::allclose(scaled.evals, direct.evals, 1e-8, 1e-6 * direct.evals[1].item<double>()));
  EXPECT_TRUE(at::allclose(scaled.gradients.values, direct.gradients.values, 1e-8, 1e-6));
  EXPECT_TRUE(at::allclose(scaled.gradients.to_sparse_csr().to_dense().t(),
                           scaled.gradients.transposed().to_sparse_csr().to_dense()));
}

TEST(SurfaceOperators, AreFiniteOnNastyMeshes) {
  Shape shape = join(grid(12), sphere(2));
  shape.vertices.row(5) = shape.vertices.row(6);  // zero-length edge
  const Eigen::Index old = shape.faces.rows();
  shape.faces.conservativeResize(old + 5, 3);
  shape.faces.row(old) << 0, 1, 2;          // collinear
  shape.faces.row(old + 1) << 30, 31, 150;  // a third face on an edge, joining the parts
  shape.faces.row(old + 2) << 30, 31, 150;  // the same again
  shape.faces.row(old + 3) << 31, 30, 150;  // and turned around
  shape.faces.row(old + 4) << 9, 9, 9;
  shape.vertices.conservativeResize(shape.vertices.rows() + 2, 3);
  shape.vertices.bottomRows(2).setConstant(50.0);  // unreferenced
  OperatorOptions options;
  options.k_eig = 30;
  for (const char* mode : {"relative", "absolute"}) {
    options.regularization = mode;
    const SurfaceOperators operators = surface_operators(shape.vertices, shape.faces, options);
    for (const at::Tensor& tensor :
         {operators.mass, operators.evals, operators.evecs, operators.normals, operators.frames,
          operators.gradients.values}) {
      EXPECT_TRUE(at::isfinite(tensor).all().item<bool>());
    }
    EXPECT_LE(operators.residuals.max().item<double>(), 1e-6);
  }
}

TEST(SurfaceOperators, RefuseWhatIsNoSurface) {
  Shape shape = grid(4);
  OperatorOptions options;
  const auto run = [&](const Shape& s) { surface_operators(s.vertices, s.faces, options, "bust"); };
  EXPECT_NE(message_of([&] { run(shape); }).find("k_eig <= 16"), std::string::npos);
  options.k_eig = 4;
  Shape bad = shape;
  bad.vertices(3, 1) = std::nan("");
  EXPECT_NE(message_of([&] { run(bad); }).find("bust"), std::string::npos);
  bad = shape;
  bad.faces(0, 0) = 16;
  EXPECT_THROW(run(bad), std::invalid_argument);
  bad = shape;
  bad.vertices.setZero();
  EXPECT_THROW(run(bad), std::invalid_argument);
  options.laplacian = "fancy";
  EXPECT_THROW(run(shape), std::invalid_argument);
}

TEST(SurfaceOperators, ConvertToFloat) {
  const Shape shape = grid(5);
  OperatorOptions options;
  options.k_eig = 4;
  const SurfaceOperators operators =
      surface_operators(shape.vertices, shape.faces, options).to(at::kFloat);
  EXPECT_EQ(operators.evecs.scalar_type(), at::kFloat);
  EXPECT_EQ(operators.gradients.values.scalar_type(), at::kFloat);
}

class OperatorCache : public ::testing::Test {
 protected:
  OperatorCache() { options_.k_eig = 8; }
  SurfaceOperators get(int64_t max_bytes = int64_t{1} << 30) const {
    return cached_surface_operators(shape_.vertices, shape_.faces, options_, folder_.path(), "mesh",
                                    max_bytes);
  }
  std::vector<fs::path> entries() const {
    std::vector<fs::path> files;
    for (const auto& entry : fs::directory_iterator(folder_.path() / "operators")) {
      files.push_back(entry.path());
    }
    return files;
  }

  Shape shape_ = sphere(3);
  OperatorOptions options_;
  TemporaryFolder folder_;
};

TEST_F(OperatorCache, GivesBackTheSameNumbers) {
  const SurfaceOperators first = get();
  ASSERT_EQ(entries().size(), 1u);
  const SurfaceOperators second = get();
  EXPECT_EQ(entries().size(), 1u);
  EXPECT_TRUE(at::equal(first.evecs, second.evecs));
  EXPECT_TRUE(at::equal(first.gradients.values, second.gradients.values));
  EXPECT_TRUE(at::equal(first.gradients.transposed_values, second.gradients.transposed_values));
  EXPECT_TRUE(at::equal(first.gradients.transposed_columns, second.gradients.transposed_columns));
}

TEST_F(OperatorCache, KeysOnContentAndOptions) {
  get();
  options_.k_eig = 9;
  EXPECT_EQ(get().k_eig(), 9);
  options_.regularization = "absolute";
  get();
  shape_.vertices(0, 0) += 1e-12;
  get();
  shape_.faces.row(0).reverseInPlace();
  get();
  EXPECT_EQ(entries().size(), 5u);
}

TEST_F(OperatorCache, ComputesDamagedEntriesAgain) {
  const SurfaceOperators good = get();
  const fs::path file = entries().at(0);
  const std::string bytes = core::read_text(file);
  std::string flipped = bytes;
  flipped[bytes.size() - 9] ^= 0x10;
  for (const std::string& damaged :
       {std::string(), std::string("junk"), bytes.substr(0, bytes.size() / 2), flipped}) {
    core::write_file_atomic(file, damaged);
    EXPECT_TRUE(at::equal(get().evals, good.evals));
    EXPECT_EQ(core::read_text(file).size(), bytes.size());
  }
}

TEST_F(OperatorCache, DropsWhatWasUnusedForLongest) {
  get();
  const fs::path first = entries().at(0);
  const auto size = static_cast<int64_t>(fs::file_size(first));
  fs::last_write_time(first, fs::file_time_type::clock::now() - std::chrono::hours(1));
  options_.k_eig = 7;
  get();
  options_.k_eig = 6;
  get(size * 5 / 2);
  EXPECT_EQ(entries().size(), 2u);
  EXPECT_FALSE(fs::exists(first));
}

TEST_F(OperatorCache, IsSharedByConcurrentUsers) {
  std::vector<std::thread> users;
  std::vector<double> last(4);
  for (int i = 0; i < 4; ++i) {
    users.emplace_back([&, i] { last[i] = get().evals[7].item<double>(); });
  }
  for (std::thread& user : users) user.join();
  for (const double value : last) EXPECT_DOUBLE_EQ(value, last[0]);
  EXPECT_EQ(entries().size(), 1u);
}

TEST_F(OperatorCache, SurvivesAFolderItCannotWrite) {
  folder_.write("operators", "a file where the folder should be");
  EXPECT_EQ(get().k_eig(), 8);
}

}  // namespace
}  // namespace freetalk::geometry
