#pragma once
// Who has a device open.

#include <string>

namespace celadon {

/// "process 1234 (cheese)", several joined by ", "; "" where none is found: other users' processes show their files to
/// root only. This process is left out.
std::string holders_of(const std::string& path);

}  // namespace celadon
