#include "daemon/http/http_client.h"

#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <optional>

#include "daemon/files/atomic_file.h"

namespace celadon {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using beast::error_code;
using namespace std::chrono_literals;

constexpr auto kConnectTime = 5s;
constexpr auto kAnswerTime = 30s;
constexpr int kAttempts = 4;

struct Address {
  std::string unix_path, host, port;
};

Address parse_address(const std::string& server) {
  Address address;
  if (server.rfind("unix:", 0) == 0) {
    address.unix_path = server.substr(5);
    return address;
  }
  std::string rest = server.rfind("http://", 0) == 0 ? server.substr(7) : server;
  rest = rest.substr(0, rest.find('/'));
  const auto colon = rest.rfind(':');
  address.host = rest.substr(0, colon);
  address.port = colon == std::string::npos ? "7450" : rest.substr(colon + 1);
  return address;
}

// One connection of either kind; every step is asynchronous underneath so that it can time out.
template <class Protocol>
class Connection {
 public:
  error_code connect(const Address& address) {
    stream_.expires_after(kConnectTime);
    if constexpr (std::is_same_v<Protocol, asio::ip::tcp>) {
      error_code error;
      asio::ip::tcp::resolver resolver(context_);
      const auto found = resolver.resolve(address.host, address.port, error);
      if (error) return error;
      return wait([&](auto done) {
        stream_.async_connect(found, [done](error_code e, const asio::ip::tcp::endpoint&) { done(e); });
      });
    } else {
      const asio::local::stream_protocol::endpoint path(address.unix_path);
      return wait([&](auto done) { stream_.async_connect(path, [done](error_code e) { done(e); }); });
    }
  }

  template <class Message>
  error_code write(Message& message) {
    stream_.expires_after(kAnswerTime);
    return wait(
        [&](auto done) { http::async_write(stream_, message, [done](error_code e, std::size_t) { done(e); }); });
  }

  template <class Parser>
  error_code read(Parser& parser) {
    stream_.expires_after(kAnswerTime);
    return wait(
        [&](auto done) { http::async_read(stream_, buffer_, parser, [done](error_code e, std::size_t) { done(e); }); });
  }

  template <class Parser>
  error_code read_header(Parser& parser) {
    stream_.expires_after(kAnswerTime);
    return wait([&](auto done) {
      http::async_read_header(stream_, buffer_, parser, [done](error_code e, std::size_t) { done(e); });
    });
  }

  template <class Parser>
  error_code read_some(Parser& parser) {
    stream_.expires_after(kAnswerTime);
    return wait([&](auto done) {
      http::async_read_some(stream_, buffer_, parser, [done](error_code e, std::size_t) { done(e); });
    });
  }

 private:
  template <class Start>
  error_code wait(Start start) {
    error_code result = asio::error::timed_out;
    start([&result](error_code error) { result = error; });
    context_.restart();
    context_.run();
    return result;
  }

  asio::io_context context_;
  beast::basic_stream<Protocol> stream_{context_};
  beast::flat_buffer buffer_;
};

// Calls use(connection) on an open connection of the server's kind.
template <class Use>
auto with_connection(const std::string& server, Use use) -> decltype(use(std::declval<Connection<asio::ip::tcp>&>())) {
  const Address address = parse_address(server);
  const auto unreachable = [&](const error_code& error) {
    return tl::unexpected("no celadond answers at " + server + ": " + error.message() +
                          "; start it, or name another with --server");
  };
  if (address.unix_path.empty()) {
    Connection<asio::ip::tcp> connection;
    if (const auto error = connection.connect(address)) return unreachable(error);
    return use(connection);
  }
  Connection<asio::local::stream_protocol> connection;
  if (const auto error = connection.connect(address)) return unreachable(error);
  return use(connection);
}

std::string broken(const std::string& server, const error_code& error) {
  return "the connection to " + server + " broke: " + error.message() + "; is celadond still running?";
}

http::request<http::string_body> make_request(http::verb verb, const std::string& path) {
  http::request<http::string_body> request{verb, path, 11};
  request.set(http::field::host, "localhost");
  request.set(http::field::user_agent, "celadon");
  return request;
}

tl::expected<HttpResponse, std::string> ask(const std::string& server, http::request<http::string_body> request) {
  request.prepare_payload();
  return with_connection(server, [&](auto& connection) -> tl::expected<HttpResponse, std::string> {
    if (const auto error = connection.write(request)) return tl::unexpected(broken(server, error));
    http::response_parser<http::string_body> parser;
    parser.body_limit(64 * 1024 * 1024);
    if (const auto error = connection.read(parser)) return tl::unexpected(broken(server, error));
    const auto& message = parser.get();
    return HttpResponse{static_cast<int>(message.result_int()), std::string(message[http::field::location]),
                        message.body()};
  });
}

std::string refusal(int status, const std::string& body) {
  const auto problem = nlohmann::json::parse(body, nullptr, false);
  if (problem.is_object() && problem.contains("detail") && problem["detail"].is_string()) return problem["detail"];
  return "the daemon answered with status " + std::to_string(status);
}

struct DownloadStep {
  bool complete = false;
  std::string failure;  // final, not worth another attempt
};

// Appends what one connection delivers from the present size on.
tl::expected<DownloadStep, std::string> download_some(const std::string& server, const std::string& path,
                                                      AtomicFile& file) {
  auto request = make_request(http::verb::get, path);
  if (file.size() > 0) request.set(http::field::range, "bytes=" + std::to_string(file.size()) + "-");
  return with_connection(server, [&](auto& connection) -> tl::expected<DownloadStep, std::string> {
    if (const auto error = connection.write(request)) return tl::unexpected(broken(server, error));
    http::response_parser<http::buffer_body> parser;
    parser.body_limit(boost::none);
    if (const auto error = connection.read_header(parser)) return tl::unexpected(broken(server, error));
    const int status = static_cast<int>(parser.get().result_int());
    std::string text;  // of a refusal
    char piece[64 * 1024];
    while (!parser.is_done()) {
      parser.get().body().data = piece;
      parser.get().body().size = sizeof piece;
      const auto error = connection.read_some(parser);
      const std::size_t got = sizeof piece - parser.get().body().size;
      if (status == 200 || status == 206) {
        if (auto kept = file.append({piece, got}); !kept) return DownloadStep{false, kept.error().message};
      } else {
        text.append(piece, got);
      }
      if (error && error != http::error::need_buffer) return tl::unexpected(broken(server, error));
    }
    if (status != 200 && status != 206) return DownloadStep{false, refusal(status, text)};
    return DownloadStep{true, {}};
  });
}

}  // namespace

HttpClient::HttpClient(std::string server) : server_(std::move(server)) {}

tl::expected<HttpResponse, std::string> HttpClient::get(const std::string& path) {
  return ask(server_, make_request(http::verb::get, path));
}

tl::expected<HttpResponse, std::string> HttpClient::post(const std::string& path, const nlohmann::json& body) {
  auto request = make_request(http::verb::post, path);
  request.set(http::field::content_type, "application/json");
  request.body() = body.dump();
  return ask(server_, std::move(request));
}

tl::expected<void, std::string> HttpClient::download(const std::string& path, const std::filesystem::path& file) {
  auto part = AtomicFile::create(file);
  if (!part) return tl::unexpected(part.error().message);
  std::string last_failure;
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    const auto step = download_some(server_, path, *part);
    if (step && !step->failure.empty()) return tl::unexpected(step->failure);
    if (step && step->complete) {
      if (auto kept = part->commit(); !kept) return tl::unexpected(kept.error().message);
      return {};
    }
    last_failure = step.error();
  }
  return tl::unexpected(last_failure);
}

tl::expected<void, std::string> HttpClient::events(
    const std::string& path, const std::function<bool(const std::string& name, const std::string& data)>& on_event) {
  return with_connection(server_, [&](auto& connection) -> tl::expected<void, std::string> {
    auto request = make_request(http::verb::get, path);
    request.set(http::field::accept, "text/event-stream");
    if (const auto error = connection.write(request)) return tl::unexpected(broken(server_, error));
    http::response_parser<http::buffer_body> parser;
    parser.body_limit(boost::none);
    if (const auto error = connection.read_header(parser)) return tl::unexpected(broken(server_, error));
    const int status = static_cast<int>(parser.get().result_int());
    std::string pending, name, data;
    char piece[16 * 1024];
    while (!parser.is_done()) {
      parser.get().body().data = piece;
      parser.get().body().size = sizeof piece;
      const auto error = connection.read_some(parser);
      pending.append(piece, sizeof piece - parser.get().body().size);
      if (status == 200) {
        for (std::size_t end; (end = pending.find('\n')) != std::string::npos;) {
          const std::string line = pending.substr(0, end);
          pending.erase(0, end + 1);
          if (line.rfind("event: ", 0) == 0) name = line.substr(7);
          if (line.rfind("data: ", 0) == 0) data = line.substr(6);
          if (!line.empty() || data.empty()) continue;
          if (!on_event(name, data)) return {};
          data.clear();
        }
      }
      if (error == http::error::end_of_stream) break;
      if (error && error != http::error::need_buffer) return tl::unexpected(broken(server_, error));
    }
    if (status != 200) return tl::unexpected(refusal(status, pending));
    return {};
  });
}

}  // namespace celadon
