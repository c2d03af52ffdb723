#pragma once
// Routes of openapi.yaml as a plain function from request to reply: no sockets, no threads.

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "daemon/scan_service.h"

namespace celadon {

struct ApiRequest {
  std::string method, target, body;
  std::string host, origin, content_type;
};

/// What to send. Exactly one of body, file and events is meant: a file is sent with Range, events as a stream.
struct ApiReply {
  int status = 200;
  std::string content_type = "application/json";
  std::string body;
  std::string location;  ///< of 201
  std::string allow;     ///< of 405
  std::optional<std::filesystem::path> file;
  bool events = false;
  std::uint64_t events_of = 0;  ///< job; 0: all
};

/// Answers one request. Refuses (403) hosts and origins that are not this machine: pages of other sites must not reach
/// the scanner through the operator's browser.
ApiReply answer(ScanService& service, const ApiRequest& request);

/// A problem details object (RFC 9457) as a reply.
ApiReply problem(int status, const std::string& title, const std::string& detail);

/// Routes as "METHOD /path/{parameter}", for the comparison with openapi.yaml.
std::vector<std::string> api_routes();

/// First and one past the last byte of a "Range: bytes=..." header for a file of `size` bytes; nullopt: send all (no or
/// several ranges, or a form that is not understood); first == last: not satisfiable (416).
struct ByteRange {
  std::uint64_t first = 0, last = 0;
};
std::optional<ByteRange> parse_range(const std::string& header, std::uint64_t size);

}  // namespace celadon
