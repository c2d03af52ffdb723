#pragma once
// Reader of triangle meshes: STL and PLY.

#include <filesystem>
#include <string>

#include <tl/expected.hpp>

#include "daemon/files/mesh_files.h"

namespace celadon {

/// STL (binary, text) and PLY (text, binary of either byte order; polygons become fans). The kind is found from the
/// content. Corners of an STL file with equal coordinates become one vertex; triangles that repeat a corner are left
/// out. Orientation is the file's. Errors: one sentence with file, place and remedy.
tl::expected<TriangleMesh, std::string> read_mesh(const std::filesystem::path& file);

}  // namespace celadon
