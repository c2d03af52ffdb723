#include "daemon/cli/confirm_key.h"

#include <poll.h>
#include <unistd.h>

namespace celadon::cli {

bool ConfirmKey::pressed_within(int time_ms) {
  pollfd input{closed_ ? -1 : STDIN_FILENO, POLLIN, 0};
  if (::poll(&input, 1, time_ms) <= 0) return false;
  char line[256];
  const ssize_t count = ::read(STDIN_FILENO, line, sizeof line);
  closed_ = count <= 0;
  return !closed_;
}

}  // namespace celadon::cli
