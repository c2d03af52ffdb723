#include "fitting/local_variance.h"

#include <algorithm>
#include <vector>

namespace celadon {
namespace {

// Samples that one variance is taken from, and how many of the mean variance are thought to lie with them.
constexpr double kSamplesPerBlock = 256, kPriorSamples = 4;
constexpr double kVarianceResolution = 1e-7;

struct Block {
  double square = 0, samples = 0, left = 0;
};

}  // namespace

Eigen::MatrixXd variance_ratios(const CellResiduals& residuals, double lost_parameters, double mean_range) {
  const Eigen::MatrixXd &square = residuals.square, &samples = residuals.weight;
  const Eigen::Index nz = square.rows(), nv = square.cols();
  Eigen::MatrixXd ratios = Eigen::MatrixXd::Ones(nz, nv);
  const double floor = kVarianceResolution * mean_range, all_samples = samples.sum();
  if (square.sum() <= floor * floor * all_samples) return ratios;

  const double occupied = static_cast<double>((samples.array() > 0).count());
  Eigen::Index du = 1, dv = 1;
  while (all_samples / occupied * static_cast<double>(du * dv) < kSamplesPerBlock && (du < nz || dv < nv)) {
    if ((dv <= du && dv < nv) || du >= nz) {
      dv *= 2;
    } else {
      du *= 2;
    }
  }
  const Eigen::Index across = (nv + dv - 1) / dv;
  std::vector<Block> blocks(static_cast<std::size_t>(across * ((nz + du - 1) / du)));
  const auto block_of = [&](Eigen::Index i, Eigen::Index j) -> Block& {
    return blocks[static_cast<std::size_t>(i / du * across + j / dv)];
  };
  for (Eigen::Index j = 0; j < nv; ++j)
    for (Eigen::Index i = 0; i < nz; ++i) {
      Block& block = block_of(i, j);
      block.square += square(i, j);
      block.samples += samples(i, j);
      block.left += samples(i, j) > 0 ? samples(i, j) - lost_parameters / occupied : 0;
    }
  Block all;
  for (Block& block : blocks) {
    block.left = std::max(block.left, block.samples / 2);
    all.square += block.square;
    all.left += block.left;
  }
  const double mean = all.square / all.left;
  for (Eigen::Index j = 0; j < nv; ++j)
    for (Eigen::Index i = 0; i < nz; ++i) {
      const Block& block = block_of(i, j);
      ratios(i, j) = (block.square + kPriorSamples * mean) / (block.left + kPriorSamples) / mean;
    }
  return ratios;
}

}  // namespace celadon
