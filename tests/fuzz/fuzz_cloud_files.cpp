// libFuzzer target: any bytes as a point cloud, read twice. Build and run: README.md of this folder.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "daemon/files/cloud_files.h"
#include "tests/memory_file.h"

namespace {

std::uint64_t pass(celadon::CloudFile& cloud) {
  std::uint64_t count = 0;
  while (const celadon::Profile* profile = cloud.next()) {
    count += profile->size();
  }
  return count + cloud.skipped();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const celadon::testing::MemoryFile file({reinterpret_cast<const char*>(data), size});
  celadon::CloudOptions options;
  options.samples_per_profile = 7;
  const auto cloud = celadon::open_cloud(file.path(), options);
  if (!cloud) {
    return cloud.error().message.empty() ? std::abort(), 0 : 0;
  }
  const std::uint64_t first = pass(**cloud);
  const bool broken = !(*cloud)->error().empty();
  if (first > 88 * size || (!broken && first != (*cloud)->points())) {
    std::abort();
  }
  (*cloud)->rewind();
  if (pass(**cloud) != first || (*cloud)->error().empty() == broken) {
    std::abort();
  }
  return 0;
}
