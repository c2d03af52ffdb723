#pragma once
// Collects what is found about one step of a calibration.

#include <string>

#include "acquisition/calibrate/calibration_solver.h"

namespace celadon::calibrate {

/// A number for people: three significant digits.
std::string figure(double value);

class StepJudge {
 public:
  explicit StepJudge(std::string name) {
    step_.name = std::move(name);
    step_.verdict = Verdict::good;
  }
  /// A value that should be small: good and usable up to and with the limits. A value that is not finite is refused.
  void at_most(const std::string& what, double value, const std::string& unit, double good, double usable,
               const std::string& remedy);
  /// A value that should be large.
  void at_least(const std::string& what, double value, const std::string& unit, double good, double usable,
                const std::string& remedy);
  /// Something that is no number; without a remedy if the verdict is good.
  void say(Verdict verdict, const std::string& finding, const std::string& remedy = {});
  /// One sentence each for finding and remedies.
  CalibrationStep step() const;

 private:
  void compare(const std::string& text, Verdict verdict, const std::string& remedy);

  CalibrationStep step_;
};

}  // namespace celadon::calibrate
