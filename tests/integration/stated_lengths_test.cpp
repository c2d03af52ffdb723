#include "tests/integration/stated_lengths.h"

#include <gtest/gtest.h>

namespace celadon::test {
namespace {

// A sample of the campaign stated_lengths.
TEST(StatedLengths, CoverWhatMachinesDoBeyondTheModel) {
  StatedLengths lengths;
  for (std::uint64_t seed = 300; seed < 308; ++seed) ASSERT_EQ(lengths.add(seed), "") << seed;
  // 48 values, six of each calibration and so not independent.
  EXPECT_GE(lengths.pooled_coverage(), 0.85);
  EXPECT_LE(lengths.pooled_excess(), 1.7);
  EXPECT_GE(lengths.agreement(), 0.9);
  for (const StatedSize& size : lengths.sizes()) {
    if (size.unit != "mm") continue;
    EXPECT_LT(size.rms(), 0.05) << size.name;
  }
}

}  // namespace
}  // namespace celadon::test
