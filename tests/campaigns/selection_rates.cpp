// How often the model selection is right: every scenario, white and AR 0.5 along the lines, at 10^4, 10^5 and 10^6
// samples. Prints a table; exit code 1 if a rate is below 95 % where there are samples enough to tell.
// Usage: selection_rates [trials at 10^5 = 20, twice as many at 10^4, half at 10^6] [first scenario] [last scenario]
#include <cstdio>
#include <cstdlib>
#include <map>

#include "tests/fitting/selection_scenarios.h"

int main(int argc, char** argv) {
  using namespace celadon;
  constexpr double kBar = 0.95;
  const int trials = argc > 1 ? std::atoi(argv[1]) : 20;
  const auto scenarios = test::selection_scenarios();
  const int first = argc > 2 ? std::atoi(argv[2]) : 0,
            last = argc > 3 ? std::atoi(argv[3]) : static_cast<int>(scenarios.size()) - 1;
  bool good = true;
  std::printf("noise 20 um, form tolerance 3 um; %d, %d and %d scans with 10^4, 10^5 and 10^6 samples; right in %%\n",
              2 * trials, trials, trials / 2);
  std::printf("%-32s %-14s %15s %15s %15s\n%47s %15s %15s\n", "object", "expected", "10^4", "10^5", "10^6",
              "white  AR 0.5", "white  AR 0.5", "white  AR 0.5");
  for (int k = first; k <= last; ++k) {
    const auto& scenario = scenarios[static_cast<std::size_t>(k)];
    std::printf("%-32s %-14s", scenario.name.c_str(),
                to_string(scenario.expected, scenario.sphere ? BaseKind::sphere : BaseKind::cylinder));
    std::string wrong;
    for (const double samples : {1e4, 1e5, 1e6}) {
      const int runs = samples < 1e5 ? 2 * trials : samples > 1e5 ? trials / 2 : trials;
      for (const double correlation : {0.0, 0.5}) {
        std::map<std::string, int> chosen;
        for (int run = 0; run < runs; ++run) {
          test::MemoryStream stream =
              test::selection_scan(scenario, samples, correlation, static_cast<unsigned>(1000 + run));
          const auto report = test::selection_fit(scenario, stream);
          ++chosen[report ? to_string(report->model) : report.error().message];
        }
        const double rate = static_cast<double>(chosen[to_string(scenario.expected)]) / runs;
        const bool counts = samples >= scenario.from, low = counts && rate < kBar;
        std::printf(" %6.0f%s", 100 * rate, low ? "!" : counts ? " " : "-");
        std::fflush(stdout);
        good = good && !low;
        chosen.erase(to_string(scenario.expected));
        for (const auto& [model, count] : chosen)
          if (counts) {
            char text[400];
            std::snprintf(text, sizeof text, "    at %.0e, AR %.1f: %d times %s\n", samples, correlation, count,
                          model.c_str());
            wrong += text;
          }
      }
    }
    std::printf("\n%s", wrong.c_str());
  }
  std::printf("-: too few samples to tell, no bar. !: below %.0f %%.\n", 100 * kBar);
  return good ? 0 : 1;
}
