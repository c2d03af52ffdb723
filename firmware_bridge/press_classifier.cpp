#include "firmware_bridge/press_classifier.h"

namespace celadon {

void PressClassifier::edge(bool down, std::int64_t time_ns) {
  advance(time_ns);
  if (down == raw_) return;
  raw_ = down;
  changed_ns_ = time_ns;
}

void PressClassifier::advance(std::int64_t now_ns) {
  if (raw_ != level_ && now_ns - changed_ns_ >= timing_.debounce_ns) {
    level_ = raw_;
    if (level_) {
      begin(changed_ns_);
    } else {
      end(changed_ns_);
    }
  }
  // While the contact is open, perhaps only bouncing, no time is added.
  if (under_way_) measure(raw_ ? now_ns : changed_ns_);
}

void PressClassifier::resume(bool down, std::int64_t now_ns) {
  if (under_way_ && !presses_.empty() && !presses_.back().length) presses_.pop_back();
  under_way_ = false;
  raw_ = level_ = down;
  changed_ns_ = now_ns;
}

void PressClassifier::begin(std::int64_t time_ns) {
  down_ns_ = time_ns;
  under_way_ = true;
  presses_.push_back({});
  begun_ = true;
}

void PressClassifier::end(std::int64_t time_ns) {
  if (!under_way_) return;  // it was down when it came into sight
  measure(time_ns);
  if (!presses_.empty() && !presses_.back().length) presses_.back().length = PressLength::brief;
  under_way_ = false;
}

void PressClassifier::measure(std::int64_t until_ns) {
  if (presses_.empty() || presses_.back().length || until_ns - down_ns_ < timing_.lasting_ns) return;
  presses_.back().length = PressLength::lasting;
}

void PressClassifier::mark() {
  for (Press& press : presses_) press.since_mark = false;
  begun_ = false;
}

bool PressClassifier::use_begun() {
  const bool any = begun_;
  for (Press& press : presses_) press.used = press.used || press.since_mark;
  mark();
  return any;
}

std::optional<PressLength> PressClassifier::take() {
  while (!presses_.empty() && presses_.front().length) {
    const Press oldest = presses_.front();
    presses_.pop_front();
    if (!oldest.used) return oldest.length;
  }
  return std::nullopt;
}

}  // namespace celadon
