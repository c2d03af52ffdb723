#include "acquisition/datum/datum_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <set>
#include <utility>

#include "acquisition/lens.h"

namespace celadon {
namespace {

using Eigen::Index;
using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kTurn_rad = 2 * std::numbers::pi;
constexpr Index kKnots = 17, kParts = 8, kMotion = 6;
constexpr Index kRest = 0, kFirstKnot = 1, kFirstMotion = kFirstKnot + kKnots,
                kFirstTag = kFirstMotion + kParts * kMotion;
// Before anything is seen. A turn of the camera about the table's axis looks like one of the table: the camera's shift
// that it takes is the less likely of the two.
constexpr double kAngle_rad = 1, kCameraTurn_rad = 0.02, kCameraShift_mm = 0.2;
constexpr double kSmallestTag_mm = 0.005;
constexpr int kRounds = 5;

/// Derivatives of a tag's place in the picture.
struct Derivatives {
  Vector2d by_angle;
  Eigen::Matrix<double, 2, 6> by_camera;  ///< turn about, shift along the camera's axes, of the scene against it
  Matrix2d by_tag;                        ///< by its place on the platter, x and y at table angle 0, mm
};

class Places {
 public:
  explicit Places(const Calibration& calibration) : calibration_(calibration), lens_(calibration.camera_model) {}

  /// How far the tag lies from where it is expected if the table has turned by so much more.
  Vector2d turned_px(const TagSighting& sighting, double more_rad) const {
    const RimTag& tag = calibration_.rim_tags[sighting.tag];
    return project(tag_middle_C(calibration_, tag, sighting.angle_rad + more_rad)) -
           project(tag_middle_C(calibration_, tag, sighting.angle_rad));
  }

  /// There.
  Derivatives at(const TagSighting& sighting, double more_rad) const {
    const RimTag& tag = calibration_.rim_tags[sighting.tag];
    const double angle_rad = sighting.angle_rad + more_rad;
    const Vector3d p = tag_middle_C(calibration_, tag, angle_rad);
    constexpr double kSmall = 1e-4;
    const auto by = [&](const Vector3d& d) -> Vector2d {  // per unit of d
      return (project(p + kSmall * d) - project(p - kSmall * d)) / (2 * kSmall);
    };
    Derivatives out;
    out.by_angle = (project(tag_middle_C(calibration_, tag, angle_rad + kSmall)) -
                    project(tag_middle_C(calibration_, tag, angle_rad - kSmall))) /
                   (2 * kSmall);
    for (Index k = 0; k < 3; ++k) {
      out.by_camera.col(k) = by(Vector3d::Unit(k).cross(p));
      out.by_camera.col(3 + k) = by(Vector3d::Unit(k));
    }
    const Eigen::Matrix3d R = calibration_.axis.X_CW.linear() *
                              Eigen::AngleAxisd(angle_rad, Vector3d::UnitZ()).toRotationMatrix() /
                              calibration_.scale.value;
    for (Index k = 0; k < 2; ++k) out.by_tag.col(k) = by(R.col(k));
    return out;
  }

 private:
  Vector2d project(const Vector3d& p) const { return lens_.project(p.x() / p.z(), p.y() / p.z()); }
  const Calibration& calibration_;
  const Lens lens_;
};

Index part_of(double turned_rad) {
  return std::clamp<Index>(static_cast<Index>(std::floor(turned_rad / kTurn_rad * kParts)), 0, kParts - 1);
}

/// The two knots about a place of the turn, and the share of the second.
struct Between {
  Index knot = 0;
  double share = 0;
};
Between knots_about(double turned_rad) {
  const double at = std::min(turned_rad / kTurn_rad, 1.) * (kKnots - 1);
  const Index knot = std::min<Index>(static_cast<Index>(at), kKnots - 2);
  return {knot, at - static_cast<double>(knot)};
}

double table_error(const Eigen::VectorXd& x, double turned_rad) {
  if (turned_rad < 0) return x[kRest];
  const auto [knot, share] = knots_about(turned_rad);
  return (1 - share) * x[kFirstKnot + knot] + share * x[kFirstKnot + knot + 1];
}

/// One sighting as two equations in few of the unknowns.
struct Equation {
  std::array<Index, 10> columns{};
  Eigen::Matrix<double, 2, 10> A = Eigen::Matrix<double, 2, 10>::Zero();
  int used = 0;
  Vector2d seen_px = Vector2d::Zero();  ///< as if they were linear from 0 on
  void put(Index column, const Vector2d& derivative) {
    columns[static_cast<std::size_t>(used)] = column;
    A.col(used++) = derivative;
  }
};

Equation equation_of(const DatumSighting& sighting, const Derivatives& d) {
  Equation e;
  if (sighting.turned_rad < 0) {
    e.put(kRest, d.by_angle);
  } else {
    const auto [knot, share] = knots_about(sighting.turned_rad);
    e.put(kFirstKnot + knot, (1 - share) * d.by_angle);
    e.put(kFirstKnot + knot + 1, share * d.by_angle);
  }
  const Index motion = kFirstMotion + part_of(sighting.turned_rad) * kMotion;
  for (Index k = 0; k < kMotion; ++k) e.put(motion + k, d.by_camera.col(k));
  const Index tag = kFirstTag + 2 * static_cast<Index>(sighting.tag.tag);
  for (Index k = 0; k < 2; ++k) e.put(tag + k, d.by_tag.col(k));
  return e;
}

double median_of(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

Vector2d predicted(const Equation& e, const Eigen::VectorXd& x) {
  Vector2d out = Vector2d::Zero();
  for (int k = 0; k < e.used; ++k) out += e.A.col(k) * x[e.columns[static_cast<std::size_t>(k)]];
  return out;
}

}  // namespace

std::optional<DatumReading> read_datum(const Calibration& calibration, std::span<const DatumSighting> sightings) {
  std::set<std::size_t> tags;
  std::set<Index> parts;
  for (const DatumSighting& s : sightings) {
    tags.insert(s.tag.tag);
    if (s.turned_rad >= 0) parts.insert(part_of(s.turned_rad));
  }
  if (tags.size() < 3 || 2 * static_cast<Index>(parts.size()) < kParts) return std::nullopt;

  const Places places(calibration);
  std::vector<Equation> equations(sightings.size());

  const Index unknowns = kFirstTag + 2 * static_cast<Index>(calibration.rim_tags.size());
  Eigen::VectorXd prior(unknowns);  // information
  prior.head(kFirstMotion).setConstant(1 / (kAngle_rad * kAngle_rad));
  for (Index part = 0; part < kParts; ++part) {
    prior.segment(kFirstMotion + part * kMotion, 3).setConstant(1 / (kCameraTurn_rad * kCameraTurn_rad));
    prior.segment(kFirstMotion + part * kMotion + 3, 3).setConstant(1 / (kCameraShift_mm * kCameraShift_mm));
  }
  for (std::size_t tag = 0; tag < calibration.rim_tags.size(); ++tag) {
    const double u = std::max(calibration.rim_tags[tag].u_mm, kSmallestTag_mm);
    prior.segment(kFirstTag + 2 * static_cast<Index>(tag), 2).setConstant(1 / (u * u));
  }

  Eigen::VectorXd x = Eigen::VectorXd::Zero(unknowns);
  Eigen::MatrixXd C;
  std::vector<double> weights(sightings.size(), 1);
  double inflation = 1, residual_px = 0;
  for (int round = 0; round < kRounds; ++round) {
    Eigen::MatrixXd N = prior.asDiagonal();
    Eigen::VectorXd b = Eigen::VectorXd::Zero(unknowns);
    for (std::size_t s = 0; s < sightings.size(); ++s) {
      const double error = table_error(x, sightings[s].turned_rad);
      const Derivatives d = places.at(sightings[s].tag, error);
      Equation& e = equations[s] = equation_of(sightings[s], d);
      e.seen_px = sightings[s].tag.shift_px - places.turned_px(sightings[s].tag, error) + d.by_angle * error;
      const Matrix2d W = weights[s] / inflation * sightings[s].tag.information;
      const Eigen::Matrix<double, 10, 2> AtW = e.A.transpose() * W;
      const Eigen::Matrix<double, 10, 10> AtWA = AtW * e.A;
      const Eigen::Matrix<double, 10, 1> AtWb = AtW * e.seen_px;
      for (int i = 0; i < e.used; ++i) {
        b[e.columns[static_cast<std::size_t>(i)]] += AtWb[i];
        for (int j = 0; j < e.used; ++j) {
          N(e.columns[static_cast<std::size_t>(i)], e.columns[static_cast<std::size_t>(j)]) += AtWA(i, j);
        }
      }
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(N);
    x = solver.solve(b);
    if (round + 1 == kRounds) C = solver.solve(Eigen::MatrixXd::Identity(unknowns, unknowns));
    // Squared distances in the sightings' own standard deviations; the median of two normal coordinates is 2 ln 2.
    std::vector<double> squares, lengths;
    for (std::size_t s = 0; s < sightings.size(); ++s) {
      const Vector2d r = equations[s].seen_px - predicted(equations[s], x);
      squares.push_back(r.dot(sightings[s].tag.information * r));
      lengths.push_back(r.squaredNorm());
    }
    residual_px = std::sqrt(median_of(lengths) / (2 * std::numbers::ln2));
    inflation = std::max(1., median_of(squares) / (2 * std::numbers::ln2));
    constexpr double kFar = 9;  // three standard deviations
    for (std::size_t s = 0; s < sightings.size(); ++s) {
      weights[s] = 1 / (1 + squares[s] / (kFar * inflation));
      weights[s] *= weights[s];
    }
  }

  DatumReading out;
  out.sightings = static_cast<int>(sightings.size());
  out.tags = static_cast<int>(tags.size());
  out.residual_px = residual_px;
  for (Index k = 0; k < kKnots; ++k) {
    out.angles.push_back({kTurn_rad * static_cast<double>(k) / (kKnots - 1), x[kFirstKnot + k],
                          std::sqrt(C(kFirstKnot + k, kFirstKnot + k))});
  }
  const auto difference_sd = [&](Index a, Index c) { return std::sqrt(std::max(0., C(a, a) + C(c, c) - 2 * C(a, c))); };
  const Index last = kFirstKnot + kKnots - 1;
  out.turn_error_rad = x[last] - x[kFirstKnot];
  out.turn_sd_rad = difference_sd(last, kFirstKnot);
  for (Index k = 1; k + 1 < kKnots; ++k) {
    const double straight = x[kFirstKnot] + out.turn_error_rad * static_cast<double>(k) / (kKnots - 1);
    if (const double off = std::abs(x[kFirstKnot + k] - straight); off > out.wander_rad) {
      out.wander_rad = off;
      out.wander_sd_rad = std::hypot(difference_sd(kFirstKnot + k, kFirstKnot), 0.5 * out.turn_sd_rad);
    }
  }
  if (std::any_of(sightings.begin(), sightings.end(), [](const DatumSighting& s) { return s.turned_rad < 0; })) {
    out.start_error_rad = x[kFirstKnot] - x[kRest];
    out.start_sd_rad = difference_sd(kFirstKnot, kRest);
  }
  for (const Index part : parts) {
    double square = 0, variance = 0;
    int n = 0;
    const Index at = kFirstMotion + part * kMotion;
    for (std::size_t s = 0; s < sightings.size(); ++s) {
      if (sightings[s].turned_rad < 0 || part_of(sightings[s].turned_rad) != part) continue;
      const Derivatives d = places.at(sightings[s].tag, table_error(x, sightings[s].turned_rad));
      square += (d.by_camera * x.segment<kMotion>(at)).squaredNorm();
      variance += (d.by_camera * C.block<kMotion, kMotion>(at, at) * d.by_camera.transpose()).trace();
      ++n;
    }
    const double px = std::sqrt(square / n);
    if (part == *parts.begin()) out.camera_first_px = px;
    if (px >= out.camera_px) {
      out.camera_px = px;
      out.camera_sd_px = std::sqrt(variance / n);
      out.camera_at_rad = kTurn_rad * (static_cast<double>(part) + 0.5) / kParts;
    }
  }
  return out;
}

}  // namespace celadon
