#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "acquisition/calibrate/bundle.h"

namespace celadon::test {

/// Those of a term's residuals by each of its parameters, against central differences.
inline void expect_true_derivatives(const calibrate::Term& term) {
  const auto& sizes = term.cost->parameter_block_sizes();
  ASSERT_EQ(sizes.size(), term.blocks.size());
  const auto count = static_cast<std::size_t>(term.cost->num_residuals());
  std::vector<std::vector<double>> jacobians;
  std::vector<double*> targets;
  for (int size : sizes) jacobians.emplace_back(count * static_cast<std::size_t>(size));
  for (auto& jacobian : jacobians) targets.push_back(jacobian.data());
  std::vector<double> r(count), above(count), below(count);
  ASSERT_TRUE(term.cost->Evaluate(term.blocks.data(), r.data(), targets.data()));
  for (std::size_t b = 0; b < sizes.size(); ++b) {
    const auto size = static_cast<std::size_t>(sizes[b]);
    for (std::size_t i = 0; i < size; ++i) {
      double& x = term.blocks[b][i];
      const double at = x, step = 1e-5 * std::max(1e-1, std::min(std::abs(at), 100.0));
      x = at + step;
      ASSERT_TRUE(term.cost->Evaluate(term.blocks.data(), above.data(), nullptr));
      x = at - step;
      ASSERT_TRUE(term.cost->Evaluate(term.blocks.data(), below.data(), nullptr));
      x = at;
      double largest = 1;
      for (std::size_t k = 0; k < count; ++k) largest = std::max(largest, std::abs(jacobians[b][k * size + i]));
      for (std::size_t k = 0; k < count; ++k) {
        EXPECT_NEAR(jacobians[b][k * size + i], (above[k] - below[k]) / (2 * step), 2e-5 * largest)
            << "block " << b << " of " << sizes.size() << ", parameter " << i;
      }
    }
  }
}

}  // namespace celadon::test
