// How well the stated standard deviation of the surface agrees with what fits of simulated scans miss the truth by, and
// how often two of them cover it. Exit code 1 where stated and observed differ by more than 10 % or the cover is
// outside 93 to 97 %, on average over a grid of (u, v); where the sums have no finer knots, if they are less.
// Usage: coverage [runs = 400] [first scenario] [last scenario]
#include <cstdio>
#include <cstdlib>

#include "tests/fitting/coverage_scenarios.h"

int main(int argc, char** argv) {
  using namespace celadon;
  const int runs = argc > 1 ? std::atoi(argv[1]) : 400;
  const auto scenarios = test::coverage_scenarios();
  const int first = argc > 2 ? std::atoi(argv[2]) : 0,
            last = argc > 3 ? std::atoi(argv[3]) : static_cast<int>(scenarios.size()) - 1;
  bool good = true;
  std::printf("%d scans each, noise 20 um, 24 x 36 points; stated, observed, scatter: um, RMS over the points\n", runs);
  std::printf("%-26s %6s %7s %8s %7s %6s %9s %8s\n", "samples", "kappa", "stated", "observed", "scatter", "ratio",
              "covered", "at least");
  for (int k = first; k <= last; ++k) {
    const auto& scenario = scenarios[static_cast<std::size_t>(k)];
    test::CoverageCount count(scenario);
    for (int run = 0; run < runs; ++run) {
      const auto fit = test::coverage_fit(scenario, static_cast<unsigned>(1000 + run));
      if (!fit || !fit->deviation) {
        std::printf("%s: %s\n", scenario.name.c_str(), fit ? "no standard deviations" : fit.error().message.c_str());
        return 1;
      }
      count.add(scenario, *fit);
    }
    const auto r = count.result(false), u = count.result(true);
    const double ratio = r.stated / r.observed;
    const bool agrees = ratio >= 0.9 && (ratio <= 1.1 || scenario.no_finer),
               covers = r.covered >= 0.93 && (r.covered <= 0.97 || scenario.no_finer);
    std::printf("%-26s %6.2f %7.3f %8.3f %7.3f %6.3f %7.1f %% %6.1f %%  %s\n", scenario.name.c_str(),
                count.kappa / runs, 1e3 * r.stated, 1e3 * r.observed, 1e3 * r.scatter, ratio, 100 * r.covered,
                100 * r.least, agrees && covers ? "PASS" : "FAIL");
    if (scenario.hole)
      std::printf("%-26s %6s %7.3f %8.3f %7.3f %6.3f %7.1f %% %6.1f %%\n", "  where nothing was seen", "",
                  1e3 * u.stated, 1e3 * u.observed, 1e3 * u.scatter, u.stated / u.observed, 100 * u.covered,
                  100 * u.least);
    std::fflush(stdout);
    good = good && agrees && covers;
  }
  return good ? 0 : 1;
}
