#pragma once
// The closed forms that the scenes are made of.

#include <memory>

#include "sim/radial_body.h"

namespace celadon::sim {

/// A celadon vase of the maebyeong kind: narrow foot, round shoulder, small mouth with a lip. Surface of revolution,
/// C-infinity, 120 mm high, 37.4 mm at its widest:
///   r(z) = 13 + 26 / ((1 + e^((25-z)/18)) (1 + e^((z-100)/5))) + 4 e^(-((z-121)/5)^2) + 5 e^(-(z/8)^2)
std::shared_ptr<const Shape> make_vase();

/// A humidifier's freeform body, C-infinity, 110 mm high, with t = pi z / 110:
///   r(psi, z) = 33 + 4 sin t + 2.4 cos(3 psi + 0.6 sin t) + 0.9 sin(t) cos(5 psi + 1) + 0.5 cos(2 t) sin(2 psi)
std::shared_ptr<const Shape> make_humidifier();

/// A knob, C-infinity, 40 mm high: a skirt, a grip with six flutes, a rounded top that laser and camera see:
///   r(psi, z) = 16 + 8 / (1 + e^((z-10)/1.5)) - 6 e^((z-40)/3) + 0.8 cos(6 psi) / (1 + e^((14-z)/1.5))
std::shared_ptr<const Shape> make_knob();

/// A shaft with three lobes, not quite regular, 90 mm high:
///   r(psi) = 25 + 0.6 cos(3 psi) + 0.15 cos(5 psi + 0.4)
std::shared_ptr<const Shape> make_lobed_shaft();

/// A right circular cylinder.
std::shared_ptr<const Shape> make_cylinder(double radius_mm, double height_mm);

}  // namespace celadon::sim
