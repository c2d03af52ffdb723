#include "acquisition/device_holder.h"

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>

#include "acquisition/v4l2_text.h"

namespace celadon {

std::string holders_of(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::path wanted = fs::canonical(path, error);
  std::string holders;
  for (fs::directory_iterator process("/proc", error), end; !error && process != end; process.increment(error)) {
    const std::string pid = process->path().filename();
    const bool number = std::all_of(pid.begin(), pid.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
    if (!number || pid == std::to_string(::getpid())) continue;
    std::error_code hidden;
    for (fs::directory_iterator file(process->path() / "fd", hidden); !hidden && file != fs::directory_iterator();
         file.increment(hidden)) {
      std::error_code gone;
      if (fs::read_symlink(file->path(), gone) != wanted || gone) continue;
      std::string name;
      std::getline(std::ifstream(process->path() / "comm"), name);
      name = printable(reinterpret_cast<const std::uint8_t*>(name.data()), name.size());
      holders += (holders.empty() ? "process " : ", process ") + pid + " (" + name + ")";
      break;
    }
  }
  return holders;
}

}  // namespace celadon
