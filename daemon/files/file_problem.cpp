#include "daemon/files/file_problem.h"

#include <cerrno>
#include <system_error>

namespace celadon {
namespace {

const char* remedy(int errno_value) {
  switch (errno_value) {
    case ENOENT:
    case ENOTDIR:
      return "check the name and the folder";
    case EACCES:
    case EPERM:
      return "check its permissions and the user this program runs as";
    case EISDIR:
      return "name a file, not a folder";
    case ENOSPC:
    case EDQUOT:
      return "free some space or choose another disk; nothing was left under the final name";
    case EROFS:
      return "choose a folder that can be written";
    case EFBIG:
      return "raise the file size limit (ulimit -f) or choose another file system";
    case EMFILE:
    case ENFILE:
      return "close other programs or raise the limit of open files (ulimit -n)";
    case ENAMETOOLONG:
      return "choose a shorter name";
    case EIO:
      return "check the disk; the system log tells more";
    case ELOOP:
      return "the symbolic links go in a circle: name the file itself";
    default:
      return "the system log may tell more";
  }
}

}  // namespace

std::string file_problem(const std::string& what, const std::filesystem::path& file, int errno_value) {
  return what + " " + file.string() + ": " + std::generic_category().message(errno_value) + "; " + remedy(errno_value);
}

std::string grouped(unsigned long long number) {
  std::string digits = std::to_string(number);
  for (std::size_t i = digits.size(); i > 3;) {
    i -= 3;
    digits.insert(i, 1, ' ');
  }
  return digits;
}

}  // namespace celadon
