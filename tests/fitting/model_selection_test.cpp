#include "fitting/model_selection.h"

#include <gtest/gtest.h>

#include "tests/fitting/selection_scenarios.h"

namespace celadon {
namespace {

// One scan of each scenario at 2 x 10^4 samples with correlated noise (the campaign selection_rates counts many).
class ModelSelection : public testing::TestWithParam<test::SelectionScenario> {};

TEST_P(ModelSelection, ChoosesTheModelOfTheObject) {
  test::MemoryStream stream = test::selection_scan(GetParam(), 2e4, 0.5, 5);
  const auto report = test::selection_fit(GetParam(), stream);
  ASSERT_TRUE(report) << report.error().message;
  EXPECT_EQ(report->model, GetParam().expected) << report->decided_by;
}

INSTANTIATE_TEST_SUITE_P(Scenarios, ModelSelection, testing::ValuesIn([] {
                           auto all = test::selection_scenarios();
                           std::erase_if(all, [](const auto& s) { return s.from > 1e5; });
                           return all;
                         }()),
                         [](const auto& scenario) {
                           std::string name = scenario.param.name;
                           std::erase_if(name, [](char c) { return !std::isalnum(static_cast<unsigned char>(c)); });
                           return name;
                         });

// A scanner's grid: fixed before the scan, with a margin, and finer around than there are profiles. The errors of a
// profile have a part in common; what repeats from profile to profile is the object's.
TEST(ModelSelectionRule, ErrorsCommonToAProfileAreNoShape) {
  const auto cylinder = [](double, double) { return 30.0; };
  const auto cam = [](double t, double) { return 30 + 0.02 * std::sqrt(2.0) * std::cos(3 * t); };
  for (const int profiles : {60, 300, 3600})
    for (const double common : {0.0, 0.005, 0.02})
      for (const bool lobes : {false, true}) {
        test::MemoryStream stream =
            test::scan(lobes ? test::Shape(cam) : test::Shape(cylinder), {.profiles = profiles,
                                                                          .rows = profiles > 1000 ? 100 : 300,
                                                                          .sigma = 0.02,
                                                                          .profile_sigma = common,
                                                                          .seed = 3});
        const MomentGrid sums = test::accumulate(stream, {-14, 134, 32, 32, 3, 3});
        RangeFitOptions options;
        options.form_tolerance_mm = 3e-3;
        const auto fit = fit_range(sums, stream, options);
        ASSERT_TRUE(fit) << fit.error().message;
        EXPECT_EQ(fit->report.model, lobes ? SurfaceModel::translational : SurfaceModel::cylinder)
            << profiles << " profiles, " << common << " mm in common: " << fit->report.decided_by;
      }
}

// Where the samples begin inside a cell its functions have few of them: chance moves those more.
TEST(ModelSelectionRule, PartlyFilledCellsAtTheRimDecideNothing) {
  for (unsigned seed = 1; seed <= 12; ++seed) {
    test::MemoryStream stream =
        test::scan([](double, double) { return 30.0; }, {.profiles = 100, .rows = 100, .sigma = 0.01, .seed = seed});
    const MomentGrid sums = test::accumulate(stream, {-6, 126, 32, 8, 3, 3});
    const auto fit = fit_range(sums, stream);
    ASSERT_TRUE(fit) << fit.error().message;
    EXPECT_EQ(fit->report.model, SurfaceModel::cylinder) << "seed " << seed << ": " << fit->report.decided_by;
  }
}

// Runout ten times the form tolerance is refused with it, and without.
TEST(ModelSelectionRule, ToleranceAndStatisticsAreToldApart) {
  const auto runout = [](double t, double) { return 30 + 0.005 * std::cos(2 * t); };
  const auto decide = [&](double delta) {
    test::MemoryStream stream = test::scan(runout, {.profiles = 400, .rows = 400, .sigma = 0.01});
    RangeFitOptions options;
    options.form_tolerance_mm = delta;
    const auto fit = test::fit(stream, options);
    return std::pair(fit->report.model, fit->report.decided_by);
  };
  const auto tight = decide(1e-4), wide = decide(0.01);
  EXPECT_EQ(tight.first, SurfaceModel::translational);
  EXPECT_EQ(wide.first, SurfaceModel::cylinder);
  EXPECT_NE(wide.second.find("the samples alone say translational"), std::string::npos) << wide.second;
}

}  // namespace
}  // namespace celadon
