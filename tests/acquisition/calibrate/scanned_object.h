#pragma once
// Scans of round objects by a machine whose every number is known: pixels from the closed form, samples from the
// solved calibration.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "acquisition/remeasured_points.h"
#include "acquisition/triangulation.h"
#include "tests/acquisition/calibrate/true_machine.h"

namespace celadon::test {

/// A convex object that stands on the table.
struct RoundObject {
  Eigen::Isometry3d X_TO = Eigen::Isometry3d::Identity();  ///< its place on the table
  /// Below 0 inside; about the distance from the surface near it.
  std::function<double(const Eigen::Vector3d& p_O)> outside;
  double low_mm = 0, high_mm = 0, widest_mm = 0;  ///< heights of the scanner frame to look at; largest radius there
};

inline RoundObject cylinder_of(double radius_mm) {
  return {.outside = [=](const Eigen::Vector3d& p) { return p.head<2>().norm() - radius_mm; },
          .low_mm = 15,
          .high_mm = 105,
          .widest_mm = radius_mm + 25};
}
inline RoundObject sphere_of(double radius_mm, double height_mm) {
  return {
      .outside = [=](const Eigen::Vector3d& p) { return (p - Eigen::Vector3d(0, 0, height_mm)).norm() - radius_mm; },
      .low_mm = height_mm - 0.8 * radius_mm,
      .high_mm = height_mm + 0.8 * radius_mm,
      .widest_mm = radius_mm + 25};
}
/// radius at height 60 mm, and its slope along z.
inline RoundObject taper_of(double radius_mm, double slope) {
  return {.outside = [=](const Eigen::Vector3d& p) { return p.head<2>().norm() - radius_mm - slope * (p.z() - 60); },
          .low_mm = 15,
          .high_mm = 105,
          .widest_mm = radius_mm + 50 * std::abs(slope) + 25};
}

/// Where the sheet first meets the object, from the camera's side, at a height; nothing where it does not.
inline bool lit_point(const TrueMachine& machine, const TrueMachine::Sheet& sheet, const RoundObject& object,
                      const Eigen::Isometry3d& X_OW, double z, Eigen::Vector3d& p_W) {
  const Eigen::Vector3d& n = sheet.normal_W;
  const Eigen::Vector3d along = Eigen::Vector3d(n.y(), -n.x(), 0).normalized();  // azimuth of the sheet, outward
  const Eigen::Vector3d across(n.head<2>().normalized().x(), n.head<2>().normalized().y(), 0);
  const auto at = [&](double s) -> Eigen::Vector3d {
    const Eigen::Vector3d flat =
        Eigen::Vector3d(0, 0, z) + s * along + across * ((sheet.distance_mm - n.z() * z) / n.head<2>().norm());
    return flat + across * (machine.sheet_bow_mm(flat) / n.head<2>().norm());
  };
  double outer = object.widest_mm, inner = 0;
  if (object.outside(X_OW * at(inner)) >= 0 || object.outside(X_OW * at(outer)) <= 0) return false;
  for (int k = 0; k < 46; ++k) {
    const double middle = 0.5 * (outer + inner);
    (object.outside(X_OW * at(middle)) > 0 ? outer : inner) = middle;
  }
  p_W = at(outer);
  return true;
}

struct ScanProgramme {
  int profiles = 48;
  int every_row = 4;  ///< of the samples, so many are kept
  double line_px = 0.05;
};

/// The samples of one turn of the object under one laser, as the calibration makes them of the pixels.
inline ScannedPoints scan_of(const TrueMachine& true_machine, const Calibration& calibration, int laser,
                             const RoundObject& object, std::uint64_t seed, const ScanProgramme& programme = {}) {
  TrueMachine machine = true_machine;
  std::mt19937_64 random(seed * 6364136223846793005ull + 1442695040888963407ull);
  std::normal_distribution<double> normal;
  if (machine.beyond.warming_rad > 0) machine.camera_turn_rad = machine.beyond.warming_rad * normal(random);
  const auto sheet = std::find_if(machine.sheets.begin(), machine.sheets.end(),
                                  [&](const TrueMachine::Sheet& s) { return s.laser == laser; });
  const Triangulator triangulator(calibration, laser, ScanVolume{});
  std::vector<Eigen::Vector3d> points;
  ScannedPoints out;
  for (int k = 0; k < programme.profiles; ++k) {
    const double encoder = 2 * std::numbers::pi * k / programme.profiles;
    const Eigen::Isometry3d X_OW = (machine.table_at(encoder) * object.X_TO).inverse();
    const double bias = machine.beyond.line_bias_px > 0 ? machine.beyond.line_bias_px * normal(random) : 0;
    // The line as a function of height, then at whole rows by interpolation: the line is smooth over 0.2 mm.
    std::vector<Eigen::Vector2d> line;
    constexpr double kStep_mm = 0.2;
    for (double z = object.high_mm; z >= object.low_mm; z -= kStep_mm) {
      Eigen::Vector3d p_W;
      if (!lit_point(machine, *sheet, object, X_OW, z, p_W)) continue;
      const Eigen::Vector2d p = machine.project(machine.X_CW * p_W);
      if (machine.in_picture(p)) line.push_back(p);
    }
    std::vector<LineRow> rows(static_cast<std::size_t>(machine.height_px));
    for (std::size_t i = 1; i + 2 < line.size(); ++i) {
      for (int row = static_cast<int>(std::ceil(line[i].y())); row < line[i + 1].y(); ++row) {
        // Cubic through four neighbours.
        double x = 0;
        for (std::size_t a = i - 1; a < i + 3; ++a) {
          double share = 1;
          for (std::size_t b = i - 1; b < i + 3; ++b) {
            if (b != a) share *= (row - line[b].y()) / (line[a].y() - line[b].y());
          }
          x += share * line[a].x();
        }
        LineRow& found = rows[static_cast<std::size_t>(row)];
        found.x_px = static_cast<float>(x + bias + programme.line_px * normal(random));
        found.sigma_px = static_cast<float>(programme.line_px);
        found.status = RowStatus::found;
      }
    }
    Profile profile;
    triangulator.triangulate(
        rows, FrameInfo{},
        [&](std::int64_t) { return tl::expected<AngleAtInstant, const char*>(AngleAtInstant{.angle_rad = encoder}); },
        profile);
    for (std::size_t i = 0; i < profile.size(); ++i) {
      if (profile.row[i] % programme.every_row != 0) continue;
      points.emplace_back(profile.r_mm[i] * std::cos(profile.theta_rad[i]),
                          profile.r_mm[i] * std::sin(profile.theta_rad[i]), profile.z_mm[i]);
      out.table_angle_rad.push_back(profile.table_angle_rad);
      out.laser.push_back(laser);
    }
  }
  out.p_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i) out.p_mm.col(static_cast<Eigen::Index>(i)) = points[i];
  return out;
}

}  // namespace celadon::test
