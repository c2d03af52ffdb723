#include "sim/board_body.h"

#include <algorithm>
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

}  // namespace

tl::expected<std::shared_ptr<const BoardBody>, std::string> BoardBody::make(const std::string& text) {
  const std::size_t at = text.find('@');
  const std::string kind = text.substr(0, at);
  if (kind != "chessboard" && kind != "tags") {
    return tl::unexpected("board \"" + kind + "\" is unknown; choose chessboard or tags");
  }
  std::array<double, 6> pose{0, 0, 58, 0, 0, 30};
  if (at != std::string::npos && !parse_pose(std::string_view(text).substr(at + 1), pose)) {
    return tl::unexpected("the board's pose \"" + text.substr(at + 1) +
                          "\" is not X,Y,Z,RX,RY,RZ in millimetres and degrees, for example 0,0,58,0,0,30");
  }
  Eigen::Isometry3d X_OB = Eigen::Isometry3d::Identity();
  X_OB.translation() << pose[0], pose[1], pose[2];
  X_OB.linear() = Eigen::AngleAxisd(pose[5] * kDegree_rad, Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(pose[4] * kDegree_rad, Vector3d::UnitY()) *
                  Eigen::AngleAxisd(pose[3] * kDegree_rad, Vector3d::UnitX()) * facing_x();
  auto body = std::make_shared<const BoardBody>(kind == "tags" ? Target::tag_grid() : Target::chessboard(), X_OB);
  double lowest = std::numeric_limits<double>::infinity();
  for (const Vector3d& p : body->outline()) lowest = std::min(lowest, p.z());
  if (lowest <= 0) {
    return tl::unexpected("the board's lowest corner is at z = " + std::to_string(lowest) +
                          " mm, in the platter; raise it above 0");
  }
  return body;
}

BoardBody::BoardBody(Target target, const Eigen::Isometry3d& X_OB)
    : target_(std::move(target)), X_OB_(X_OB), X_BO_(X_OB.inverse()) {
  for (const Vector3d& p : outline()) {
    height_ = std::max(height_, p.z());
    r_max_ = std::max(r_max_, p.head<2>().norm());
  }
}

std::array<Vector3d, 4> BoardBody::outline() const {
  const double x = 0.5 * target_.width_mm(), y = 0.5 * target_.height_mm();
  return {X_OB_ * Vector3d(-x, -y, 0), X_OB_ * Vector3d(x, -y, 0), X_OB_ * Vector3d(x, y, 0),
          X_OB_ * Vector3d(-x, y, 0)};
}

std::optional<BodyHit> BoardBody::intersect(const Ray& ray, double t_min, double t_max) const {
  const Vector3d p = X_BO_ * ray.p, d = X_BO_.linear() * ray.d;
  if (d.z() == 0) return std::nullopt;
  const double t = -p.z() / d.z();
  if (!(t > t_min && t < t_max)) return std::nullopt;
  const double print = target_.reflectance(p.x() + t * d.x(), p.y() + t * d.y());
  if (print == 0) return std::nullopt;
  const bool front = d.z() > 0;
  const Vector3d normal = (front ? -1 : 1) * X_OB_.linear().col(2);
  return BodyHit{t, normal, front ? 0 : 1, 0, front ? print : kBack};
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
    out.push_back({corner.id, corner.corner, X_OB_ * Vector3d(corner.p_mm.x(), corner.p_mm.y(), 0)});
  }
  return out;
}

std::vector<std::array<Vector3d, 4>> BoardBody::printed() const {
  return {outline()};
}

}  // namespace celadon::sim
