#include "acquisition/datum/datum_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/QR>
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
constexpr Index kParts = 8, kMotion = 5, kFirstTag = kParts * kMotion;
constexpr std::size_t kAngles = 64;  // parts of the turn that angles are stated for
// Before anything is seen, one standard deviation of the camera's motion.
constexpr double kAngle_rad = 1, kCameraTurn_rad = 0.02, kCameraShift_mm = 1;
constexpr double kEnd_rad = kTurn_rad / 16;  // of the turn, twice at each end, for straight lines
constexpr double kUnseen_rad = 5e-3;         // standard deviation of what was hardly seen
constexpr double kSmallestTag_mm = 0.005;
// Nothing is far off before the table's error is known.
constexpr int kRounds = 8, kUnweighted = 3;
constexpr double kFar_sigmas = 3;

using Motions = Eigen::Matrix<double, 6, kMotion>;

/// Small motions of the scene against the camera (turn, then shift, along the camera's axes), each one standard
/// deviation long, without the turn about the table's axis: in the picture that one is the table's.
Motions camera_motions(const Calibration& calibration) {
  const Vector3d axis = calibration.axis.X_CW.linear().col(2), origin = calibration.axis.X_CW.translation();
  Eigen::Matrix<double, 6, 1> deviations, about_axis;
  deviations << Vector3d::Constant(kCameraTurn_rad), Vector3d::Constant(kCameraShift_mm);
  about_axis << axis, origin.cross(axis);  // p + axis x (p - origin)
  const Eigen::HouseholderQR<Eigen::Matrix<double, 6, 1>> qr(about_axis.cwiseQuotient(deviations));
  const Eigen::Matrix<double, 6, 6> Q = qr.householderQ();
  return deviations.asDiagonal() * Q.rightCols<kMotion>();
}

/// Derivatives of a tag's place in the picture.
struct Derivatives {
  Vector2d by_angle;
  Eigen::Matrix<double, 2, kMotion> by_camera;  ///< by each of camera_motions()
  Matrix2d by_tag;                              ///< by its place on the platter, x and y at table angle 0, mm
};

class Places {
 public:
  explicit Places(const Calibration& calibration)
      : calibration_(calibration), lens_(calibration.camera_model), motions_(camera_motions(calibration)) {}

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
    Eigen::Matrix<double, 2, 6> by_motion;
    for (Index k = 0; k < 3; ++k) {
      by_motion.col(k) = by(Vector3d::Unit(k).cross(p));
      by_motion.col(3 + k) = by(Vector3d::Unit(k));
    }
    out.by_camera = by_motion * motions_;
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
  const Motions motions_;
};

Index part_of(double turned_rad) {
  return std::clamp<Index>(static_cast<Index>(std::floor(turned_rad / kTurn_rad * kParts)), 0, kParts - 1);
}

/// One sighting as two equations: in the table's error of its frame, and in some of the common unknowns, the camera's
/// motion in this part of the turn and the tag's own place.
struct Equation {
  std::array<Index, kMotion + 2> columns{};
  Eigen::Matrix<double, 2, kMotion + 2> A = Eigen::Matrix<double, 2, kMotion + 2>::Zero();
  Vector2d by_angle = Vector2d::Zero();
  Vector2d seen_px = Vector2d::Zero();  ///< as if they were linear from 0 on
};

Equation equation_of(const DatumSighting& sighting, const Places& places, double error_rad) {
  const Derivatives d = places.at(sighting.tag, error_rad);
  Equation e;
  const Index motion = part_of(sighting.turned_rad) * kMotion,
              tag = kFirstTag + 2 * static_cast<Index>(sighting.tag.tag);
  for (Index k = 0; k < kMotion; ++k) e.columns[static_cast<std::size_t>(k)] = motion + k;
  for (Index k = 0; k < 2; ++k) e.columns[static_cast<std::size_t>(kMotion + k)] = tag + k;
  e.A << d.by_camera, d.by_tag;
  e.by_angle = d.by_angle;
  e.seen_px = sighting.tag.shift_px - places.turned_px(sighting.tag, error_rad) + d.by_angle * error_rad;
  return e;
}

/// The sightings of one frame, and the table's error in it, which no other frame shares.
struct FrameAngle {
  std::size_t begin = 0, end = 0;
  double turned_rad = 0;
  double error_rad = 0, information = 0;
  Eigen::VectorXd by_common;  ///< how the error follows the common unknowns
};

std::vector<FrameAngle> frames_of(std::span<const DatumSighting> sightings) {
  std::vector<FrameAngle> frames;
  for (std::size_t s = 0; s < sightings.size(); ++s) {
    if (frames.empty() || sightings[s].turned_rad != frames.back().turned_rad) {
      frames.emplace_back();
      frames.back().begin = s;
      frames.back().turned_rad = sightings[s].turned_rad;
    }
    frames.back().end = s + 1;
  }
  return frames;
}

double median_of(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// All unknowns at the least squares' end.
struct Solved {
  std::vector<FrameAngle> frames;
  Eigen::VectorXd common;
  Eigen::MatrixXd covariance;  ///< of the common unknowns
  double residual_px = 0;
};

Eigen::VectorXd prior_of(const Calibration& calibration) {
  Eigen::VectorXd information(kFirstTag + 2 * static_cast<Index>(calibration.rim_tags.size()));
  information.head(kFirstTag).setOnes();
  for (std::size_t tag = 0; tag < calibration.rim_tags.size(); ++tag) {
    const double u = std::max(calibration.rim_tags[tag].u_mm, kSmallestTag_mm);
    information.segment(kFirstTag + 2 * static_cast<Index>(tag), 2).setConstant(1 / (u * u));
  }
  return information;
}

Solved solve(const Calibration& calibration, const Places& places, std::span<const DatumSighting> sightings) {
  const Eigen::VectorXd prior = prior_of(calibration);
  const Index unknowns = prior.size();
  Solved out{frames_of(sightings), Eigen::VectorXd::Zero(unknowns), {}, 0};
  std::vector<Equation> equations(sightings.size());
  std::vector<double> weights(sightings.size(), 1);
  double inflation = 1;
  for (int round = 0; round < kRounds; ++round) {
    Eigen::MatrixXd N = prior.asDiagonal();
    Eigen::VectorXd b = Eigen::VectorXd::Zero(unknowns);
    std::vector<double> constant(out.frames.size());
    for (std::size_t f = 0; f < out.frames.size(); ++f) {
      FrameAngle& frame = out.frames[f];
      double right = 0;
      Eigen::VectorXd coupling = Eigen::VectorXd::Zero(unknowns);
      frame.information = 1 / (kAngle_rad * kAngle_rad);
      for (std::size_t s = frame.begin; s < frame.end; ++s) {
        const Equation& e = equations[s] = equation_of(sightings[s], places, frame.error_rad);
        const Matrix2d W = weights[s] / inflation * sightings[s].tag.information;
        const Eigen::Matrix<double, kMotion + 2, 2> AtW = e.A.transpose() * W;
        for (Index i = 0; i < kMotion + 2; ++i) {
          const Index row = e.columns[static_cast<std::size_t>(i)];
          b[row] += AtW.row(i) * e.seen_px;
          coupling[row] += AtW.row(i) * e.by_angle;
          for (Index j = 0; j < kMotion + 2; ++j) {
            N(row, e.columns[static_cast<std::size_t>(j)]) += AtW.row(i) * e.A.col(j);
          }
        }
        frame.information += e.by_angle.dot(W * e.by_angle);
        right += e.by_angle.dot(W * e.seen_px);
      }
      // The frame's own unknown is eliminated.
      frame.by_common = -coupling / frame.information;
      constant[f] = right / frame.information;
      N.noalias() += coupling * frame.by_common.transpose();
      b -= coupling * constant[f];
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(N);
    out.common = solver.solve(b);
    if (round + 1 == kRounds) out.covariance = solver.solve(Eigen::MatrixXd::Identity(unknowns, unknowns));
    // Squared distances in the sightings' own standard deviations; the median of two normal coordinates is 2 ln 2.
    std::vector<double> squares(sightings.size()), lengths(sightings.size());
    for (std::size_t f = 0; f < out.frames.size(); ++f) {
      FrameAngle& frame = out.frames[f];
      frame.error_rad = constant[f] + frame.by_common.dot(out.common);
      for (std::size_t s = frame.begin; s < frame.end; ++s) {
        const Equation& e = equations[s];
        Vector2d r = e.seen_px - e.by_angle * frame.error_rad;
        for (Index k = 0; k < kMotion + 2; ++k) r -= e.A.col(k) * out.common[e.columns[static_cast<std::size_t>(k)]];
        squares[s] = r.dot(sightings[s].tag.information * r);
        lengths[s] = r.squaredNorm();
      }
    }
    out.residual_px = std::sqrt(median_of(lengths) / (2 * std::numbers::ln2));
    inflation = std::max(1., median_of(squares) / (2 * std::numbers::ln2));
    if (round + 1 < kUnweighted) continue;
    for (std::size_t s = 0; s < sightings.size(); ++s) {
      const double share = 1 / (1 + squares[s] / (kFar_sigmas * kFar_sigmas * inflation));
      weights[s] = share * share;
    }
  }
  return out;
}

/// The mean error of several frames, with all that it depends on.
struct MeanAngle {
  int frames = 0;
  double turned_rad = 0, error_rad = 0, own_variance = 0;
  Eigen::VectorXd by_common;
};

/// Weighted by what the frames tell.
MeanAngle mean_of(const Solved& solved, double from_rad, double to_rad) {
  MeanAngle out;
  double weight = 0;
  out.by_common = Eigen::VectorXd::Zero(solved.common.size());
  for (const FrameAngle& frame : solved.frames) {
    if (frame.turned_rad < from_rad || frame.turned_rad >= to_rad) continue;
    ++out.frames;
    weight += frame.information;
    out.turned_rad += frame.information * frame.turned_rad;
    out.error_rad += frame.information * frame.error_rad;
    out.by_common += frame.information * frame.by_common;
  }
  if (out.frames == 0) return out;
  out.turned_rad /= weight, out.error_rad /= weight, out.by_common /= weight, out.own_variance = 1 / weight;
  return out;
}

double sd_of(const Solved& solved, const MeanAngle& mean) {
  return std::sqrt(mean.own_variance + mean.by_common.dot(solved.covariance * mean.by_common));
}

/// a + share * (b - a)
MeanAngle between(const MeanAngle& a, const MeanAngle& b, double share) {
  return {a.frames + b.frames, a.turned_rad + share * (b.turned_rad - a.turned_rad),
          a.error_rad + share * (b.error_rad - a.error_rad),
          (1 - share) * (1 - share) * a.own_variance + share * share * b.own_variance,
          a.by_common + share * (b.by_common - a.by_common)};
}

MeanAngle difference(const MeanAngle& a, const MeanAngle& b) {
  return {a.frames + b.frames, a.turned_rad - b.turned_rad, a.error_rad - b.error_rad, a.own_variance + b.own_variance,
          a.by_common - b.by_common};
}

/// At a place, on the straight line through two means.
MeanAngle at_place(const MeanAngle& a, const MeanAngle& b, double turned_rad) {
  return between(a, b, (turned_rad - a.turned_rad) / (b.turned_rad - a.turned_rad));
}

/// @returns whether both ends of the turn were seen
bool state_angles(const Solved& solved, DatumReading& out) {
  const auto part = [&](double from, double to) { return mean_of(solved, from * kEnd_rad, to * kEnd_rad); };
  constexpr double kEnds = kTurn_rad / kEnd_rad;
  const MeanAngle early = part(0, 1), later = part(1, 2), late = part(kEnds - 2, kEnds - 1),
                  last = part(kEnds - 1, INFINITY);
  for (const MeanAngle* const end : {&early, &later, &late, &last}) {
    if (end->frames == 0 || end->own_variance > kUnseen_rad * kUnseen_rad) return false;
  }
  // An error that grows evenly and one that came at once are both told in full.
  const MeanAngle begin = at_place(early, later, 0), whole = difference(at_place(late, last, kTurn_rad), begin);
  out.turn_error_rad = whole.error_rad;
  out.turn_sd_rad = sd_of(solved, whole);
  for (std::size_t k = 0; k < kAngles; ++k) {
    const double width = kTurn_rad / kAngles, from = static_cast<double>(k) * width;
    const MeanAngle mean = mean_of(solved, from, k + 1 == kAngles ? INFINITY : from + width);
    if (mean.frames == 0 || mean.own_variance > kUnseen_rad * kUnseen_rad) continue;
    out.angles.push_back({mean.turned_rad, mean.error_rad});
    const double off = std::abs(mean.error_rad - begin.error_rad - out.turn_error_rad * mean.turned_rad / kTurn_rad);
    if (off <= out.wander_rad) continue;
    out.wander_rad = off;
    out.wander_sd_rad = std::hypot(sd_of(solved, difference(mean, begin)), 0.5 * out.turn_sd_rad);
  }
  if (const MeanAngle rest = mean_of(solved, -INFINITY, 0); rest.frames > 0) {
    // There, since wrong steps count in the run-up too.
    const MeanAngle then = at_place(early, later, rest.turned_rad);
    out.start_error_rad = then.error_rad - rest.error_rad;
    out.start_sd_rad = sd_of(solved, difference(then, rest));
  }
  return true;
}

void state_camera(const Solved& solved, const Places& places, std::span<const DatumSighting> sightings,
                  DatumReading& out) {
  std::array<double, kParts> squares{}, variances{}, counts{};
  for (const FrameAngle& frame : solved.frames) {
    if (frame.turned_rad < 0) continue;
    const Index part = part_of(frame.turned_rad), at = part * kMotion;
    const auto p = static_cast<std::size_t>(part);
    for (std::size_t s = frame.begin; s < frame.end; ++s) {
      const auto by_camera = places.at(sightings[s].tag, frame.error_rad).by_camera;
      squares[p] += (by_camera * solved.common.segment<kMotion>(at)).squaredNorm();
      variances[p] += (by_camera * solved.covariance.block<kMotion, kMotion>(at, at) * by_camera.transpose()).trace();
      ++counts[p];
    }
  }
  bool first = true;
  for (std::size_t part = 0; part < kParts; ++part) {
    if (counts[part] == 0) continue;
    const double px = std::sqrt(squares[part] / counts[part]);
    if (std::exchange(first, false)) out.camera_first_px = px;
    if (px < out.camera_px) continue;
    out.camera_px = px;
    out.camera_sd_px = std::sqrt(variances[part] / counts[part]);
    out.camera_at_rad = kTurn_rad * (static_cast<double>(part) + 0.5) / kParts;
  }
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
  const Solved solved = solve(calibration, places, sightings);
  DatumReading out;
  out.sightings = static_cast<int>(sightings.size());
  out.tags = static_cast<int>(tags.size());
  out.residual_px = solved.residual_px;
  if (!state_angles(solved, out)) return std::nullopt;
  state_camera(solved, places, sightings, out);
  return out;
}

}  // namespace celadon
