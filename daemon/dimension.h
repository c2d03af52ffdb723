#pragma once
// A size of an object with its uncertainty.

#include <string>

namespace celadon {

struct Dimension {
  std::string name;          ///< "diameter", "diameter at z = 60 mm", "cone angle"
  std::string unit = "mm";   ///< or "rad"
  double value = 0, u = 0;   ///< u: standard uncertainty
  double u_scatter = 0;      ///< the points' part of u
  double u_calibration = 0;  ///< the calibration's part of u, drift included
};

}  // namespace celadon
