#include "firmware_bridge/host_button.h"

namespace celadon {
namespace {

constexpr std::int64_t kRetry_ns = 1'000'000'000;
constexpr std::int64_t kLate_ns = 5'000'000;  // an edge may reach the queue that much after its stamp

}  // namespace

std::optional<std::string> HostButton::look(std::int64_t now_ns) {
  std::optional<std::string> news;
  if (source_) {
    edges_.clear();
    auto read = source_->read(edges_);
    for (const ButtonEdge& edge : edges_) presses_.edge(edge.down, edge.time_ns);
    if (read) {
      presses_.advance(now_ns - kLate_ns);
      return std::nullopt;
    }
    source_.reset();
    presses_.resume(true, now_ns);
    problem_ = read.error().message;
    next_try_ns_ = now_ns + kRetry_ns;
    return problem_;
  }
  if (next_try_ns_ && now_ns < *next_try_ns_) return std::nullopt;
  next_try_ns_ = now_ns + kRetry_ns;
  auto opened = open_();
  if (!opened) {
    if (opened.error().message != problem_) news = opened.error().message;
    problem_ = opened.error().message;
    return news;
  }
  source_ = std::move(*opened);
  presses_.resume(source_->down_at_open(), now_ns);
  if (!problem_.empty()) news = "The button is there again.";
  problem_.clear();
  return news;
}

}  // namespace celadon
