#pragma once
// An even sample of a stream of unknown length, in bounded memory.

#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

namespace celadon {

/// Numbers 1, 2, 3, ... to 64 bits that look random, the same everywhere.
inline std::uint64_t scrambled(std::uint64_t number) {
  number *= 0x9e3779b97f4a7c15u;
  number ^= number >> 29;
  number *= 0xbf58476d1ce4e5b9u;
  return number ^ (number >> 32);
}

/// Keeps values whose number has a hash below a bound that halves when there are too many: between half of the capacity
/// and all of it, or everything while it fits. (Every 2^k-th value would be the same rows of every profile.)
template <class Value>
class EvenSample {
 public:
  explicit EvenSample(std::size_t capacity) : capacity_(capacity) {}

  /// `make()` gives the next value of the stream; it is asked only if that is kept.
  template <class Make>
  void add(const Make& make) {
    const auto upper = static_cast<std::uint32_t>(scrambled(++seen_) >> 32);
    if (upper > bound_) return;
    hashes_.push_back(upper);
    values_.push_back(make());
    while (values_.size() > capacity_) halve();
  }
  /// The same with a hash of the value's own instead of its number's: what is kept does not depend on the order in
  /// which values come, nor on how they were shared out before merge().
  template <class Make>
  void add(std::uint32_t hash, const Make& make) {
    if (hash > bound_) return;
    hashes_.push_back(hash);
    values_.push_back(make());
    while (values_.size() > capacity_) halve();
  }
  /// What another one of values with hashes of their own has kept.
  void merge(const EvenSample& other) {
    while (bound_ > other.bound_) halve();
    for (std::size_t k = 0; k < other.values_.size(); ++k) add(other.hashes_[k], [&] { return other.values_[k]; });
  }
  /// In the order of the stream.
  const std::vector<Value>& values() const { return values_; }
  /// Of the same order; and the bound that they keep.
  const std::vector<std::uint32_t>& hashes() const { return hashes_; }
  std::uint32_t bound() const { return bound_; }
  /// As another one was. @throws std::invalid_argument if it cannot have been
  void restore(std::vector<Value> values, std::vector<std::uint32_t> hashes, std::uint32_t bound) {
    bool sound =
        values.size() == hashes.size() && values.size() <= capacity_ && std::has_single_bit(std::uint64_t{bound} + 1);
    for (const std::uint32_t hash : hashes) sound = sound && hash <= bound;
    if (!sound) throw std::invalid_argument("EvenSample: this is no sample of that bound");
    values_ = std::move(values);
    hashes_ = std::move(hashes);
    bound_ = bound;
  }

 private:
  void halve() {
    bound_ /= 2;
    std::size_t kept = 0;
    for (std::size_t k = 0; k < values_.size(); ++k) {
      if (hashes_[k] > bound_) continue;
      hashes_[kept] = hashes_[k];
      values_[kept++] = std::move(values_[k]);
    }
    hashes_.resize(kept);
    values_.resize(kept);
  }
  std::size_t capacity_;
  std::vector<Value> values_;
  std::vector<std::uint32_t> hashes_;
  std::uint64_t seen_ = 0;
  std::uint32_t bound_ = std::numeric_limits<std::uint32_t>::max();
};

}  // namespace celadon
