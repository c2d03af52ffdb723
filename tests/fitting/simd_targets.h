#pragma once
// Every SIMD level this machine has, one after the other.

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <cstdint>

namespace celadon::test {

template <class Check>
void at_every_simd_level(const Check& check) {
  int levels = 0;
  for (std::int64_t supported = hwy::SupportedTargets(); supported != 0; supported &= supported - 1) {
    const std::int64_t target = supported & -supported;
    SCOPED_TRACE(hwy::TargetName(target));
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    check();
    ++levels;
    hwy::SetSupportedTargetsForTest(0);
  }
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  EXPECT_GE(levels, 1);
}

}  // namespace celadon::test
