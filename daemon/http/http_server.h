#pragma once
// HTTP API of openapi.yaml over a ScanService. Loopback and a Unix socket only. Slow and hostile clients never hold up
// a scan: everything here runs on threads of its own with limits on time, size and number.

#include <cstdint>
#include <memory>
#include <string>

#include <tl/expected.hpp>

#include "daemon/scan_service.h"

namespace celadon {

struct HttpServerOptions {
  std::string address = "127.0.0.1";  ///< loopback only; anything else is refused
  std::uint16_t port = 7450;          ///< 0: any free one
  std::string unix_socket;            ///< path; empty: none
};

class HttpServer {
 public:
  static tl::expected<std::unique_ptr<HttpServer>, std::string> start(ScanService& service,
                                                                      const HttpServerOptions& options);
  ~HttpServer();  ///< closes every connection and joins its threads
  std::uint16_t port() const;

 private:
  struct Impl;
  explicit HttpServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace celadon
