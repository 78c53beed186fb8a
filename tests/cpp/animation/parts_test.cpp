#include "freetalk/animation/parts.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>

#include "freetalk/geometry/surface.h"

namespace freetalk::animation {
namespace {

/// Meshes side by side.
struct Scene {
  Eigen::MatrixXd vertices{0, 3};
  Eigen::MatrixXi faces{0, 3};

  /// @return index of the first vertex added.
  int add(const Eigen::MatrixXd& more, const Eigen::MatrixXi& triangles) {
    const auto first = static_cast<int>(vertices.rows());
    Eigen::MatrixXd all(first + more.rows(), 3);
    all << vertices, more;
    Eigen::MatrixXi both(faces.rows() + triangles.rows(), 3);
    both << faces, (triangles.array() + first).matrix();
    vertices = all;
    faces = both;
    return first;
  }
};

/// An n x m grid of the map u, v in [0, 1] -> point.
template <class Map>
std::pair<Eigen::MatrixXd, Eigen::MatrixXi> grid(int n, int m, const Map& map) {
  Eigen::MatrixXd vertices(n * m, 3);
  Eigen::MatrixXi faces(2 * (n - 1) * (m - 1), 3);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < m; ++j) {
      vertices.row(i * m + j) = map(double(i) / (n - 1), double(j) / (m - 1)).transpose();
    }
  }
  int f = 0;
  for (int i = 0; i + 1 < n; ++i) {
    for (int j = 0; j + 1 < m; ++j) {
      const int a = i * m + j, b = a + m;
      faces.row(f++) << a, b, b + 1;
      faces.row(f++) << a, b + 1, a + 1;
    }
  }
  return {vertices, faces};
}

std::pair<Eigen::MatrixXd, Eigen::MatrixXi> ellipsoid(const Eigen::Vector3d& centre,
                                                      const Eigen::Vector3d& radii) {
  return grid(9, 13, [&](double u, double v) -> Eigen::Vector3d {
    const double polar = M_PI * (0.02 + 0.96 * u), around = 2 * M_PI * v;
    return centre +
           radii.cwiseProduct(Eigen::Vector3d(std::sin(polar) * std::cos(around), std::cos(polar),
                                              std::sin(polar) * std::sin(around)));
  });
}

/// Landmarks like those of the mean face: only eyes, lips and jaw matter here.
Eigen::MatrixXd template_landmarks() {
  Eigen::MatrixXd landmarks = Eigen::MatrixXd::Zero(68, 3);
  const auto ring = [&](int first, int count, Eigen::Vector3d centre, double x, double y) {
    for (int i = 0; i < count; ++i) {
      const double angle = M_PI - 2 * M_PI * i / count;
      landmarks.row(first + i) << centre.x() + x * std::cos(angle),
          centre.y() + y * std::sin(angle), centre.z() - 0.0145 * std::pow(std::cos(angle), 2);
    }
  };
  ring(36, 6, {-0.0315, 0.037, 0.004}, 0.013, 0.005);
  ring(42, 6, {0.0315, 0.037, 0.004}, 0.013, 0.005);
  ring(48, 12, {0, -0.032, 0.022}, 0.0253, 0.01);
  ring(60, 8, {0, -0.031, 0.018}, 0.018, 0.001);
  for (int i = 0; i <= 16; ++i) {
    const double angle = M_PI * i / 16;
    landmarks.row(i) << -0.073 * std::cos(angle), 0.04 - 0.113 * std::sin(angle),
        -0.058 + 0.068 * std::sin(angle);
  }
  return landmarks;
}

/// A curved mask through the landmarks' region.
std::pair<Eigen::MatrixXd, Eigen::MatrixXi> mask() {
  return grid(31, 31, [](double u, double v) -> Eigen::Vector3d {
    const double x = 0.16 * (u - 0.5), y = 0.2 * (v - 0.5);
    return {x, y, 0.022 - 8 * x * x - 2 * y * y};
  });
}

struct Head {
  Scene scene;
  int eye, upper, lower, both, brow, body;
};

Head make_head() {
  Head head;
  head.scene.add(mask().first, mask().second);
  const auto add = [&](const std::pair<Eigen::MatrixXd, Eigen::MatrixXi>& part) {
    return head.scene.add(part.first, part.second);
  };
  head.eye = add(ellipsoid({0.0315, 0.038, -0.010}, {0.014, 0.014, 0.014}));
  head.upper = add(ellipsoid({0.01, -0.02, 0.004}, {0.004, 0.012, 0.004}));
  head.lower = add(ellipsoid({0.01, -0.043, 0.003}, {0.004, 0.011, 0.004}));
  head.both = add(ellipsoid({0, -0.033, -0.03}, {0.03, 0.02, 0.03}));
  head.brow = add(grid(8, 3, [](double u, double v) -> Eigen::Vector3d {
    const double x = 0.02 + 0.03 * u, y = 0.055 + 0.005 * v;
    return {x, y, 0.0225 - 8 * x * x - 2 * y * y};
  }));
  head.body = add(ellipsoid({0, -0.5, -0.1}, {0.2, 0.2, 0.1}));
  return head;
}

PartMotion motion_at(const Parts& parts, int vertex) {
  return parts.parts()[parts.part_of_vertex()[vertex]].motion;
}

TEST(Parts, AreToldApartByPlaceAndShape) {
  const Head head = make_head();
  const Parts parts(head.scene.vertices, head.scene.faces, template_landmarks());
  EXPECT_EQ(motion_at(parts, 0), PartMotion::kFace);
  EXPECT_EQ(motion_at(parts, head.eye), PartMotion::kStill);
  EXPECT_EQ(motion_at(parts, head.upper), PartMotion::kStill);
  EXPECT_EQ(motion_at(parts, head.lower), PartMotion::kJaw);
  EXPECT_EQ(motion_at(parts, head.both), PartMotion::kJaw);
  EXPECT_EQ(motion_at(parts, head.brow), PartMotion::kSurface);
  EXPECT_EQ(motion_at(parts, head.body), PartMotion::kSurface);
  EXPECT_EQ(parts.face_vertices().rows(), 31 * 31);
  EXPECT_EQ(parts.face_faces().maxCoeff(), 31 * 31 - 1);
}

TEST(Parts, PartWithBothJawsIsDivided) {
  const Head head = make_head();
  const Parts parts(head.scene.vertices, head.scene.faces, template_landmarks());
  const auto& share = parts.jaw_share();
  const int end = head.brow;
  float top = 1, bottom = 0;
  for (int v = head.both; v < end; ++v) {
    if (head.scene.vertices(v, 1) > -0.018) top = std::min(top, share[v]);
    if (head.scene.vertices(v, 1) < -0.045) bottom = std::max(bottom, share[v]);
    EXPECT_GE(share[v], 0.0f);
    EXPECT_LE(share[v], 1.0f);
  }
  EXPECT_EQ(top, 0.0f);
  EXPECT_EQ(bottom, 1.0f);
}

TEST(Parts, FollowWhatTheyBelongTo) {
  const Head head = make_head();
  const Parts parts(head.scene.vertices, head.scene.faces, template_landmarks());
  // The whole skin shifts; the chin's landmarks say that the jaw stays.
  const auto shift = at::tensor({0.001f, 0.002f, 0.003f});
  const auto skin = shift.expand({2, 31 * 31, 3}).contiguous();
  const auto moved = parts.move(skin, at::zeros({2, 68, 3}));
  const auto near = [&](int vertex, const at::Tensor& expected) {
    return at::allclose(moved.select(1, vertex), expected.expand({2, 3}), 1e-5, 1e-7);
  };
  EXPECT_TRUE(near(5, shift));
  EXPECT_TRUE(near(head.brow, shift));
  for (const int vertex : {head.eye, head.upper, head.lower, head.body}) {
    EXPECT_TRUE(near(vertex, at::zeros({3})));
  }
}

TEST(Parts, SkinSlidesOverEyeballs) {
  const Head head = make_head();
  const Parts parts(head.scene.vertices, head.scene.faces, template_landmarks());
  const auto pressed = at::tensor({0.0f, 0.0f, -0.011f}).expand({1, 31 * 31, 3}).contiguous();
  const auto given = pressed.clone();
  const auto moved = parts.move(pressed, at::zeros({1, 68, 3}));
  EXPECT_TRUE(at::equal(pressed, given));
  const Eigen::Vector3d centre(0.0315, 0.038, -0.010);
  int slid = 0, others = 0;
  for (int v = 0; v < 31 * 31; ++v) {
    const float* by = moved.const_data_ptr<float>() + 3 * v;
    const Eigen::Vector3d rest = head.scene.vertices.row(v);
    const Eigen::Vector3d now = rest + Eigen::Vector3d(by[0], by[1], by[2]);
    const double beside = (rest - centre).head<2>().norm();
    // The ball's facets are up to 1 mm inside its sphere of 14 mm.
    if (beside < 0.011) {
      EXPECT_GT((now - centre).norm(), 0.0132) << rest.transpose();
    }
    slid += by[2] > -0.0105f;
    if (beside < 0.016) continue;
    ++others;
    EXPECT_EQ(by[2], -0.011f) << rest.transpose();
  }
  EXPECT_GT(slid, 5);
  EXPECT_GT(others, 800);
}

TEST(Parts, TextureSeamsAreClosedButLipsStayApart) {
  // The mask again, cut along x = 0 with doubled vertices as a texture seam does.
  Scene scene;
  for (const double side : {0.0, 1.0}) {
    const auto half = grid(16, 31, [&](double u, double v) -> Eigen::Vector3d {
      const double x = 0.08 * (u - 1 + side), y = 0.2 * (v - 0.5);
      return {x, y, 0.022 - 8 * x * x - 2 * y * y};
    });
    scene.add(half.first, half.second);
  }
  const Parts parts(scene.vertices, scene.faces, template_landmarks());
  EXPECT_EQ(parts.parts().size(), 1u);
  EXPECT_EQ(parts.face_vertices().rows(), 2 * 16 * 31 - 31);
  // Both copies of a seam vertex move alike.
  const auto moved =
      parts.move(at::randn({1, parts.face_vertices().rows(), 3}), at::zeros({1, 68, 3}));
  EXPECT_TRUE(at::equal(moved[0][15 * 31 + 4], moved[0][16 * 31 + 4]));

  // Two sheets that meet at right angles, like lips.
  Scene lips;
  for (const double turn : {1.0, -1.0}) {
    const auto sheet = grid(5, 5, [&](double u, double v) -> Eigen::Vector3d {
      return {0.05 * (u - 0.5), turn * 0.05 * v, 0.05 * v};
    });
    lips.add(sheet.first, turn > 0 ? sheet.second : sheet.second.rowwise().reverse().eval());
  }
  EXPECT_EQ(Parts(lips.vertices, lips.faces, template_landmarks()).parts().size(), 2u);
}

TEST(Parts, LoneTriangleIsAFace) {
  Eigen::MatrixXd vertices(3, 3);
  vertices << 0, 0, 0, 1, 0, 0, 0, 1, 0;
  const Eigen::MatrixXi faces = Eigen::RowVector3i(0, 1, 2);
  EXPECT_EQ(Parts(vertices, faces, template_landmarks()).face_vertices().rows(), 3);
}

TEST(Parts, WrongShapesAreErrors) {
  const Head head = make_head();
  EXPECT_THROW(Parts(head.scene.vertices, head.scene.faces, Eigen::MatrixXd::Zero(5, 3)),
               std::invalid_argument);
  const Parts parts(head.scene.vertices, head.scene.faces, template_landmarks());
  EXPECT_THROW(parts.move(at::zeros({1, 3, 3}), at::zeros({1, 68, 3})), std::invalid_argument);
  EXPECT_THROW(parts.move(at::zeros({1, 961, 3}), at::zeros({2, 68, 3})), std::invalid_argument);
}

}  // namespace
}  // namespace freetalk::animation
