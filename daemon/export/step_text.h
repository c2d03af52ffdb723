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
tl::expected<std::string, std::string> step_text(const WallSolid& body, const CadOptions& options);

/// The reals of a DATA section outside of strings rewritten as the shortest decimals that read back as the same double,
/// and `marker` inside of strings replaced.
std::string with_shortest_reals(std::string_view data, std::string_view marker, std::string_view replacement);

/// UTF-8 as the content of a string of ISO 10303-21 (6.4.3): quote and backslash doubled, others as \X2\ or \X4\.
std::string step_string(std::string_view utf8);

}  // namespace celadon
