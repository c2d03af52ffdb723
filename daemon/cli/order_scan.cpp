#include "daemon/cli/order_scan.h"

#include <optional>
#include <utility>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "daemon/cli/virtual_scanner.h"

namespace celadon::cli {

using nlohmann::json;

void add_scanner_options(CLI::App& command, std::string& server, std::string& scene, std::uint64_t& seed) {
  command.add_option("--simulate", scene, "start a virtual scanner with this scene and a daemon for it")
      ->check(CLI::IsMember({"vase", "vase-squeezed", "humidifier", "cylinder", "cylinder-off", "knob", "sphere",
                             "stepped-shaft", "lobed-shaft", "taper", "artefact"}) |
              CLI::Validator(
                  [](const std::string& text) {
                    return text.rfind("mesh:", 0) == 0 ? std::string() : "or mesh:FILE of an STL or PLY file";
                  },
                  "or mesh:FILE"));
  command.add_option("--seed", seed, "of every random number of the virtual scanner");
  command.add_option("--server", server, kServerHelp);
}

int refused(const HttpResponse& answer) {
  const auto problem = json::parse(answer.body, nullptr, false);
  const std::string detail = problem.is_object() ? problem.value("detail", answer.body) : answer.body;
  constexpr int kInsufficientStorage = 507;
  return fail(answer.status == kInsufficientStorage ? 4 : answer.status >= 500 ? 3 : 2, detail);
}

int order_scan(const ScanOrder& order, const FollowOptions& options) {
  catch_interrupts();
  if (const int code = prepare_folder(options.folder)) return code;
  std::optional<VirtualScanner> simulated;
  std::string server = order.server;
  if (!order.scene.empty()) {
    auto started =
        VirtualScanner::start({order.scene, order.seed, order.lasers, order.elevation, order.lift, order.textured});
    if (!started) return fail(3, started.error());
    simulated.emplace(std::move(*started));
    server = simulated->server();
  }
  HttpClient client(server);
  const auto answer = client.post("/api/v1/scans", order.request);
  if (!answer) return fail(3, answer.error());
  if (answer->status != 201) return refused(*answer);
  return follow_scan(client, json::parse(answer->body)["id"].get<std::uint64_t>(), options);
}

}  // namespace celadon::cli
