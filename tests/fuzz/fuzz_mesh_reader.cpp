// libFuzzer target: any bytes as a mesh. Build and run: README.md of this folder.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "daemon/files/mesh_reader.h"
#include "tests/memory_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const celadon::testing::MemoryFile file({reinterpret_cast<const char*>(data), size});
  const auto mesh = celadon::read_mesh(file.path());
  if (!mesh) return mesh.error().empty() ? std::abort(), 0 : 0;
  if (mesh->triangles.empty()) std::abort();
  for (const auto& vertex : mesh->vertices_mm) {
    if (!vertex.allFinite()) std::abort();
  }
  for (const auto& triangle : mesh->triangles) {
    for (const auto corner : triangle) {
      if (corner >= mesh->vertices_mm.size()) std::abort();
    }
  }
  return 0;
}
