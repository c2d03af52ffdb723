#pragma once
// Random artefacts and what a sheet of light through the table's axis meets of them: circles in planes through the
// axis, in closed form. Nothing here uses the code under test but its types.

#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "acquisition/remeasured_points.h"
#include "daemon/checks/artefact.h"

namespace celadon {

using Random = std::mt19937_64;

/// Balls at different heights and distances from the axis, all spacings, and a flat; certified without error.
inline Artefact random_artefact(Random& random, int balls = 3) {
  std::uniform_real_distribution<double> unit(0, 1);
  Artefact out;
  out.name = "synthetic";
  const double first = 2 * std::numbers::pi * unit(random);
  for (int i = 0; i < balls; ++i) {
    const double around = first + 2 * std::numbers::pi * (i + 0.3 * unit(random)) / (balls + 1);
    const double beside = 22 + 20 * unit(random);
    CertifiedSphere sphere;
    sphere.name = std::string(1, static_cast<char>('A' + i));
    sphere.diameter = {20 + 10 * unit(random), 0};
    sphere.centre_mm = {beside * std::cos(around), beside * std::sin(around), 25 + 28 * i + 6 * unit(random)};
    out.spheres.push_back(sphere);
  }
  for (std::size_t i = 0; i < out.spheres.size(); ++i) {
    for (std::size_t j = i + 1; j < out.spheres.size(); ++j) {
      out.spacings.push_back({i, j, {(out.spheres[i].centre_mm - out.spheres[j].centre_mm).norm(), 0}});
    }
  }
  CertifiedFlat flat;
  const double around = first - 1.7 * std::numbers::pi / (balls + 1);  // between the last ball and the first
  flat.normal = {std::cos(around), std::sin(around), 0};
  flat.centre_mm = 45 * flat.normal + Eigen::Vector3d(0, 0, 30);
  flat.width_mm = 24;
  flat.height_mm = 30;
  out.flat = flat;
  return out;
}

/// Where it stands: turned about z, then moved.
struct Stand {
  double turn_rad = 0;
  Eigen::Vector3d shift_mm = Eigen::Vector3d::Zero();
};

inline Stand random_stand(Random& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  return {std::numbers::pi * unit(random), {12 * unit(random), 12 * unit(random), 0.5 * unit(random)}};
}

struct SampleNoise {
  double own_mm = 0.01, profile_mm = 0;  ///< of a sample, and of all samples of a profile together
};

/// Samples of the artefact, 240 profiles a turn: of balls all but the lowest part and what lies on their far side, of
/// the flat its whole front, of a plate below its rim.
inline ScannedPoints samples_of(const Artefact& truth, const Stand& stand, Random& random, const SampleNoise& noise) {
  constexpr int kProfiles = 240;
  constexpr double kPitch_mm = 0.5, kLowest = -0.8, kInmost = -0.5;
  std::normal_distribution<double> normal;
  std::vector<Eigen::Vector3d> points;
  ScannedPoints out;
  const Eigen::AngleAxisd R(stand.turn_rad, Eigen::Vector3d::UnitZ());
  for (int k = 0; k < kProfiles; ++k) {
    const double angle = 2 * std::numbers::pi * (k + 0.37) / kProfiles;
    const Eigen::Vector3d outward(std::cos(angle), std::sin(angle), 0), across(-std::sin(angle), std::cos(angle), 0);
    const double together = noise.profile_mm * normal(random);
    const auto add = [&](const Eigen::Vector3d& p) {
      points.push_back(p + (together + noise.own_mm * normal(random)) * outward);
      out.table_angle_rad.push_back(-angle);
      out.laser.push_back(0);
    };
    for (const CertifiedSphere& sphere : truth.spheres) {
      const Eigen::Vector3d c = R * sphere.centre_mm + stand.shift_mm;
      const double a = sphere.diameter.value / 2, off = c.dot(across);
      if (!(std::abs(off) < 0.98 * a)) continue;
      const double radius = std::sqrt(a * a - off * off);
      for (double phi = -std::numbers::pi; phi < std::numbers::pi; phi += kPitch_mm / radius) {
        const Eigen::Vector3d p =
            c - off * across + radius * (std::cos(phi) * outward + std::sin(phi) * Eigen::Vector3d::UnitZ());
        const Eigen::Vector3d n = (p - c) / a;
        if (n.z() > kLowest && n.dot(outward) > kInmost && p.dot(outward) > 1) add(p);
      }
    }
    if (truth.flat) {
      const Eigen::Vector3d n = R * truth.flat->normal, c = R * truth.flat->centre_mm + stand.shift_mm;
      const double facing = outward.dot(n);
      const double r = c.dot(n) / facing;
      const Eigen::Vector3d beside = Eigen::Vector3d::UnitZ().cross(n);
      if (facing > 0.3 && std::abs((r * outward - c).dot(beside)) < truth.flat->width_mm / 2) {
        for (double z = -truth.flat->height_mm / 2; z < truth.flat->height_mm / 2; z += kPitch_mm)
          add(r * outward + Eigen::Vector3d(0, 0, c.z() + z));
      }
    }
    for (double z = 1; z < 6; z += kPitch_mm) add(58 * outward + Eigen::Vector3d(stand.shift_mm.x(), 0, z));
  }
  out.p_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) out.p_mm.col(static_cast<Eigen::Index>(i)) = points[i];
  return out;
}

}  // namespace celadon
