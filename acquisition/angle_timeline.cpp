#include "acquisition/angle_timeline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>

namespace celadon {
namespace {

/// Twenty minutes at 50 polls a second; frames are matched to angles within a second.
constexpr std::size_t kMostPoints = 60'000;

struct Node {
  double time_s, angle_rad;  ///< relative to the instant asked for
};

/// Value, slope and curvature at time 0 of the parabola (or line, or constant) through the nodes, and the sum of the
/// squared weights that the nodes have in the value.
struct Parabola {
  double angle_rad = 0, speed = 0, acceleration = 0, squared_weights = 1;
};

Parabola constant(const Node& a) {
  return {a.angle_rad, 0, 0, 1};
}

Parabola line(const Node& a, const Node& b) {
  const double slope = (b.angle_rad - a.angle_rad) / (b.time_s - a.time_s);
  const double wb = -a.time_s / (b.time_s - a.time_s), wa = 1 - wb;
  return {a.angle_rad - slope * a.time_s, slope, 0, wa * wa + wb * wb};
}

Parabola parabola(const Node& a, const Node& b, const Node& c) {
  // Newton's divided differences; Lagrange's weights for the noise.
  const double ab = (b.angle_rad - a.angle_rad) / (b.time_s - a.time_s);
  const double bc = (c.angle_rad - b.angle_rad) / (c.time_s - b.time_s);
  const double abc = (bc - ab) / (c.time_s - a.time_s);
  const double wa = b.time_s * c.time_s / ((a.time_s - b.time_s) * (a.time_s - c.time_s));
  const double wb = a.time_s * c.time_s / ((b.time_s - a.time_s) * (b.time_s - c.time_s));
  const double wc = a.time_s * b.time_s / ((c.time_s - a.time_s) * (c.time_s - b.time_s));
  return {a.angle_rad - a.time_s * ab + a.time_s * b.time_s * abc, ab - (a.time_s + b.time_s) * abc, 2 * abc,
          wa * wa + wb * wb + wc * wc};
}

}  // namespace

AngleTimeline::AngleTimeline(double quantisation_rad, StampedBy stamped_by)
    : quantisation_rad_(quantisation_rad), stamped_by_(stamped_by) {
  if (!(quantisation_rad >= 0) || !std::isfinite(quantisation_rad)) {
    throw std::invalid_argument("AngleTimeline: the encoder's resolution must be finite and not negative");
  }
}

void AngleTimeline::add(const PositionSample& sample) {
  if (!std::isfinite(sample.angle_rad)) throw std::invalid_argument("AngleTimeline: the angle is not finite");
  if (stamped_by_ == StampedBy::host) {
    if (sample.host_after_ns < sample.host_before_ns)
      throw std::invalid_argument("AngleTimeline: an exchange that ends before it begins");
    const std::int64_t exchange_ns = sample.host_after_ns - sample.host_before_ns;
    const auto middle_us = static_cast<std::uint64_t>((sample.host_before_ns + exchange_ns / 2) / 1000);
    return add_point(middle_us, sample, static_cast<double>(exchange_ns) / std::sqrt(12.));
  }
  const std::uint64_t device_us = sample.device_reply_us != 0 ? sample.device_reply_us : sample.device_time_us;
  const bool first = clock_.empty();
  if (!first && device_us < newest_device_us_) points_.clear();
  // The same stamp read once more only says that it was taken before the later answer, too.
  if (first || device_us != newest_device_us_) {
    clock_.add(device_us, sample.host_before_ns, sample.host_after_ns);
  } else if (sample.host_after_ns < sample.host_before_ns) {
    throw std::invalid_argument("AngleTimeline: an exchange that ends before it begins");
  }
  add_point(sample.device_time_us, sample, 0);
  newest_device_us_ = device_us;
}

void AngleTimeline::add_point(std::uint64_t time_us, const PositionSample& sample, double sigma_ns) {
  if (!points_.empty() && (sample.counter == newest_counter_ || time_us <= points_.back().device_time_us)) return;
  points_.push_back({time_us, sample.angle_rad, sigma_ns});
  if (points_.size() > kMostPoints) points_.pop_front();
  newest_counter_ = sample.counter;
}

std::int64_t AngleTimeline::host_time_of(const Point& point) const {
  return stamped_by_ == StampedBy::host ? static_cast<std::int64_t>(point.device_time_us) * 1000
                                        : clock_.host_time_ns(point.device_time_us);
}

void AngleTimeline::clear_positions() {
  points_.clear();
}

std::int64_t AngleTimeline::newest_ns() const {
  return points_.empty() ? INT64_MIN : host_time_of(points_.back());
}

tl::expected<AngleAtInstant, const char*> AngleTimeline::at(std::int64_t host_ns,
                                                            std::int64_t max_extrapolation_ns) const {
  if (points_.empty())
    return tl::unexpected<const char*>("no position of the table is known: poll the controller first");
  const auto host = [&](std::size_t i) { return host_time_of(points_[i]); };
  const std::size_t count = points_.size();
  if (host_ns - host(count - 1) > max_extrapolation_ns) {
    return tl::unexpected<const char*>(
        "the instant is later than the newest position of the table: poll the controller more often");
  }
  if (host(0) - host_ns > max_extrapolation_ns) {
    return tl::unexpected<const char*>(
        "the instant is earlier than the oldest position of the table: the frame is stale");
  }
  // after: the first point later than the instant. Frames are young, so the search begins at the end.
  std::size_t after = count;
  while (after > 0 && host(after - 1) > host_ns) --after;
  const auto node = [&](std::size_t i) {
    return Node{static_cast<double>(host(i) - host_ns) * 1e-9, points_[i].angle_rad};
  };
  // A neighbour at least half an interval away: nearer ones would blow up the quantisation.
  const auto earlier = [&](std::size_t i, double interval_s) -> std::optional<Node> {
    const double limit = node(i).time_s - 0.5 * interval_s;
    for (std::size_t k = i; k-- > 0;) {
      if (node(k).time_s <= limit) return node(k);
    }
    return std::nullopt;
  };
  const auto later = [&](std::size_t i, double interval_s) -> std::optional<Node> {
    const double limit = node(i).time_s + 0.5 * interval_s;
    for (std::size_t k = i + 1; k < count; ++k) {
      if (node(k).time_s >= limit) return node(k);
    }
    return std::nullopt;
  };

  Parabola result;
  double model_rad = 0;
  if (count == 1) {
    result = constant(node(0));
  } else if (after == 0 || after == count) {
    // Outside: the parabola through the three nearest; that the acceleration may end at any time is the doubt.
    const std::size_t a = after == 0 ? 0 : count - 2;
    const double interval_s = node(a + 1).time_s - node(a).time_s;
    const auto third = after == 0 ? later(a + 1, interval_s) : earlier(a, interval_s);
    const double beyond_s = after == 0 ? node(0).time_s : node(count - 1).time_s;
    result = !third       ? line(node(a), node(a + 1))
             : after == 0 ? parabola(node(a), node(a + 1), *third)
                          : parabola(*third, node(a), node(a + 1));
    model_rad = 0.5 * std::abs(result.acceleration) * beyond_s * beyond_s;
  } else {
    // Between: the two parabolas that share this interval, blended; both are exact at constant acceleration, and their
    // difference shows how far the motion is from it.
    const Node left = node(after - 1), right = node(after);
    const double interval_s = right.time_s - left.time_s, u = -left.time_s / interval_s;
    const auto before = earlier(after - 1, interval_s), behind = later(after, interval_s);
    if (before && behind) {
      const Parabola p = parabola(*before, left, right), q = parabola(left, right, *behind);
      const double gap = q.angle_rad - p.angle_rad;
      result.angle_rad = p.angle_rad + u * gap;
      result.speed = p.speed + u * (q.speed - p.speed) + gap / interval_s;
      result.squared_weights = (1 - u) * p.squared_weights + u * q.squared_weights;
      model_rad = 0.5 * std::abs(gap);
    } else {
      const Parabola chord = line(left, right);
      result = before ? parabola(*before, left, right) : behind ? parabola(left, right, *behind) : chord;
      model_rad = 0.5 * std::abs(result.angle_rad - chord.angle_rad);
    }
  }
  const std::size_t nearest = std::min(after, count - 1);
  // The neighbours' times err apart; taken as one, the larger of the two.
  const double clock_ns = stamped_by_ == StampedBy::host
                              ? std::max(points_[nearest].sigma_ns, points_[nearest > 0 ? nearest - 1 : 0].sigma_ns)
                              : clock_.sigma_ns(points_[nearest].device_time_us);
  const double clock_rad = result.speed * clock_ns * 1e-9;
  const double encoder_rad = quantisation_rad_ * std::sqrt(result.squared_weights / 12);
  return AngleAtInstant{result.angle_rad, std::hypot(encoder_rad, clock_rad, model_rad), result.speed};
}

}  // namespace celadon
