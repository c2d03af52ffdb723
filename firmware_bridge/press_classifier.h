#pragma once
// What the edges of a bouncing contact mean: presses, short or long. Pure logic; times are nanoseconds of one clock
// that never goes back.

#include <cstdint>
#include <deque>
#include <optional>

namespace celadon {

enum class PressLength : std::uint8_t { brief, lasting };

struct PressTiming {
  std::int64_t debounce_ns = 20'000'000;    ///< a level counts once it held for that long
  std::int64_t lasting_ns = 2'000'000'000;  ///< a press held for that long is a long one, at once
};

/// Debounces a contact and measures its presses, from the first edge that held to the last. Whoever takes the presses
/// decides what each is for: one that began since mark() may be used up as it begins, all others are taken once their
/// length is known. No press is told twice.
class PressClassifier {
 public:
  explicit PressClassifier(PressTiming timing) : timing_(timing) {}

  /// The contact took that level. The level it has already is no edge.
  void edge(bool down, std::int64_t time_ns);
  /// That time came.
  void advance(std::int64_t now_ns);
  /// The contact is known again, with that level, after it was lost from sight. Nobody saw the end of a press that was
  /// under way, so it is none; and a contact that is down now counts once it was released.
  void resume(bool down, std::int64_t now_ns);

  /// From here on presses can be used up by use_begun().
  void mark();
  /// Whether presses began since mark() or the last call; those will not be taken any more.
  bool use_begun();
  /// The length of the oldest press that is over, or already long; nullopt: none.
  std::optional<PressLength> take();

 private:
  struct Press {
    std::optional<PressLength> length;  ///< nullopt: under way
    bool since_mark = true, used = false;
  };
  void begin(std::int64_t time_ns);
  void end(std::int64_t time_ns);
  void measure(std::int64_t until_ns);

  const PressTiming timing_;
  bool raw_ = true, level_ = true;  ///< down until seen released, so that a stuck button is no press
  std::int64_t changed_ns_ = 0;     ///< of raw_
  std::int64_t down_ns_ = 0;        ///< of the press under way
  std::deque<Press> presses_;
  bool under_way_ = false;  ///< the newest of presses_ has not ended
  bool begun_ = false;      ///< a press, since mark()
};

}  // namespace celadon
