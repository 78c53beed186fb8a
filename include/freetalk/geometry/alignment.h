// Brings a face or head mesh of any unit and pose to the frame of a face template.
//
// The 24 axis orientations x scales x positions are started from, scored with a truncated
// point-to-plane distance with normals in both directions, refined by similarity ICP (halving the
// field round by round).
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <string>

namespace freetalk::geometry {

/// x -> scale * rotation * x + translation.
struct Similarity {
  double scale = 1.0;
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::MatrixXd apply(const Eigen::MatrixXd& points) const;           ///< (N, 3) -> (N, 3)
  Eigen::MatrixXd apply_vectors(const Eigen::MatrixXd& vectors) const;  ///< without the translation
  Similarity inverse() const;
  /// First `first`, then this.
  Similarity compose(const Similarity& first) const;
};

struct AlignOptions {
  std::string unit = "auto";  // "auto", "m", "cm", "mm", "in"
  std::string up = "auto";  // "auto", "+x", "-x", "+y", "-y", "+z", "-z": the mesh axis towards the
                            // top of the head
  std::string forward = "auto";  // likewise: the mesh axis out of the face

  template <class Visitor>
  void fields(Visitor& visit) {
    visit("unit", unit);
    visit("up", up);
    visit("forward", forward);
  }
  void check() const;
};

struct Alignment {
  Similarity to_canonical;  ///< mesh unit and pose -> the template's frame (metres)
  std::string unit;         ///< "m", "cm", "mm", "in", or "arbitrary" if none makes a human face
  std::string up, forward;  ///< nearest mesh axes, "+y" ...
  bool guessed = false;     ///< whether any of unit, up, forward was "auto"
  double residual_m = 0.0;  ///< mean distance over the best 85 % of the template's middle
  double normal_degrees = 0.0;  ///< mean angle between the normals there
  bool face_like = true;        ///< both below their bounds: what was found looks like a face
  std::string summary;          ///< "guessed unit cm, +Y up, +Z forward; fit residual 2.1 mm"
};

/// Bounds of what looks like a face: human heads fit to 0.5-2.5 mm and 3-11 degrees.
constexpr double kFaceResidual = 4.0e-3;
constexpr double kFaceDegrees = 13.0;

/// @param vertices (V, 3), faces (F, 3): a face mask, a head, a bust; the largest part is fitted,
/// other parts follow.
/// @param template_points (P, 3) m, template_normals (P, 3): samples of the mean face in the
/// canonical frame.
/// @throws std::invalid_argument for bad options, a template of fewer than 100 points, a surface
/// without area.
Alignment align_to_template(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                            const Eigen::MatrixXd& template_points,
                            const Eigen::MatrixXd& template_normals,
                            const AlignOptions& options = {});

/// Points of a surface with their normals.
struct SurfaceSamples {
  Eigen::MatrixXd points;   ///< (N, 3)
  Eigen::MatrixXd normals;  ///< (N, 3) unit, interpolated vertex normals
};

/// `num_points` samples spread evenly by area (systematic along the faces, low-discrepancy within
/// them).
SurfaceSamples sample_surface(const Eigen::MatrixXd& vertices, const Eigen::MatrixXi& faces,
                              int64_t num_points, uint64_t seed = 0);

}  // namespace freetalk::geometry
