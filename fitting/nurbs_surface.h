#pragma once
// A rational B-spline surface with homogeneous control points, thesis (3.8).

#include <Eigen/Core>
#include <vector>

namespace celadon {

/// Derivatives of S up to second order at one parameter pair (right-sided at knots unless at the end).
struct SurfaceDerivatives {
  Eigen::Vector3d S, S_u, S_v, S_uu, S_uv, S_vv;
};

/// Homogeneous control points (w x, w y, w z, w) in row-major order: index i * count_v + j, i along u.
struct NurbsSurface {
  int degree_u = 1, degree_v = 2;
  std::vector<double> knots_u, knots_v;  ///< clamped
  Eigen::Matrix4Xd control_points;       ///< scanner frame, millimetres
  bool closed_v = true;                  ///< first and last column of control points coincide

  int count_u() const { return static_cast<int>(knots_u.size()) - degree_u - 1; }
  int count_v() const { return static_cast<int>(knots_v.size()) - degree_v - 1; }
  Eigen::Vector4d control_point(int i, int j) const { return control_points.col(i * count_v() + j); }

  Eigen::Vector3d evaluate(double u, double v) const;
  SurfaceDerivatives derivatives(double u, double v) const;
};

class RangeFunction;
/// S = F . B by symbolic product (thesis appendix A, B), as 3D homogeneous control points in the scanner frame,
/// removable knots removed. On the cylinder z is not multiplied by F (B.3), the degree is (max(p,1), q+2) and S_u x S_v
/// points inward; on the sphere the degree is (p+2, q+2) and S_u x S_v points outward (README.md, "Orientation").
NurbsSurface symbolic_product(const RangeFunction& range);

}  // namespace celadon
