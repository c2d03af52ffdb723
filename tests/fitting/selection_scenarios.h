#pragma once
// Objects whose model is known, with micrometre errors a machine makes: shared by the test (a seeded sample) and the
// campaign that counts selection rates.

#include <cmath>
#include <string>
#include <vector>

#include "tests/fitting/fit_tools.h"

namespace celadon::test {

struct SelectionScenario {
  std::string name;
  Shape shape;
  double correlation;
  SurfaceModel expected;
  double common = 0;  ///< standard deviation of an error common to a profile, mm
};

/// delta = 3 micrometres, noise 20 micrometres in all of them.
inline constexpr double kSelectionDelta = 3e-3, kSelectionSigma = 0.02;

inline std::vector<SelectionScenario> selection_scenarios() {
  const double root2 = std::sqrt(2.0);
  const auto wavy = [](double z) { return 30 + 6 * std::sin(2 * kPi * z / 120); };
  return {
      {"cylinder, white", [](double, double) { return 30.0; }, 0, SurfaceModel::cylinder},
      {"cylinder, AR .5", [](double, double) { return 30.0; }, .5, SurfaceModel::cylinder},
      {"cylinder + 2 um runout", [=](double t, double) { return 30 + .002 * root2 * std::cos(2 * t + .4); }, .5,
       SurfaceModel::cylinder},
      {"cylinder + 2 um along z", [=](double, double z) { return 30 + .002 * root2 * std::cos(2 * kPi * z / 40); }, .5,
       SurfaceModel::cylinder},
      {"revolution, white", [=](double, double z) { return wavy(z); }, 0, SurfaceModel::revolution},
      {"revolution, AR .5", [=](double, double z) { return wavy(z); }, .5, SurfaceModel::revolution},
      {"revolution + 2 um", [=](double t, double z) { return wavy(z) + .002 * root2 * std::cos(2 * t + z / 30); }, .5,
       SurfaceModel::revolution},
      {"revolution + 10 um lobes", [=](double t, double z) { return wavy(z) + .010 * root2 * std::cos(3 * t); }, .5,
       SurfaceModel::general},
      {"revolution + 60 um dent of 4 mm",
       [=](double t, double z) {
         return wavy(z) - .06 * std::exp(-(std::pow(30 * (t - 2), 2) + std::pow(z - 50, 2)) / 8);
       },
       .5, SurfaceModel::general},
      {"cam of 20 um", [=](double t, double) { return 30 + .02 * root2 * std::cos(3 * t); }, .5,
       SurfaceModel::translational},
      {"cylinder, 5 um a profile", [](double, double) { return 30.0; }, .5, SurfaceModel::cylinder, .005},
      {"revolution, 20 um a profile", [=](double, double z) { return wavy(z); }, .5, SurfaceModel::revolution, .02},
      {"cam of 20 um, 20 um a profile", [=](double t, double) { return 30 + .02 * root2 * std::cos(3 * t); }, .5,
       SurfaceModel::translational, .02},
  };
}

}  // namespace celadon::test
