#pragma once
// The cap by which the thesis closes a hole around a pole (3.15) - (3.24), appendix D: kept to be compared with the
// 2-jet. Source: README.md, "Poles".

#include <Eigen/Core>

#include "fitting/nurbs_surface.h"
#include "fitting/range_function.h"

namespace celadon {

struct ThesisCap {
  NurbsSurface surface;        ///< degree (5, q + 2), u from the degenerate point to the rim
  Eigen::Vector3d point;       ///< p* (3.20)
  Eigen::Vector3d normal;      ///< n* (3.21), away from the centre
  double alpha = 0, beta = 0;  ///< (D.11), per unit of the surface's u
};

/// Closes the hole around phi = 0: `range` begins at its rim. The printed (3.24) is corrected: degree q + 2, the nodes
/// of that degree, and the curves' homogeneous points with w_k = W(v_k). Where round bodies leave (D.11) open, the
/// solution next to alpha = -2 u_rim, beta = alpha^2 is taken, the scale at which the curves run as the meridian does.
/// @pre over a sphere, closed around, the band starts above w = 0, an even number of spans repeats after half a turn
/// (3.15)
/// @throws std::invalid_argument if not
ThesisCap thesis_cap(const RangeFunction& range);

}  // namespace celadon
