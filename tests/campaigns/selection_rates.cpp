// How often the model selection is right: every scenario, many seeds. Prints a table; exit code 1 if any rate is below
// its bar. Usage: selection_rates [trials = 40] [samples = 100000]
#include <cstdio>
#include <cstdlib>
#include <map>

#include "tests/fitting/selection_scenarios.h"

int main(int argc, char** argv) {
  using namespace celadon;
  const int trials = argc > 1 ? std::atoi(argv[1]) : 40;
  const int side = static_cast<int>(std::sqrt(argc > 2 ? std::atof(argv[2]) : 1e5));
  bool good = true;
  std::printf("%d scans of %d x %d samples each, noise 20 um, form tolerance 3 um\n", trials, side, side);
  std::printf("%-34s %-14s %7s %7s  chosen\n", "object", "expected", "right", "kappa");
  for (const auto& scenario : test::selection_scenarios()) {
    std::map<SurfaceModel, int> chosen;
    double kappa = 0;
    for (int k = 0; k < trials; ++k) {
      test::MemoryStream stream = test::scan(scenario.shape, {.profiles = side,
                                                              .rows = side,
                                                              .sigma = test::kSelectionSigma,
                                                              .correlation = scenario.correlation,
                                                              .profile_sigma = scenario.common,
                                                              .seed = static_cast<unsigned>(1000 + k)});
      RangeFitOptions options;
      options.form_tolerance_mm = test::kSelectionDelta;
      options.smoothing = false;
      const auto fit = test::fit(stream, options);
      if (!fit) {
        std::printf("%s: %s\n", scenario.name.c_str(), fit.error().message.c_str());
        return 1;
      }
      ++chosen[fit->report.model];
      kappa += fit->report.kappa / trials;
    }
    std::string list;
    for (const auto& [model, count] : chosen)
      list += std::string(to_string(model)) + " " + std::to_string(count) + "  ";
    const double rate = 100.0 * chosen[scenario.expected] / trials;
    // A dent of 60 um over 4 mm lies below what 10^5 samples show.
    const bool counts = side >= 900 || scenario.name.find("dent") == std::string::npos;
    std::printf("%-34s %-14s %5.0f %% %7.2f  %s%s\n", scenario.name.c_str(), to_string(scenario.expected), rate, kappa,
                list.c_str(), counts ? (rate >= 97 ? "PASS" : "below 97 %") : "(too few samples to show)");
    good = good && (!counts || rate >= 97);
  }
  return good ? 0 : 1;
}
