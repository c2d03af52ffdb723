#include "daemon/checks/artefact_placement.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace celadon {
namespace {

using Eigen::Vector3d;

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr double kReach_mm = 4;     // from a ball's surface: within it points count for the ball
constexpr double kStep_mm = 4;      // of the search
constexpr double kBeside_mm = 25;   // the farthest placement that is looked for
constexpr double kFinest_mm = 0.1;  // step that ends the refinement
constexpr std::size_t kStarts = 30;
constexpr double kAsGood = 0.95;  // share of the best score

/// How well points explain the balls of an artefact at a placement.
class BallScore {
 public:
  BallScore(const Artefact& artefact, const Eigen::Matrix3Xd& points) {
    for (const CertifiedSphere& sphere : artefact.spheres) {
      Ball ball{sphere.centre_mm, sphere.diameter.value / 2, {}};
      farthest_ = std::max(farthest_, ball.centre_mm.head<2>().norm());
      std::vector<Eigen::Index> level;
      for (Eigen::Index i = 0; i < points.cols(); ++i) {
        if (std::abs(points(2, i) - ball.centre_mm.z()) < ball.radius_mm + kReach_mm) level.push_back(i);
      }
      ball.points.resize(3, static_cast<Eigen::Index>(level.size()));
      for (std::size_t k = 0; k < level.size(); ++k)
        ball.points.col(static_cast<Eigen::Index>(k)) = points.col(level[k]);
      balls_.push_back(std::move(ball));
    }
  }

  /// Largest distance of a ball from the artefact's axis, mm.
  double farthest_mm() const { return farthest_; }

  /// The root lets a ball with few points count beside one with many.
  double operator()(const ArtefactPlacement& placement) const {
    double score = 0;
    for (const Ball& ball : balls_) {
      const Vector3d centre = placement.point(ball.centre_mm);
      const Eigen::ArrayXd off =
          ((ball.points.colwise() - centre).colwise().norm().array() - ball.radius_mm).transpose() / kReach_mm;
      score += std::sqrt((1 - off.square()).max(0).sum());
    }
    return score;
  }

  /// Largest distance between where two placements put a ball.
  double apart_mm(const ArtefactPlacement& a, const ArtefactPlacement& b) const {
    double most = 0;
    for (const Ball& ball : balls_) most = std::max(most, (a.point(ball.centre_mm) - b.point(ball.centre_mm)).norm());
    return most;
  }

 private:
  struct Ball {
    Vector3d centre_mm;
    double radius_mm;
    Eigen::Matrix3Xd points;  ///< at its height
  };
  std::vector<Ball> balls_;
  double farthest_ = 1;
};

struct Candidate {
  ArtefactPlacement placement;
  double score = 0;
};

std::vector<Candidate> best_of_grid(const BallScore& score) {
  std::vector<Candidate> all;
  const int turns = static_cast<int>(std::ceil(kTurn_rad * score.farthest_mm() / kStep_mm));
  const int steps = static_cast<int>(kBeside_mm / kStep_mm);
  for (int k = 0; k < turns; ++k) {
    for (int i = -steps; i <= steps; ++i) {
      for (int j = -steps; j <= steps; ++j) {
        const ArtefactPlacement at{kTurn_rad * k / turns, {i * kStep_mm, j * kStep_mm, 0}};
        if (at.shift_mm.norm() <= kBeside_mm) all.push_back({at, score(at)});
      }
    }
  }
  const std::size_t kept = std::min(kStarts, all.size());
  std::partial_sort(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(kept), all.end(),
                    [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  all.resize(kept);
  return all;
}

/// Uphill, along one of the three unknowns at a time, in steps that are halved where none leads up.
void climb(const BallScore& score, Candidate& at) {
  double step_mm = kStep_mm / 2;
  while (step_mm >= kFinest_mm) {
    const Candidate before = at;
    for (int unknown = 0; unknown < 3; ++unknown) {
      for (const double side : {-1.0, 1.0}) {
        ArtefactPlacement next = at.placement;
        if (unknown == 2) {
          next.turn_rad += side * step_mm / score.farthest_mm();
        } else {
          next.shift_mm[unknown] += side * step_mm;
        }
        if (const double reached = score(next); reached > at.score) at = {next, reached};
      }
    }
    if (!(at.score > before.score)) step_mm /= 2;
  }
}

}  // namespace

Vector3d ArtefactPlacement::direction(const Vector3d& d) const {
  const double c = std::cos(turn_rad), s = std::sin(turn_rad);
  return {c * d.x() - s * d.y(), s * d.x() + c * d.y(), d.z()};
}

tl::expected<ArtefactPlacement, std::string> find_placement(const Artefact& artefact, const Eigen::Matrix3Xd& points) {
  const BallScore score(artefact, points);
  std::vector<Candidate> candidates = best_of_grid(score);
  for (Candidate& candidate : candidates) climb(score, candidate);
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  const Candidate& best = candidates.front();
  if (!(best.score > 0)) {
    return tl::unexpected<std::string>(
        "no ball of the artefact is found: nothing lies where one could be; put the artefact on the table, within 25 "
        "mm "
        "of the middle");
  }
  for (const Candidate& other : candidates) {
    if (other.score >= kAsGood * best.score && score.apart_mm(other.placement, best.placement) > 2 * kReach_mm) {
      return tl::unexpected<std::string>(
          "the artefact shows the same balls in two placements on the table, and which ball is which cannot be told; "
          "use one whose balls differ in height or in distance from the axis by 4 mm or more");
    }
  }
  return best.placement;
}

ArtefactPlacement placement_through(const Artefact& artefact, const std::vector<std::optional<Vector3d>>& centres) {
  Vector3d mean_A = Vector3d::Zero(), mean_S = Vector3d::Zero();
  double count = 0;
  for (std::size_t i = 0; i < centres.size(); ++i) {
    if (!centres[i]) continue;
    mean_A += artefact.spheres[i].centre_mm;
    mean_S += *centres[i];
    ++count;
  }
  mean_A /= count;
  mean_S /= count;
  double along = 0, across = 0;
  for (std::size_t i = 0; i < centres.size(); ++i) {
    if (!centres[i]) continue;
    const Vector3d a = artefact.spheres[i].centre_mm - mean_A, s = *centres[i] - mean_S;
    along += a.head<2>().dot(s.head<2>());
    across += a.x() * s.y() - a.y() * s.x();
  }
  ArtefactPlacement out{std::atan2(across, along), Vector3d::Zero()};
  out.shift_mm = mean_S - out.direction(mean_A);
  return out;
}

}  // namespace celadon
