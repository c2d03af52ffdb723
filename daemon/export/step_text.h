#pragma once
// ISO 10303-21 text of a body: OpenCASCADE's entities, our header, names, colours, and numbers that lose no bit.

#include <string>
#include <tl/expected.hpp>

#include "daemon/export/cad_client.h"
#include "daemon/export/wall_solid.h"

namespace celadon {

/// Loads OpenCASCADE's STEP schema; once a process, ahead of step_text.
void prepare_step();

/// The whole file. Same body and options give the same bytes.
/// @pre prepare_step() was called; called once a process (OpenCASCADE numbers what it writes)
tl::expected<std::string, std::string> step_text(const WallBody& body, const CadOptions& options);

}  // namespace celadon
