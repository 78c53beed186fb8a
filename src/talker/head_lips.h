// A parametric head's field is smooth in space: where lips touch it takes the upper for the lower.
// What it says of them is taken from further up each lip instead.
#pragma once

#include <Eigen/Core>

#include <vector>

namespace freetalk::talker {

/// Values at the vertices of a face, those within 6 mm of the other lip continued over the surface
/// (harmonically) from the vertices beyond.
/// @param vertices (V, 3) m. @param faces (F, 3). @param upper (V,) see stm::upper_side.
/// @param mouth its middle, m: what is farther than 45 mm from it stays. @param values (V, C).
Eigen::MatrixXd continued_to_the_lips(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                                      const std::vector<bool>& upper,
                                      const Eigen::RowVector3d& mouth,
                                      const Eigen::MatrixXd& values);

}  // namespace freetalk::talker
