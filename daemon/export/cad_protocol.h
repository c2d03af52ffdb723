#pragma once
// What daemon and celadon-cad say to each other over one stream. The grammar is in README.md, "Protocol".

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>
#include <tl/expected.hpp>

#include "daemon/export/cad_client.h"

namespace celadon {

/// One message in either direction.
struct CadMessage {
  nlohmann::json head;
  std::string payload;
};

/// Sizes said by the first line of a message.
struct CadMessageSizes {
  std::size_t head = 0, payload = 0;
};

/// The longest first line, its line feed included.
inline constexpr std::size_t cad_first_line_limit = 64;

std::string encode(const CadMessage& message);
/// @param line without its line feed
tl::expected<CadMessageSizes, std::string> decode_first_line(std::string_view line);

/// Surfaces, bottom to top, and options as a request. @pre the sizes of each surface agree with each other
CadMessage step_request(std::span<const NurbsSurface> walls, const CadOptions& options);

struct StepRequest {
  std::vector<NurbsSurface> walls;
  CadOptions options;
};
/// Checks everything it takes; the error names what does not agree.
tl::expected<StepRequest, std::string> parse_step_request(const CadMessage& message);

}  // namespace celadon
