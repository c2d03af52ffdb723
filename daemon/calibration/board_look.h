#pragma once
// What is seen of a board that somebody holds before the camera.

#include <string>

namespace celadon {

/// One look for a board that is held.
struct BoardLook {
  bool found = false;
  std::string problem;  ///< why it was not found, and what to do
  bool still = false;   ///< as it was in the look before
  bool known = false;   ///< a view like it was taken already
  int views = 0, wanted = 0;
  std::string advice;  ///< what is missing; empty once nothing is
};

}  // namespace celadon
