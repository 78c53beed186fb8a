#include "freetalk/geometry/alignment.h"

#include <gtest/gtest.h>

#include "../mesh/shapes.h"

namespace freetalk::geometry {
namespace {

using testing::Shape;
using testing::toy_head;

struct Template {
  Shape head = toy_head(4);
  SurfaceSamples samples;
  Template() {
    Shape front = head;
    std::vector<Eigen::Index> kept;
    for (Eigen::Index f = 0; f < head.faces.rows(); ++f) {
      if (head.vertices(head.faces(f, 0), 2) > 0.02) kept.push_back(f);
    }
    front.faces = head.faces(kept, Eigen::all).eval();
    // The frame's origin lies on the face, as that of the landmarks does.
    front.vertices.rowwise() -= origin().transpose();
    head.vertices = front.vertices;
    samples = sample_surface(front.vertices, front.faces, 2000);
  }
  static Eigen::Vector3d origin() { return {0.0, -0.01, 0.08}; }
};

const Template& face_template() {
  static const Template instance;
  return instance;
}

Alignment align(const Shape& shape, const AlignOptions& options = {}) {
  return align_to_template(shape.vertices, shape.faces, face_template().samples.points,
                           face_template().samples.normals, options);
}

/// The toy head in another unit and pose; `known` is what brings it back.
Shape moved(const Shape& head, double scale, const Eigen::Matrix3d& rotation, Similarity& known) {
  const Similarity out{scale, rotation, Eigen::Vector3d(3.0, -7.0, 1.0) * scale};
  known = out.inverse();
  return {out.apply(head.vertices), head.faces};
}

Eigen::Matrix3d z_up() {
  Eigen::Matrix3d rotation;  // x right, z up, -y forward: y -> z, z -> -y
  rotation << 1, 0, 0, 0, 0, -1, 0, 1, 0;
  return rotation;
}

double distance(const Similarity& a, const Similarity& b, const Eigen::MatrixXd& points) {
  return (a.apply(points) - b.apply(points)).rowwise().norm().mean();
}

TEST(Alignment, RecoversUnitAndPose) {
  const Eigen::Matrix3d tilt =
      Eigen::AngleAxisd(0.12, Eigen::Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  for (const auto& [unit, scale] : std::vector<std::pair<std::string, double>>{
           {"m", 1.0}, {"cm", 100.0}, {"mm", 1000.0}, {"in", 1.0 / 0.0254}}) {
    Similarity known;
    const Shape shape = moved(face_template().head, scale, z_up() * tilt, known);
    const Alignment result = align(shape);
    EXPECT_EQ(result.unit, unit);
    EXPECT_EQ(result.up, "+z");
    EXPECT_EQ(result.forward, "-y");
    EXPECT_TRUE(result.guessed);
    EXPECT_TRUE(result.face_like) << result.summary;
    // The same surface: what is left is the spacing of the samples.
    EXPECT_LT(distance(result.to_canonical, known, shape.vertices), 2e-3) << result.summary;
  }
}

TEST(Alignment, KeepsToWhatIsGiven) {
  Similarity known;
  const Shape shape = moved(face_template().head, 1000.0, Eigen::Matrix3d::Identity(), known);
  AlignOptions options;
  options.unit = "mm";
  options.up = "+y";
  options.forward = "+z";
  const Alignment result = align(shape, options);
  EXPECT_FALSE(result.guessed);
  EXPECT_EQ(result.summary.rfind("given unit mm, +Y up, +Z forward; fit residual ", 0), 0u)
      << result.summary;
  EXPECT_LT(distance(result.to_canonical, known, shape.vertices), 2e-3);
  options.up = options.forward = "auto";
  const std::string partly =
      "unit mm (given), +Y up (guessed), +Z forward (guessed); fit residual ";
  EXPECT_EQ(align(shape, options).summary.rfind(partly, 0), 0u);
}

TEST(Alignment, NamesAScaleOfNoUnitArbitrary) {
  Similarity known;
  const Shape shape = moved(face_template().head, 7.3, Eigen::Matrix3d::Identity(), known);
  const Alignment result = align(shape);
  EXPECT_EQ(result.unit, "arbitrary") << result.summary;
  EXPECT_LT(distance(result.to_canonical, known, shape.vertices), 4e-3) << result.summary;
}

TEST(Alignment, IgnoresSmallerPartsAndInsideOutFaces) {
  Similarity known;
  Shape shape = moved(face_template().head, 100.0, Eigen::Matrix3d::Identity(), known);
  shape.faces = shape.faces.rowwise().reverse().eval();
  Shape eye = testing::sphere(2);
  eye.vertices.array() *= 1.2;
  eye.vertices.rowwise() += Eigen::RowVector3d(300.0 - 40.0, -700.0, 100.0);
  const Shape both = testing::join(eye, shape);
  const Alignment result = align(both);
  EXPECT_LT(distance(result.to_canonical, known, shape.vertices), 2e-3) << result.summary;
}

TEST(Alignment, SaysWhatIsNoFace) {
  Shape ball = testing::sphere(4);
  ball.vertices *= 0.11;
  EXPECT_FALSE(align(ball).face_like);
  Shape plane = testing::grid(20, 0.2, 0.2);
  const Alignment flat = align(plane);
  EXPECT_FALSE(flat.face_like);
  EXPECT_NE(flat.summary.find("does not look like a face"), std::string::npos);
}

TEST(Alignment, RefusesBadOptions) {
  const Shape& head = face_template().head;
  AlignOptions options;
  options.unit = "furlong";
  EXPECT_THROW(align(head, options), std::invalid_argument);
  options = {};
  options.up = "+y";
  options.forward = "-y";
  EXPECT_THROW(align(head, options), std::invalid_argument);
  EXPECT_THROW(align_to_template(head.vertices, head.faces, head.vertices.topRows(9),
                                 head.vertices.topRows(9)),
               std::invalid_argument);
}

TEST(Similarity, InverseUndoesAndComposeChains) {
  const Eigen::Matrix3d rotation =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  const Similarity a{2.0, rotation, {1, 2, 3}};
  const Similarity b{0.5, rotation.transpose(), {-1, 0, 4}};
  const Eigen::MatrixXd points = testing::sphere(1).vertices;
  EXPECT_TRUE(a.inverse().apply(a.apply(points)).isApprox(points, 1e-12));
  EXPECT_TRUE(a.compose(b).apply(points).isApprox(a.apply(b.apply(points)), 1e-12));
  EXPECT_TRUE(
      a.apply_vectors(points).isApprox(a.apply(points).rowwise() - Eigen::RowVector3d(1, 2, 3)));
}

TEST(SampleSurface, IsEvenAndRepeatable) {
  const Shape shape = testing::grid(5, 2.0, 1.0);
  const SurfaceSamples samples = sample_surface(shape.vertices, shape.faces, 1000, 3);
  EXPECT_EQ(samples.points, sample_surface(shape.vertices, shape.faces, 1000, 3).points);
  EXPECT_NE(samples.points, sample_surface(shape.vertices, shape.faces, 1000, 4).points);
  EXPECT_NEAR((samples.points.col(0).array() < 0.5).count(), 250, 15);
  EXPECT_NEAR(samples.normals.col(2).minCoeff(), 1.0, 1e-12);
}

}  // namespace
}  // namespace freetalk::geometry
