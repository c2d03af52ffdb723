#include "sim/camera.h"

#include <algorithm>

namespace celadon::sim {

CameraTimeline::CameraTimeline(const CameraConfig& config, std::int64_t begin_ns)
    : config_(config), begin_ns_(begin_ns), next_exposure_ns_(config.exposure_ns), slots_(config.slots, Slot::free) {}

void CameraTimeline::start(std::int64_t now_ns) {
  stop();
  // The first frame is one whose exposure begins from now on.
  const std::int64_t since = now_ns + config_.exposure_ns - begin_ns_;
  next_number_ = since <= config_.period_ns ? 0 : static_cast<std::uint64_t>((since - 1) / config_.period_ns);
  first_number_ = next_number_;
  streaming_ = true;
}

void CameraTimeline::stop() {
  streaming_ = false;
  under_way_.clear();
  std::fill(slots_.begin(), slots_.end(), Slot::free);
}

void CameraTimeline::give_back(std::uint32_t slot) {
  if (slot < slots_.size() && slots_[slot] == Slot::taken) slots_[slot] = Slot::free;
}

std::int64_t CameraTimeline::set_exposure(std::int64_t exposure_ns, std::int64_t now_ns) {
  constexpr std::int64_t kShortest = 20'000, kReset = 100'000;
  next_exposure_ns_ = std::clamp(exposure_ns, kShortest, std::max(kShortest, config_.period_ns - kReset));
  next_exposure_from_ns_ = now_ns + std::max(config_.exposure_ns, next_exposure_ns_);
  return next_exposure_ns_;
}

std::int64_t CameraTimeline::next_event_ns() const {
  if (!streaming_) return INT64_MAX;
  std::int64_t next = first_row_end_ns(next_number_);
  for (const FrameTicket& ticket : under_way_)
    next = std::min(next, ticket.rendering ? ticket.deliver_ns : ticket.complete_ns);
  return next;
}

void CameraTimeline::advance(std::int64_t now_ns) {
  while (streaming_ && first_row_end_ns(next_number_) <= now_ns) {
    const std::uint64_t number = next_number_++;
    if (first_row_end_ns(number) >= next_exposure_from_ns_) config_.exposure_ns = next_exposure_ns_;
    if (lose_ > 0) {
      --lose_;
      continue;
    }
    const auto slot = std::find(slots_.begin(), slots_.end(), Slot::free);
    if (slot == slots_.end()) continue;  // lost: the sequence shows a gap
    *slot = Slot::filling;
    FrameTicket ticket;
    ticket.number = number;
    ticket.sequence = number - first_number_;
    ticket.first_row_end_ns = first_row_end_ns(number);
    ticket.exposure_ns = config_.exposure_ns;
    ticket.stamp_ns = ticket.first_row_end_ns + config_.stamp_latency_ns + stamp_step_ns_;
    ticket.complete_ns = ticket.first_row_end_ns + config_.readout_ns;
    ticket.deliver_ns = ticket.complete_ns + config_.delay_ns + extra_delay_ns_;
    ticket.slot = static_cast<std::uint32_t>(slot - slots_.begin());
    ticket.bytes_used = static_cast<std::uint32_t>(config_.frame_bytes());
    under_way_.push_back(ticket);
  }
}

FrameTicket* CameraTimeline::take_to_render(std::int64_t now_ns) {
  for (FrameTicket& ticket : under_way_) {
    if (!ticket.rendering && ticket.complete_ns <= now_ns) {
      ticket.rendering = true;
      return &ticket;
    }
  }
  return nullptr;
}

void CameraTimeline::mark_rendered(std::uint64_t number) {
  for (FrameTicket& ticket : under_way_) {
    if (ticket.number == number) ticket.rendered = true;
  }
}

std::optional<FrameTicket> CameraTimeline::take(std::int64_t now_ns) {
  if (under_way_.empty()) return std::nullopt;
  const FrameTicket ticket = under_way_.front();
  if (!ticket.rendered || ticket.deliver_ns > now_ns) return std::nullopt;
  under_way_.pop_front();
  slots_[ticket.slot] = Slot::taken;
  return ticket;
}

}  // namespace celadon::sim
