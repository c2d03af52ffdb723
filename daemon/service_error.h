#pragma once
// Why a request of a client was not taken.

#include <string>

namespace celadon {

/// HTTP status and a sentence with value and remedy.
struct ServiceError {
  int status = 400;
  std::string title, detail;
};

}  // namespace celadon
