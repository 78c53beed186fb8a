#include "talker/head_lips.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace freetalk::talker {
namespace {

constexpr int kSide = 41;       // vertices of a row
constexpr double kCell = 2e-3;  // m

/// A sheet of skin about the origin that is cut along y = 0 for |x| < 20 mm: the two rims touch.
struct CutSheet {
  Eigen::MatrixXd vertices;
  Eigen::MatrixXi faces;
  std::vector<bool> upper;
};

CutSheet cut_sheet() {
  const int half = kSide / 2, count = kSide * kSide;
  CutSheet sheet{Eigen::MatrixXd(count + kSide, 3),
                 Eigen::MatrixXi(2 * (kSide - 1) * (kSide - 1), 3),
                 std::vector<bool>(static_cast<size_t>(count + kSide), false)};
  const auto at = [](int row, int column) { return row * kSide + column; };
  for (int row = 0; row < kSide; ++row) {
    for (int column = 0; column < kSide; ++column) {
      sheet.vertices.row(at(row, column)) << kCell * (column - half), kCell * (row - half), 0;
      sheet.upper[static_cast<size_t>(at(row, column))] = row > half;
    }
  }
  // A second row of vertices for the upper rim, a hair above; they are used where the cut is.
  for (int column = 0; column < kSide; ++column) {
    sheet.vertices.row(count + column) =
        sheet.vertices.row(at(half, column)) + Eigen::RowVector3d(0, 1e-4, 0);
    sheet.upper[static_cast<size_t>(count + column)] = true;
  }
  const auto corner = [&](int row, int column, bool of_upper) {
    const bool cut = row == half && std::abs(column - half) < 10 && of_upper;
    return cut ? count + column : at(row, column);
  };
  int face = 0;
  for (int row = 0; row + 1 < kSide; ++row) {
    const bool upper = row >= half;
    for (int column = 0; column + 1 < kSide; ++column) {
      const int a = corner(row, column, upper), b = corner(row, column + 1, upper),
                c = corner(row + 1, column + 1, upper), d = corner(row + 1, column, upper);
      sheet.faces.row(face++) << a, b, c;
      sheet.faces.row(face++) << a, c, d;
    }
  }
  return sheet;
}

TEST(HeadLips, GoOnAsTheLipDoesBeyondTheBlur) {
  const CutSheet sheet = cut_sheet();
  Eigen::MatrixXd values(sheet.vertices.rows(), 1);
  for (Eigen::Index v = 0; v < values.rows(); ++v) {  // -1 and 1, blurred within 5 mm of the cut
    values(v, 0) = std::clamp(sheet.vertices(v, 1) / 5e-3, -1.0, 1.0);
  }
  const auto found = continued_to_the_lips(sheet.vertices, sheet.faces, sheet.upper,
                                           Eigen::RowVector3d::Zero(), values);
  const int half = kSide / 2, middle = half * kSide + half;
  EXPECT_EQ(values(middle, 0), 0);
  EXPECT_NEAR(found(middle, 0), -1, 0.1);               // the lower rim
  EXPECT_NEAR(found(kSide * kSide + half, 0), 1, 0.1);  // the upper one, at the same place
  EXPECT_EQ(found(middle + 4 * kSide, 0), 1);           // 8 mm above
  const int far = half * kSide + 1;                     // on the uncut skin beside the mouth
  EXPECT_NEAR(found(far, 0), 0, 0.3);
}

TEST(HeadLips, WhatIsFarFromTheMouthStays) {
  const CutSheet sheet = cut_sheet();
  const Eigen::MatrixXd values = Eigen::MatrixXd::Random(sheet.vertices.rows(), 3);
  const Eigen::RowVector3d elsewhere(0, 1, 0);
  EXPECT_EQ(continued_to_the_lips(sheet.vertices, sheet.faces, sheet.upper, elsewhere, values),
            values);
}

}  // namespace
}  // namespace freetalk::talker
