#include "fitting/covered_angles.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace celadon {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr double kPerBin = 30;  // points of an even cloud
constexpr int kFewestBins = 36, kMostBins = 1440;
constexpr double kStrays = 0.05;  // of the usual count: fewer are no part of the object
constexpr double kLeastGap = 10 * std::numbers::pi / 180;

}  // namespace

BaseArcs covered_angles(const Eigen::Matrix3Xd& points) {
  const int bins = std::clamp(static_cast<int>(static_cast<double>(points.cols()) / kPerBin), kFewestBins, kMostBins);
  std::vector<std::vector<double>> angles(static_cast<std::size_t>(bins));
  for (const auto& p : points.colwise()) {
    const double turn = std::atan2(p.y(), p.x()) / kTurn, share = turn - std::floor(turn);
    angles[static_cast<std::size_t>(std::min(static_cast<int>(share * bins), bins - 1))].push_back(share * kTurn);
  }
  if (points.cols() == 0) return BaseArcs::full_circle();
  // The usual count is that of the bin in which the middle point lies: bins of strays may be more than the others.
  std::vector<std::size_t> counts;
  for (const auto& bin : angles) counts.push_back(bin.size());
  std::sort(counts.begin(), counts.end());
  auto usual = counts.begin();
  for (std::size_t below = *usual; 2 * below < static_cast<std::size_t>(points.cols()); below += *usual) ++usual;
  const double needed = std::max(1.0, kStrays * static_cast<double>(*usual));
  const auto at = [&](int k) -> const std::vector<double>& {
    return angles[static_cast<std::size_t>((k + bins) % bins)];
  };
  const auto covered = [&](int k) { return static_cast<double>(at(k).size()) >= needed; };
  int longest = 0, after = 0;  // bins of the widest gap, and the first one behind it
  for (int first = 0; first < bins; ++first) {
    if (covered(first) || !covered(first - 1)) continue;
    int length = 1;
    while (!covered(first + length)) ++length;
    if (length > longest) longest = length, after = first + length;
  }
  if (longest == 0) return BaseArcs::full_circle();
  const double start = *std::min_element(at(after).begin(), at(after).end());
  double end = *std::max_element(at(after - longest - 1).begin(), at(after - longest - 1).end());
  if (end <= start) end += kTurn;
  return kTurn - (end - start) < kLeastGap ? BaseArcs::full_circle() : BaseArcs::open(start, end - start);
}

}  // namespace celadon
