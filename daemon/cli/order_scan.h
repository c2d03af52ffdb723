#pragma once
// What scan and check share: which scanner, and a scan of it from the request to its files.

#include <CLI/App.hpp>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "daemon/cli/follow.h"
#include "daemon/http/http_client.h"

namespace celadon::cli {

inline constexpr const char* kServer = "http://127.0.0.1:7450";
inline constexpr const char* kServerHelp = "daemon to talk to: http://ADDRESS:PORT or unix:PATH";

/// --simulate, --seed and --server.
void add_scanner_options(CLI::App& command, std::string& server, std::string& scene, std::uint64_t& seed);

struct ScanOrder {
  std::string server;                    ///< unless there is a scene
  std::string scene;                     ///< of a virtual scanner that is started for this scan; empty: none is
  std::uint64_t seed = 1;                ///< of the virtual scanner
  nlohmann::json request;                ///< as in openapi.yaml
  int lasers = 1;                        ///< of the virtual scanner
  bool elevation = false, lift = false;  ///< whether it has these axes
  bool textured = false;                 ///< its object has a texture and is well lit
};

/// Asks for a scan and follows it as follow_scan() does. @returns the exit code
int order_scan(const ScanOrder& order, const FollowOptions& options);

/// Says what the daemon said of a request that it did not take. @returns the exit code
int refused(const HttpResponse& answer);

}  // namespace celadon::cli
