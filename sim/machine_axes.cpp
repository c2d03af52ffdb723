#include "sim/machine_axes.h"

#include "sim/optics.h"
#include "sim/random.h"

namespace celadon::sim {

using Eigen::Vector3d;

namespace {

constexpr std::uint64_t kAxesPurpose = 21;

}  // namespace

MachineAxes draw_axes(std::uint64_t seed, const Eigen::Isometry3d& X_CW, bool with_elevation, bool with_lift) {
  const RandomKey key = make_key(seed, kAxesPurpose, 0);
  const auto within = [&](std::uint32_t number, double most) { return most * (2 * random_uniform(key, number) - 1); };
  MachineAxes axes;
  if (with_elevation) {
    const Vector3d along = across_the_view(X_CW), across = along.cross(Vector3d::UnitZ());
    axes.elevation = MachineAxes::Elevation();
    MachineAxes::Elevation& e = *axes.elevation;
    e.origin_S = within(0, 0.4) * across + (kElevationHeight_mm + within(1, 0.5)) * Vector3d::UnitZ();
    e.direction_S = (along + within(2, 0.003) * across + within(3, 0.003) * Vector3d::UnitZ()).normalized();
    e.scale = 1 + within(4, 1e-3);
  }
  if (with_lift) {
    axes.lift = MachineAxes::Lift();
    MachineAxes::Lift& l = *axes.lift;
    l.direction_S = Vector3d(within(5, 0.002), within(6, 0.002), 1).normalized();
    l.scale = 1 + within(7, 5e-4);
  }
  return axes;
}

}  // namespace celadon::sim
