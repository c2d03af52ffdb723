#pragma once
// When the laser was sure to shine: the leases granted so far, on the host's clock.

#include <array>
#include <cstddef>
#include <cstdint>

namespace celadon {

/// Spans without a gap, of which the newest ones are remembered. A laser that a lease ended warms up again.
class LeaseHistory {
 public:
  /// A lease was granted or renewed.
  /// @param asked_ns, granted_ns  before the request was sent, and after it was answered
  void grant(std::int64_t asked_ns, std::int64_t granted_ns, std::int64_t lease_ns) {
    if (count_ == 0 || granted_ns > newest().end_ns) spans_[count_++ % spans_.size()] = {granted_ns, 0};
    newest().end_ns = asked_ns + lease_ns;
  }
  /// The laser was switched off.
  void end(std::int64_t now_ns) {
    if (count_ > 0 && newest().end_ns > now_ns) newest().end_ns = now_ns;
  }
  /// Frames within this time after the laser went on do not count.
  void set_warm_up(std::int64_t warm_up_ns) { warm_up_ns_ = warm_up_ns; }

  /// From when on the laser shines without a gap; 0 before the first lease.
  std::int64_t shining_since_ns() const { return count_ == 0 ? 0 : spans_[(count_ - 1) % spans_.size()].begin_ns; }
  enum class Light { on, warming_up, not_sure };
  /// What the laser did from one instant to the other.
  Light between(std::int64_t begin_ns, std::int64_t end_ns) const {
    for (std::size_t i = 0; i < spans_.size() && i < count_; ++i) {
      if (begin_ns < spans_[i].begin_ns || end_ns > spans_[i].end_ns) continue;
      return begin_ns < spans_[i].begin_ns + warm_up_ns_ ? Light::warming_up : Light::on;
    }
    return Light::not_sure;
  }

 private:
  struct Span {
    std::int64_t begin_ns = 0, end_ns = 0;
  };
  Span& newest() { return spans_[(count_ - 1) % spans_.size()]; }

  std::array<Span, 64> spans_;  // more than a driver has buffers with frames that wait
  std::size_t count_ = 0;       // ever
  std::int64_t warm_up_ns_ = 0;
};

}  // namespace celadon
