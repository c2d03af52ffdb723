#pragma once
// Blocking client of the API for the command line: requests, downloads, live events.

#include <filesystem>
#include <functional>
#include <string>

#include <nlohmann/json.hpp>
#include <tl/expected.hpp>

namespace celadon {

struct HttpResponse {
  int status = 0;
  std::string location, body;
};

class HttpClient {
 public:
  /// "http://127.0.0.1:7450" or "unix:/run/celadon.sock".
  explicit HttpClient(std::string server);
  tl::expected<HttpResponse, std::string> get(const std::string& path);
  tl::expected<HttpResponse, std::string> post(const std::string& path, const nlohmann::json& body);
  /// Downloads beside the final name, syncs and renames; resumes with Range when the link breaks.
  tl::expected<void, std::string> download(const std::string& path, const std::filesystem::path& file);
  /// Server-sent events of a path until `on_event(name, data)` returns false or the server ends the stream. A stream
  /// begins with the present state, so a caller whose link broke just calls again.
  tl::expected<void, std::string> events(
      const std::string& path, const std::function<bool(const std::string& name, const std::string& data)>& on_event);

 private:
  std::string server_;
};

}  // namespace celadon
