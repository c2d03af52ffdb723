#pragma once
// Camera, laser planes, rotary axis and encoder from views of a board, all at once, each with its uncertainty.

#include <Eigen/Core>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibrate/calibration_views.h"

namespace celadon {

enum class Verdict { good, usable, refused };

/// One step of a calibration, or one thing that limits it.
struct CalibrationStep {
  std::string name;  ///< "camera", "laser 0", "axis", "encoder", "scale", "platter", "elevation", "lift", "time"
  Verdict verdict = Verdict::refused;
  std::string finding;  ///< values and limits in one sentence
  std::string remedy;   ///< what to do; empty if good
};

struct CalibrationSolution {
  /// Identity, date and `simulated` are the caller's; the time model is the assumed one unless sweeps show it.
  /// systematic_mm: standard uncertainty of a radius that the parameters' joint covariance gives, the largest within
  /// the volume that the board filled, scale's included.
  Calibration calibration;
  std::vector<CalibrationStep> steps;
  Verdict verdict = Verdict::refused;  ///< the worst of the steps

  double corner_rms_px = 0;       ///< of the views used
  double held_out_rms_px = 0;     ///< of views that had no part in the parameters they were predicted with
  double held_out_raised_px = 0;  ///< the same of views with the head off 0, their poses predicted too; 0 without
  double held_out_lifted_px = 0;  ///< of views with the lift off 0
  double line_rms_mm = 0;         ///< distance of line points from their planes
  std::vector<int> left_out;      ///< views that disagree with the others
  /// Joint covariance of the parameters in the order of `names`, and the sums of squared normalised residuals.
  std::vector<std::string> names;
  Eigen::MatrixXd covariance;
  double chi_square = 0;
  int degrees_of_freedom = 0;
};

/// Elevation axis and lift are solved for where views of a placement were taken off 0 of them; that placement must be
/// seen at 0, too.
/// @return an error in one sentence if no parameters can be given at all (too few views, all alike, no axis motion)
tl::expected<CalibrationSolution, std::string> solve_calibration(const CalibrationInput& input);

}  // namespace celadon
