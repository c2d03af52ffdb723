#pragma once
// Objects whose model is known, with micrometre errors a machine makes and samples as they come: shared by the test (a
// seeded sample) and the campaign that counts selection rates.

#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "fitting/own_frame.h"
#include "tests/fitting/fit_tools.h"
#include "tests/fitting/sphere_tools.h"

namespace celadon::test {

struct SelectionScenario {
  std::string name;
  std::function<double(double theta, double along)> range;  ///< along: z in mm, over a sphere phi
  SurfaceModel expected;
  double from = 1e4;           ///< samples from which on it can be told
  double tolerance_mm = 3e-3;  ///< form tolerance
  double common_mm = 0;        ///< standard deviation of an error common to a profile
  double contrast = 1;         ///< noise on one side of the object over that on the other
  double density = 1;          ///< samples on one side over those on the other
  double outliers = 0;         ///< share of samples that lie anywhere
  bool holes = false;          ///< 30 % of the surface without samples, in three windows
  bool off_centre = false;     ///< refitted about its own axis if that is simpler
  bool sphere = false;
  int profiles = 0;  ///< 0: as many as rows
};

inline constexpr double kSelectionSigma = 0.02;

inline std::vector<SelectionScenario> selection_scenarios() {
  using enum SurfaceModel;
  const double root2 = std::sqrt(2.0);
  const auto wavy = [](double z) { return 30 + 6 * std::sin(2 * kPi * z / 120); };
  const auto round = [](double, double) { return 30.0; };
  const auto vase = [=](double, double z) { return wavy(z); };
  const auto lobes = [=](double t, double z) { return wavy(z) + .010 * root2 * std::cos(3 * t); };
  // Seen from an axis 2 mm beside its own.
  const auto beside = [](double radius, double t) {
    const double y = 2 * std::sin(t);
    return 2 * std::cos(t) + std::sqrt(radius * radius - y * y);
  };
  // Over a sphere, lobes of RMS 1.
  const auto waves = [](double t, double p) { return std::cos(3 * t) * std::pow(std::sin(p), 2) / 0.516; };
  const auto ball = [](double, double) { return 25.0; };
  const auto egg = [](double, double p) { return 25 + 2 * std::cos(2 * p) + std::cos(p); };
  const auto lobed_egg = [=](double t, double p) { return egg(t, p) + .010 * waves(t, p); };

  std::vector<SelectionScenario> all{
      {"cylinder", round, cylinder},
      {"cylinder + 1 um runout", [=](double t, double) { return 30 + .001 * root2 * std::cos(2 * t + .4); }, cylinder},
      {"cylinder + 2 um runout", [=](double t, double) { return 30 + .002 * root2 * std::cos(2 * t + .4); }, cylinder},
      {"cylinder + 2 um along z", [=](double, double z) { return 30 + .002 * root2 * std::cos(2 * kPi * z / 40); },
       cylinder},
      {"cylinder + 5 um, 6 tolerated", [=](double t, double) { return 30 + .005 * root2 * std::cos(2 * t + .4); },
       cylinder, 1e4, 6e-3},
      {"cam of 20 um", [=](double t, double) { return 30 + .02 * root2 * std::cos(3 * t); }, translational},
      {"revolution", vase, revolution},
      {"revolution + 1 um", [=](double t, double z) { return wavy(z) + .001 * root2 * std::cos(2 * t + z / 30); },
       revolution},
      {"revolution + 2 um", [=](double t, double z) { return wavy(z) + .002 * root2 * std::cos(2 * t + z / 30); },
       revolution},
      {"revolution + 5 um, 6 tolerated",
       [=](double t, double z) { return wavy(z) + .005 * root2 * std::cos(2 * t + z / 30); }, revolution, 1e4, 6e-3},
      {"revolution + 10 um lobes", lobes, general},
      {"revolution + 60 um dent of 4 mm",
       [=](double t, double z) {
         return wavy(z) - .06 * std::exp(-(std::pow(30 * (t - 2), 2) + std::pow(z - 50, 2)) / 8);
       },
       general, 1e6},
      {"freeform", freeform, general},
      {.name = "cylinder, 5 um a profile", .range = round, .expected = cylinder, .common_mm = .005},
      {.name = "revolution, 20 um a profile", .range = vase, .expected = revolution, .common_mm = .02},
      {.name = "cam of 20 um, 20 um a profile",
       .range = [=](double t, double) { return 30 + .02 * root2 * std::cos(3 * t); },
       .expected = translational,
       .common_mm = .02},
      {.name = "freeform, 40 profiles", .range = freeform, .expected = general, .profiles = 40},
      {.name = "cylinder off by 2 mm",
       .range = [=](double t, double) { return beside(30, t); },
       .expected = cylinder,
       .off_centre = true},
      {.name = "revolution off by 2 mm",
       .range = [=](double t, double z) { return beside(wavy(z), t); },
       .expected = revolution,
       .off_centre = true},
      {.name = "10 um lobes, off by 2 mm",
       .range = [=](double t, double z) { return beside(lobes(t, z), t); },
       .expected = general,
       .off_centre = true},
      {.name = "sphere", .range = ball, .expected = cylinder, .sphere = true},
      {.name = "sphere + 2 um",
       .range = [=](double t, double p) { return 25 + .002 * waves(t, p); },
       .expected = cylinder,
       .sphere = true},
      {.name = "sphere + 5 um, 6 tolerated",
       .range = [=](double t, double p) { return 25 + .005 * waves(t, p); },
       .expected = cylinder,
       .tolerance_mm = 6e-3,
       .sphere = true},
      {.name = "egg", .range = egg, .expected = revolution, .sphere = true},
      {.name = "egg + 2 um",
       .range = [=](double t, double p) { return egg(t, p) + .002 * waves(t, p); },
       .expected = revolution,
       .sphere = true},
      {.name = "egg + 10 um lobes", .range = lobed_egg, .expected = general, .sphere = true},
      {.name = "egg + 60 um dent of 4 mm",
       .range =
           [=](double t, double p) {
             const double a = std::cos(p) * std::cos(1.2) + std::sin(p) * std::sin(1.2) * std::cos(t - 2);
             return egg(t, p) - .06 * std::exp(-625 * 2 * (1 - a) / 8);
           },
       .expected = general,
       .from = 1e6,
       .sphere = true}};
  // Every way in which samples come unevenly, on each kind of object.
  const std::vector<SelectionScenario> kinds{
      {"cylinder", round, cylinder},
      {"revolution", vase, revolution},
      {"10 um lobes", lobes, general},
      {.name = "sphere", .range = ball, .expected = cylinder, .sphere = true},
      {.name = "egg", .range = egg, .expected = revolution, .sphere = true},
      {.name = "lobed egg", .range = lobed_egg, .expected = general, .sphere = true}};
  for (const SelectionScenario& kind : kinds)
    for (const char* way : {"30 % holes", "10 % outliers", "density 1:20", "noise 1:5"}) {
      SelectionScenario s = kind;
      s.name += std::string(", ") + way;
      s.holes = way[0] == '3';
      s.outliers = way[0] == '1' ? 0.1 : 0;
      s.density = way[0] == 'd' ? 20 : 1;
      s.contrast = way[0] == 'n' ? 5 : 1;
      all.push_back(std::move(s));
    }
  return all;
}

/// About so many samples, AR(1) along the lines.
inline MemoryStream selection_scan(const SelectionScenario& s, double samples, double correlation, unsigned seed) {
  const double kept = (s.holes ? 0.7 : 1) * (s.density > 1 ? (1 - 1 / s.density) / std::log(s.density) : 1);
  const double side = std::sqrt(samples / kept);
  const int profiles = s.profiles > 0 ? s.profiles : static_cast<int>(side),
            rows = static_cast<int>(side * side / profiles);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  MemoryStream stream;
  for (int i = 0; i < profiles; ++i) {
    Profile p;
    p.index = static_cast<std::uint32_t>(i);
    const double theta = 2 * kPi * (i + 0.5) / profiles, common = s.common_mm * normal(random);
    const double around = std::abs(theta / kPi - 1);  // 1 at 0, 0 at 180 degrees
    const double sigma = kSelectionSigma * std::pow(s.contrast, around - 0.5);
    double e = normal(random);
    for (int j = 0; j < rows; ++j) {
      if (j) e = correlation * e + std::sqrt(1 - correlation * correlation) * normal(random);
      const double height = s.sphere ? (j + 0.5) / rows : static_cast<double>(j) / (rows - 1);
      if (s.holes && std::abs(std::fmod(height * 3, 1) - 0.5) < 0.3 &&
          std::abs(std::fmod(theta / (2 * kPi) + height * 3 - std::fmod(height * 3, 1), 1) - 0.5) < 0.25)
        continue;
      if (s.density > 1 && share(random) > std::pow(s.density, -around)) continue;
      const double along = height * (s.sphere ? kPi : 120);
      double r = s.range(theta, along) + sigma * e + common;
      if (s.outliers > 0 && share(random) < s.outliers) r = 15 + 25 * share(random);
      if (s.sphere) {
        push(p, r * std::sin(along), theta, r * std::cos(along));
      } else {
        push(p, r, theta, along);
      }
      p.row.push_back(static_cast<std::uint16_t>(j));
    }
    stream.profiles.push_back(std::move(p));
  }
  return stream;
}

/// The report of the fit: about the part's own axis where that is what the program would do.
inline tl::expected<RangeFitReport, FitError> selection_fit(const SelectionScenario& s, MemoryStream& stream) {
  RangeFitOptions options;
  options.form_tolerance_mm = s.tolerance_mm;
  options.smoothing = false;
  if (s.sphere) {
    const auto fit = fit_sphere(stream, options);
    if (!fit) return tl::unexpected(fit.error());
    return fit->report;
  }
  const auto grid = choose_grid(stream, options);
  if (!grid) return tl::unexpected(grid.error());
  const GatheredSamples gathered = gather(stream, *grid);
  ProfileStream* const whole[] = {&stream};
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options);
  if (!surface) return tl::unexpected(surface.error());
  if (s.off_centre)
    if (const auto own = fit_in_own_frame(*surface, gathered.look, whole, options)) return own->surface.fit.report;
  return surface->fit.report;
}

}  // namespace celadon::test
