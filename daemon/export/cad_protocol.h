#pragma once
// What daemon and celadon-cad say to each other over one stream. The grammar is in README.md, "Protocol".

#include <cstddef>
#include <string>
#include <string_view>

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

/// Surface and options as a request. @pre the sizes of the surface agree with each other
CadMessage step_request(const NurbsSurface& wall, const CadOptions& options);

struct StepRequest {
  NurbsSurface wall;
  CadOptions options;
};
/// Checks everything it takes; the error names what does not agree.
tl::expected<StepRequest, std::string> parse_step_request(const CadMessage& message);

}  // namespace celadon
