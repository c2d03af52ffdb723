#pragma once
// The kinds of clouds: each function reads a header and gives the source of its points. Errors: one sentence.

#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "daemon/files/cloud_files.h"
#include "daemon/files/input_file.h"
#include "daemon/files/point_source.h"

namespace celadon {

using Opened = tl::expected<std::unique_ptr<PointSource>, std::string>;

/// PLY: ASCII, binary of either byte order; elements other than vertex and properties other than x, y, z are passed
/// over.
Opened open_ply(const InputFile& file);
/// PCD: ASCII, binary, binary_compressed.
Opened open_pcd(const InputFile& file);
/// Numbers in columns; `columns` becomes what the header names, x, y, z without one.
Opened open_text(const InputFile& file, CloudColumns& columns);

/// The sentence for a header that promises `count` records of at least `bytes` each from `begin` on, if they cannot be
/// in the file; empty if they can.
std::string broken_promise(const InputFile& file, std::uint64_t count, std::uint64_t bytes, std::uint64_t begin);

}  // namespace celadon
