#pragma once
// Every SIMD target that a program holds, one after the other.

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <cstdint>

#include "acquisition/laser_line.h"

namespace celadon {

/// Runs the body on every SIMD target that this processor has and this program holds. A program compiled with
/// HWY_COMPILE_ONLY_STATIC holds one, and needs nothing of Highway's library.
template <class Body>
void on_every_target(Body&& body) {
#if defined(HWY_COMPILE_ONLY_STATIC)
  SCOPED_TRACE(laser_line_simd_target());
  body();
#else
  const std::int64_t supported = hwy::SupportedTargets();
#if HWY_ARCH_X86
  const std::int64_t compiled = HWY_SSE4 | HWY_AVX2 | HWY_AVX3;
#else
  const std::int64_t compiled = supported;
#endif
  int targets = 0;
  for (std::int64_t rest = supported & compiled & ~(HWY_SCALAR | HWY_EMU128); rest != 0; rest &= rest - 1) {
    hwy::SetSupportedTargetsForTest(rest & -rest);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    SCOPED_TRACE(laser_line_simd_target());
    body();
    ++targets;
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  EXPECT_GE(targets, 1);
#endif
}

}  // namespace celadon
