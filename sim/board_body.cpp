#include "sim/board_body.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr double kBack = 0.4;  // reflectance of the board's back
constexpr double kDegree_rad = std::numbers::pi / 180;

// Faces the x axis: seen from there its x points along y, its y down.
Eigen::Matrix3d facing_x() {
  Eigen::Matrix3d R;
  R.col(0) = Vector3d::UnitY();
  R.col(1) = -Vector3d::UnitZ();
  R.col(2) = -Vector3d::UnitX();
  return R;
}

bool parse_pose(std::string_view text, std::array<double, 6>& values) {
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), values[i]);
    if (error != std::errc() || !(std::abs(values[i]) < 1e4)) return false;
    text.remove_prefix(static_cast<std::size_t>(end - text.data()));
    if (i + 1 == values.size()) return text.empty();
    if (text.empty() || text.front() != ',') return false;
    text.remove_prefix(1);
  }
  return true;
}

// Curvature of a bow of sagitta s over an arc of length l: s k = 1 - cos(k l / 2).
double curvature_of(double sagitta, double length) {
  double k = 8 * sagitta / (length * length);
  for (int i = 0; i < 50 && k != 0; ++i) {
    const double half = 0.5 * length * k;
    const double error = sagitta * k - 2 * std::pow(std::sin(0.5 * half), 2);
    k -= error / (sagitta - 0.5 * length * std::sin(half));
  }
  return k;
}

}  // namespace

tl::expected<std::shared_ptr<const BoardBody>, std::string> BoardBody::make(const std::string& text,
                                                                            const PrintErrors& errors) {
  constexpr std::string_view kHeld = "held:";
  const std::size_t at = text.find('@');
  auto target = Target::board(text.substr(0, at));
  if (!target) return tl::unexpected(target.error());
  std::string_view pose_text = at == std::string::npos ? "0,0,58,0,0,30" : std::string_view(text).substr(at + 1);
  const bool held = pose_text.starts_with(kHeld);
  if (held) pose_text.remove_prefix(kHeld.size());
  std::array<double, 6> pose{};
  if (!parse_pose(pose_text, pose)) {
    return tl::unexpected("the board's pose \"" + text.substr(at + 1) +
                          "\" is not X,Y,Z,RX,RY,RZ in millimetres and degrees, for example 0,0,58,0,0,30 or "
                          "held:0,0,58,0,0,30");
  }
  Eigen::Isometry3d X_OB = Eigen::Isometry3d::Identity();
  X_OB.translation() << pose[0], pose[1], pose[2];
  X_OB.linear() = (Eigen::AngleAxisd(pose[5] * kDegree_rad, Vector3d::UnitZ()) *
                   Eigen::AngleAxisd(pose[4] * kDegree_rad, Vector3d::UnitY()) *
                   Eigen::AngleAxisd(pose[3] * kDegree_rad, Vector3d::UnitX()))
                      .toRotationMatrix() *
                  facing_x();
  if (std::abs(errors.bow_mm) > 0.2 * target->width_mm()) {
    return tl::unexpected("a bow of " + std::to_string(errors.bow_mm) +
                          " mm is more than a fifth of the board's length; " + "give less");
  }
  auto body = std::make_shared<const BoardBody>(*std::move(target), X_OB, errors, held);
  double lowest = std::numeric_limits<double>::infinity();
  for (const Vector3d& p : body->outline()) lowest = std::min(lowest, p.z());
  if (lowest <= 0) {
    return tl::unexpected("the board's lowest point is at z = " + std::to_string(lowest) +
                          " mm, in the platter; raise it above 0");
  }
  return body;
}

BoardBody::BoardBody(Target target, const Eigen::Isometry3d& X_OB, const PrintErrors& errors, bool held)
    : target_(std::move(target)),
      X_OB_(X_OB),
      X_BO_(X_OB.inverse()),
      stretch_x_(1 + errors.pitch_x),
      stretch_y_(1 + errors.pitch_y),
      curvature_(curvature_of(errors.bow_mm, stretch_x_ * target_.width_mm())),
      held_(held) {
  for (const Vector3d& p : outline()) {
    height_ = std::max(height_, p.z());
    r_max_ = std::max(r_max_, p.head<2>().norm());
  }
}

Vector3d BoardBody::at(double x_mm, double y_mm) const {
  const double x = stretch_x_ * x_mm, y = stretch_y_ * y_mm;
  if (curvature_ == 0) return X_OB_ * Vector3d(x, y, 0);
  const double half = 0.5 * curvature_ * x;
  return X_OB_ * Vector3d(std::sin(2 * half) / curvature_, y, 2 * std::pow(std::sin(half), 2) / curvature_);
}

std::vector<Vector3d> BoardBody::outline() const {
  const double x = 0.5 * target_.width_mm(), y = 0.5 * target_.height_mm();
  if (curvature_ == 0) return {at(-x, -y), at(x, -y), at(x, y), at(-x, y)};
  constexpr int kSteps = 16;
  std::vector<Vector3d> out;
  for (int i = 0; i <= kSteps; ++i) out.push_back(at(x * (2.0 * i / kSteps - 1), -y));
  for (int i = kSteps; i >= 0; --i) out.push_back(at(x * (2.0 * i / kSteps - 1), y));
  return out;
}

// The bowed board is x^2 + (z - R)^2 = R^2 with R = 1 / k; times k: k (x^2 + z^2) - 2 z = 0, which holds for k = 0 too.
std::optional<BodyHit> BoardBody::intersect(const Ray& ray, double t_min, double t_max) const {
  const Vector3d p = X_BO_ * ray.p, d = X_BO_.linear() * ray.d;
  const double k = curvature_;
  const double a = k * (d.x() * d.x() + d.z() * d.z()), b = k * (p.x() * d.x() + p.z() * d.z()) - d.z(),
               c = k * (p.x() * p.x() + p.z() * p.z()) - 2 * p.z();
  const double root = b * b - a * c;
  if (!(root >= 0)) return std::nullopt;
  const double q = -(b + std::copysign(std::sqrt(root), b));
  if (q == 0) return std::nullopt;
  std::array<double, 2> places{c / q, a == 0 ? c / q : q / a};
  if (places[0] > places[1]) std::swap(places[0], places[1]);
  for (const double t : places) {
    if (!(t > t_min && t < t_max)) continue;
    const Vector3d at = p + t * d;
    const double angle = std::atan2(k * at.x(), 1 - k * at.z());
    const double x = k == 0 ? at.x() : angle / k;
    const double print = target_.reflectance(x / stretch_x_, at.y() / stretch_y_);
    if (print == 0) continue;
    const Vector3d outwards(std::sin(angle), 0, -std::cos(angle));
    const bool front = outwards.dot(d) < 0;
    const Vector3d normal = (front ? 1 : -1) * (X_OB_.linear() * outwards);
    return BodyHit{t, normal, front ? 0 : 1, 0, front ? print : kBack};
  }
  return std::nullopt;
}

std::optional<BodyHit> BoardBody::refine(const Ray& ray, double /*t_near*/, int /*facet*/) const {
  return intersect(ray, 0, std::numeric_limits<double>::infinity());
}

double BoardBody::reach_mm(const Ray& ray) const {
  const auto hit = intersect(ray, 0, std::numeric_limits<double>::infinity());
  return hit ? hit->t : std::numeric_limits<double>::quiet_NaN();
}

std::vector<PrintedCorner> BoardBody::corners() const {
  std::vector<PrintedCorner> out;
  for (const TargetCorner& corner : target_.corners()) {
    out.push_back({corner.id, corner.corner, at(corner.p_mm.x(), corner.p_mm.y())});
  }
  return out;
}

std::vector<std::vector<Vector3d>> BoardBody::printed() const {
  return {outline()};
}

}  // namespace celadon::sim
