#pragma once
// Enter at the terminal: what was asked for by hand is done.

namespace celadon::cli {

class ConfirmKey {
 public:
  /// Waits so long for a line. Without a terminal, or once its input has ended, it only waits.
  bool pressed_within(int time_ms);

 private:
  bool closed_ = false;
};

}  // namespace celadon::cli
