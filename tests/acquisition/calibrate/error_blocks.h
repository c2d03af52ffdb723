#pragma once
// Errors of many solved calibrations against what their covariances say, block by block.

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "acquisition/triangulation.h"
#include "tests/acquisition/calibrate/true_machine.h"

namespace celadon::test {

/// Quantile of a chi-square by Wilson and Hilferty; z: of the normal distribution.
inline double chi_square_quantile(double dof, double z) {
  const double root = 1 - 2 / (9 * dof) + z * std::sqrt(2 / (9 * dof));
  return dof * root * root * root;
}

/// Errors of one kind, e.g. the axis's direction.
struct ErrorBlock {
  std::string name, unit;
  int size = 0, seeds = 0;
  double squares = 0, variances = 0;  ///< sums over seeds and components
  double chi_square = 0;

  void add(const Eigen::VectorXd& errors, const Eigen::MatrixXd& covariance) {
    size = static_cast<int>(errors.size());
    ++seeds;
    squares += errors.squaredNorm();
    variances += covariance.trace();
    chi_square += errors.dot(covariance.ldlt().solve(errors));
  }
  double dof() const { return static_cast<double>(size) * seeds; }
  double rms() const { return std::sqrt(squares / dof()); }
  double predicted() const { return std::sqrt(variances / dof()); }
  /// Root of the mean normalised square: 1 if the covariance is right.
  double ratio() const { return std::sqrt(chi_square / dof()); }
  double lowest() const { return chi_square_quantile(dof(), -3.09); }
  double highest() const { return chi_square_quantile(dof(), 3.09); }
};

/// Rows of an exact picture of a cylinder about the true axis under a laser, and their radii as a scan would see them.
inline std::vector<double> scanned_radii(const Calibration& calibration, const TrueMachine& machine, int laser,
                                         double radius_mm) {
  const TrueMachine::Sheet& sheet = machine.sheets[static_cast<std::size_t>(laser)];
  const double azimuth = std::atan2(-sheet.normal_W.x(), sheet.normal_W.y());
  const double horizontal = sheet.normal_W.head<2>().norm();
  const auto pixel = [&](double z) {
    const double angle = azimuth + std::asin((sheet.distance_mm - sheet.normal_W.z() * z) / (radius_mm * horizontal));
    return machine.project(machine.X_CW * Eigen::Vector3d(radius_mm * std::cos(angle), radius_mm * std::sin(angle), z));
  };
  std::vector<LineRow> rows(static_cast<std::size_t>(machine.height_px));
  for (int row = 0; row < machine.height_px; ++row) {
    double lower = 5, upper = 110;  // heights; rows go down
    if (pixel(upper).y() > row || pixel(lower).y() < row) continue;
    for (int k = 0; k < 60; ++k) {
      const double middle = 0.5 * (lower + upper);
      (pixel(middle).y() > row ? lower : upper) = middle;
    }
    LineRow& out = rows[static_cast<std::size_t>(row)];
    out.x_px = static_cast<float>(pixel(lower).x());
    out.sigma_px = 0.01f;
    out.status = RowStatus::found;
  }
  const Triangulator triangulator(calibration, laser, ScanVolume{});
  Profile profile;
  triangulator.triangulate(
      rows, FrameInfo{}, [](std::int64_t) { return tl::expected<AngleAtInstant, const char*>(AngleAtInstant{}); },
      profile);
  return profile.r_mm;
}

/// All blocks of a machine with two lasers.
class ErrorBlocks {
 public:
  void add(const CalibrationSolution& solution, const TrueMachine& machine) {
    const Eigen::VectorXd errors = errors_of(solution, machine);
    const Eigen::MatrixXd& C = solution.covariance;
    const auto index = [&](const std::string& name) {
      return static_cast<int>(std::find(solution.names.begin(), solution.names.end(), name) - solution.names.begin());
    };
    const auto block = [&](const std::string& name, const std::string& unit, const std::string& first, int size) {
      const int at = index(first);
      of(name, unit).add(errors.segment(at, size), C.block(at, at, size, size));
    };
    block("fx, fy, cx, cy", "px", "fx_px", 4);
    block("distortion", "", "k1", 5);
    block("axis direction", "rad", "axis.tilt_x_rad", 2);
    block("axis position", "mm", "axis.x_mm", 2);
    block("encoder scale", "", "encoder.scale", 1);
    block("encoder once a turn", "rad", "encoder.cos_rad", 2);
    block("laser 0 direction", "rad", "laser0.tilt_up_rad", 2);
    block("laser 0 offset", "mm", "laser0.offset_mm", 1);
    block("laser 1 direction", "rad", "laser1.tilt_up_rad", 2);
    block("laser 1 offset", "mm", "laser1.offset_mm", 1);
    if (index("platter.height_mm") < errors.size()) block("platter height", "mm", "platter.height_mm", 1);

    // What a scan sees: the axis from the laser's plane, at the platter and 100 mm above.
    const Eigen::Isometry3d& X_CW = solution.calibration.axis.X_CW;
    for (std::size_t i = 0; i < solution.calibration.lasers.size(); ++i) {
      const LaserPlane& plane = solution.calibration.lasers[i];
      const TrueMachine::Sheet& sheet = machine.sheets[i];
      const double sign = machine.normal_C(sheet).dot(plane.normal_C) < 0 ? -1 : 1;
      const Eigen::Vector3d &n = plane.normal_C, up = X_CW.linear().col(2), at = X_CW.translation();
      const Eigen::Vector3d in_plane = (up - n * n.dot(up)).normalized(), across = n.cross(in_plane);
      const Eigen::Vector3d anchor = at + n * (plane.distance_mm - n.dot(at));
      Eigen::Vector2d apart;
      Eigen::MatrixXd by = Eigen::MatrixXd::Zero(2, errors.size());
      for (int k = 0; k < 2; ++k) {
        const double z = 100 * k;
        const Eigen::Vector3d p = at + z * up;
        apart[k] =
            n.dot(p) - plane.distance_mm - sign * (sheet.normal_W.dot(Eigen::Vector3d(0, 0, z)) - sheet.distance_mm);
        const Eigen::Vector2d horizontal(n.dot(X_CW.linear().col(0)), n.dot(X_CW.linear().col(1)));
        by.row(k).segment<2>(index("axis.tilt_x_rad")) = z * horizontal.transpose();
        by.row(k).segment<2>(index("axis.x_mm")) = horizontal.transpose();
        by.row(k).segment<3>(index("laser" + std::to_string(plane.laser) + ".tilt_up_rad"))
            << (p - anchor).dot(in_plane),
            (p - anchor).dot(across), -1;
      }
      of("axis from laser " + std::to_string(plane.laser), "mm").add(apart, by * C * by.transpose());
    }

    for (int laser = 0; laser < 2; ++laser) {
      for (double radius : {15.0, 30.0}) {
        for (double r : scanned_radii(solution.calibration, machine, laser, radius)) {
          radius_squares_ += (r - radius) * (r - radius);
          largest_radius_share_ =
              std::max(largest_radius_share_, std::abs(r - radius) / solution.calibration.systematic_mm);
          ++radii_;
        }
      }
    }
    systematic_squares_ += solution.calibration.systematic_mm * solution.calibration.systematic_mm;
    const double dof = solution.degrees_of_freedom;
    residual_.chi_square += solution.chi_square;
    residual_dof_ += dof;
    held_out_squares_ += solution.held_out_rms_px * solution.held_out_rms_px;
    ++seeds_;
  }

  const std::vector<ErrorBlock>& blocks() const { return blocks_; }
  double radius_rms() const { return std::sqrt(radius_squares_ / radii_); }
  double systematic_rms() const { return std::sqrt(systematic_squares_ / seeds_); }
  double largest_radius_share() const { return largest_radius_share_; }
  double residual_chi_square() const { return residual_.chi_square; }
  double residual_dof() const { return residual_dof_; }
  double held_out_rms() const { return std::sqrt(held_out_squares_ / seeds_); }

 private:
  ErrorBlock& of(const std::string& name, const std::string& unit) {
    for (ErrorBlock& block : blocks_) {
      if (block.name == name) return block;
    }
    blocks_.push_back({name, unit});
    return blocks_.back();
  }

  std::vector<ErrorBlock> blocks_;
  ErrorBlock residual_;
  double residual_dof_ = 0, radius_squares_ = 0, systematic_squares_ = 0, largest_radius_share_ = 0,
         held_out_squares_ = 0;
  int radii_ = 0, seeds_ = 0;
};

/// A machine whose print was measured with an error drawn from its stated uncertainty.
inline CalibrationInput seen_with_measured_print(TrueMachine& machine, std::uint64_t seed, double u_pitch,
                                                 const Programme& programme) {
  std::mt19937_64 random(seed * 7919 + 17);
  std::normal_distribution<double> normal(0, u_pitch);
  machine.pitch = {1 + normal(random), 1 + normal(random)};
  CalibrationInput input = seen_of(machine, seed, programme);
  input.pitch_x = input.pitch_y = {1, u_pitch};
  return input;
}

}  // namespace celadon::test
