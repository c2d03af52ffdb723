#pragma once
// The text level of ISO 10303-21: strings and reals.

#include <string>
#include <string_view>

namespace celadon {

/// The reals of a DATA section outside of strings rewritten as the shortest decimals that read back as the same double,
/// and `marker` inside of strings replaced.
std::string with_shortest_reals(std::string_view data, std::string_view marker, std::string_view replacement);

/// UTF-8 as the content of a string of ISO 10303-21 (6.4.3): quote and backslash doubled, others as \X2\ or \X4\.
std::string step_string(std::string_view utf8);

}  // namespace celadon
