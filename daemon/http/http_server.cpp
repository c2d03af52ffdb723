#include "daemon/http/http_server.h"

#include <unistd.h>

#include <array>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>
#include <utility>

#include "daemon/http/api.h"

namespace celadon {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using beast::error_code;
using namespace std::chrono_literals;

constexpr std::size_t kBodyLimit = 64 * 1024;
constexpr std::uint32_t kHeaderLimit = 8 * 1024;
constexpr std::size_t kConnectionLimit = 128;
constexpr auto kReadTime = 15s;   // for a whole request, and for the pause before the next one
constexpr auto kWriteTime = 30s;  // for one piece of an answer: a client that takes none is dropped
constexpr auto kEventPause = 100ms;
constexpr auto kEventHeartbeat = 10s;

// A session that follows jobs. Only the latest state of each is kept for it, so a slow client costs nothing.
class EventSink {
 public:
  virtual ~EventSink() = default;
  virtual void job_changed(std::uint64_t id) = 0;
};

// What the sessions share; used on the I/O thread only, but for job_changed's caller.
struct Shared {
  ScanService& service;
  std::size_t connections = 0;
  std::set<EventSink*> sinks;
};

template <class Protocol>
class Session : public std::enable_shared_from_this<Session<Protocol>>, public EventSink {
 public:
  using Stream = beast::basic_stream<Protocol>;
  Session(typename Protocol::socket socket, Shared& shared)
      : stream_(std::move(socket)), timer_(stream_.get_executor()), shared_(shared) {
    ++shared_.connections;
  }
  ~Session() override {
    --shared_.connections;
    shared_.sinks.erase(this);
  }

  void read() {
    parser_.emplace();
    parser_->body_limit(kBodyLimit);
    parser_->header_limit(kHeaderLimit);
    stream_.expires_after(kReadTime);
    http::async_read(stream_, buffer_, *parser_,
                     [self = this->shared_from_this()](error_code error, std::size_t) { self->on_read(error); });
  }

  void refuse_as_busy() {
    close_after_ = true;
    version_ = 11;
    send(problem(
        503, "too many connections",
        "the scanner serves " + std::to_string(kConnectionLimit) + " connections at once; close one and try again"));
  }

  void job_changed(std::uint64_t id) override {
    if (followed_ == 0 || followed_ == id) {
      changed_.insert(id);
      if (waiting_for_change_) timer_.cancel();
    }
  }

 private:
  void on_read(error_code error) {
    if (error == http::error::end_of_stream) return shut();
    version_ = 11;
    close_after_ = true;
    if (error == http::error::body_limit) {
      return send(problem(413, "too large", "a request body has at most " + std::to_string(kBodyLimit) + " bytes"));
    }
    if (error == http::error::header_limit) {
      return send(
          problem(431, "header too large", "request headers have at most " + std::to_string(kHeaderLimit) + " bytes"));
    }
    if (error.category() == http::make_error_code(http::error::bad_method).category()) {
      return send(problem(400, "not HTTP", "the request could not be read: " + error.message()));
    }
    if (error) return;  // gone or too slow
    const auto& message = parser_->get();
    version_ = message.version();
    close_after_ = !message.keep_alive();
    range_ = std::string(message[http::field::range]);
    ApiRequest request{std::string(message.method_string()),
                       std::string(message.target()),
                       message.body(),
                       std::string(message[http::field::host]),
                       std::string(message[http::field::origin]),
                       std::string(message[http::field::content_type])};
    head_only_ = request.method == "HEAD";
    if (head_only_) request.method = "GET";
    ApiReply reply = answer(shared_.service, request);
    if (reply.events && !head_only_) return start_events(reply.events_of);
    if (reply.file) return send_file(reply);
    send(reply);
  }

  template <class Message>
  void set_common_fields(Message& message, const ApiReply& reply) {
    message.set(http::field::server, "celadond");
    message.set(http::field::content_type, reply.content_type);
    message.set(http::field::cache_control, "no-store");
    message.set("X-Content-Type-Options", "nosniff");
    if (!reply.location.empty()) message.set(http::field::location, reply.location);
    if (!reply.allow.empty()) message.set(http::field::allow, reply.allow);
    message.keep_alive(!close_after_);
  }

  void send(const ApiReply& reply) {
    auto message =
        std::make_shared<http::response<http::string_body>>(static_cast<http::status>(reply.status), version_);
    set_common_fields(*message, reply);
    message->content_length(reply.body.size());
    if (!head_only_) message->body() = reply.body;
    stream_.expires_after(kWriteTime);
    http::async_write(stream_, *message, [self = this->shared_from_this(), message](error_code error, std::size_t) {
      self->after_answer(error);
    });
  }

  void after_answer(error_code error) {
    if (error) return;
    if (close_after_) return shut();
    read();
  }

  void shut() {
    error_code ignored;
    stream_.socket().shutdown(Protocol::socket::shutdown_send, ignored);
  }

  // Files go out in pieces, so that one download never holds the thread or much memory.
  void send_file(const ApiReply& reply) {
    file_.reset(std::fopen(reply.file->c_str(), "rb"));
    std::error_code size_error;
    const std::uint64_t size = std::filesystem::file_size(*reply.file, size_error);
    if (!file_ || size_error) {
      return send(problem(410, "file is gone", "'" + reply.file->filename().string() + "' was removed from the store"));
    }
    ByteRange range{0, size};
    int status = 200;
    if (const auto asked = parse_range(range_, size)) {
      if (asked->first >= asked->last) {
        return send(problem(416, "range not satisfiable", "the file has " + std::to_string(size) + " bytes"));
      }
      range = *asked;
      status = 206;
    }
    file_left_ = range.last - range.first;
    if (std::fseek(file_.get(), static_cast<long>(range.first), SEEK_SET) != 0) return;
    auto message = std::make_shared<http::response<http::empty_body>>(static_cast<http::status>(status), version_);
    set_common_fields(*message, reply);
    message->set(http::field::accept_ranges, "bytes");
    if (status == 206) {
      message->set(http::field::content_range, "bytes " + std::to_string(range.first) + "-" +
                                                   std::to_string(range.last - 1) + "/" + std::to_string(size));
    }
    message->content_length(file_left_);
    auto serializer = std::make_shared<http::response_serializer<http::empty_body>>(*message);
    stream_.expires_after(kWriteTime);
    http::async_write_header(stream_, *serializer,
                             [self = this->shared_from_this(), message, serializer](error_code error, std::size_t) {
                               if (error) return;
                               if (self->head_only_) return self->after_answer({});
                               self->send_file_piece();
                             });
  }

  void send_file_piece() {
    if (file_left_ == 0) {
      file_.reset();
      return after_answer({});
    }
    const std::size_t wanted = static_cast<std::size_t>(std::min<std::uint64_t>(piece_.size(), file_left_));
    const std::size_t got = std::fread(piece_.data(), 1, wanted, file_.get());
    if (got == 0) return;  // truncated meanwhile: the connection closes short of the promised length
    file_left_ -= got;
    stream_.expires_after(kWriteTime);
    asio::async_write(stream_, asio::buffer(piece_.data(), got),
                      [self = this->shared_from_this()](error_code error, std::size_t) {
                        if (!error) self->send_file_piece();
                      });
  }

  void start_events(std::uint64_t job) {
    followed_ = job;
    shared_.sinks.insert(this);
    const auto begin_with = [&](const JobRecord& record) {
      if (job == record.id || (job == 0 && !is_final(record.state))) changed_.insert(record.id);
    };
    for (const auto& record : shared_.service.scans()) begin_with(record);
    for (const auto& record : shared_.service.calibrations()) begin_with(record);
    text_ =
        "HTTP/1.1 200 OK\r\nServer: celadond\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n"
        "X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n";
    write_events();
  }

  void write_events() {
    for (const std::uint64_t id : std::exchange(changed_, {})) {
      if (const auto scan = shared_.service.scan(id)) {
        add_event("scan", to_json(*scan), *scan);
      } else if (const auto calibration = shared_.service.calibration(id)) {
        add_event("calibration", to_json(*calibration), *calibration);
      }
    }
    if (text_.empty()) text_ = ":\n\n";  // heartbeat: finds clients that are gone
    stream_.expires_after(kWriteTime);
    asio::async_write(stream_, asio::buffer(text_), [self = this->shared_from_this()](error_code error, std::size_t) {
      if (error) return;
      self->text_.clear();
      if (self->ended_) return self->shut();
      self->pause_events();
    });
  }

  void add_event(const char* name, const nlohmann::json& data, const JobRecord& job) {
    text_ += "id: " + std::to_string(++event_number_) + "\nevent: " + name + "\ndata: " + data.dump() + "\n\n";
    if (followed_ == job.id && is_final(job.state)) ended_ = true;
  }

  // At most ten events a second and client; between them only a set of numbers grows.
  void pause_events() {
    stream_.expires_never();
    timer_.expires_after(kEventPause);
    timer_.async_wait([self = this->shared_from_this()](error_code) {
      if (!self->changed_.empty()) return self->write_events();
      self->waiting_for_change_ = true;
      self->timer_.expires_after(kEventHeartbeat);
      self->timer_.async_wait([self](error_code) {
        self->waiting_for_change_ = false;
        self->write_events();
      });
    });
  }

  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  Stream stream_;
  asio::steady_timer timer_;
  Shared& shared_;
  beast::flat_buffer buffer_{kHeaderLimit + kBodyLimit};
  std::optional<http::request_parser<http::string_body>> parser_;
  unsigned version_ = 11;
  bool close_after_ = false, head_only_ = false;
  std::string range_;
  std::unique_ptr<std::FILE, Close> file_;
  std::uint64_t file_left_ = 0;
  std::array<char, 64 * 1024> piece_{};
  std::uint64_t followed_ = 0, event_number_ = 0;
  std::set<std::uint64_t> changed_;
  std::string text_;
  bool ended_ = false, waiting_for_change_ = false;
};

}  // namespace

struct HttpServer::Impl {
  explicit Impl(ScanService& scan_service) : service(scan_service), shared{scan_service, 0, {}} {}

  template <class Protocol>
  void accept(typename Protocol::acceptor& acceptor) {
    acceptor.async_accept([this, &acceptor](error_code error, typename Protocol::socket socket) {
      if (error == asio::error::operation_aborted) return;
      if (!error) {
        const bool busy = shared.connections >= kConnectionLimit;
        auto session = std::make_shared<Session<Protocol>>(std::move(socket), shared);
        busy ? session->refuse_as_busy() : session->read();
        accept<Protocol>(acceptor);
        return;
      }
      // Out of descriptors: wait for some to come back instead of spinning.
      retry.expires_after(200ms);
      retry.async_wait([this, &acceptor](error_code stopped) {
        if (!stopped) accept<Protocol>(acceptor);
      });
    });
  }

  void start() {
    subscription = service.subscribe([this](std::uint64_t id) {
      asio::post(context, [this, id] {
        for (EventSink* sink : shared.sinks) sink->job_changed(id);
      });
    });
    thread = std::thread([this] {
      for (;;) {
        try {
          context.run();
          return;
        } catch (const std::exception& error) {
          // A session's failure ends that session alone.
          std::fprintf(stderr, "celadond: an HTTP session ended by an error: %s\n", error.what());
        }
      }
    });
  }

  void stop() {
    if (subscription != 0) service.unsubscribe(subscription);
    context.stop();
    if (thread.joinable()) thread.join();
    if (!unix_path.empty()) ::unlink(unix_path.c_str());
  }

  ScanService& service;
  Shared shared;  // outlives the context, whose destruction ends the sessions
  asio::io_context context{1};
  asio::ip::tcp::acceptor tcp{context};
  asio::local::stream_protocol::acceptor unix{context};
  asio::steady_timer retry{context};
  std::string unix_path;
  std::uint64_t subscription = 0;
  std::thread thread;
};

tl::expected<std::unique_ptr<HttpServer>, std::string> HttpServer::start(ScanService& service,
                                                                         const HttpServerOptions& options) {
  error_code error;
  const auto address = asio::ip::make_address(options.address, error);
  if (error || !address.is_loopback()) {
    return tl::unexpected("HTTP address '" + options.address +
                          "' is not a loopback address; the API has no authentication yet: use 127.0.0.1 or ::1");
  }
  auto impl = std::make_unique<Impl>(service);
  const asio::ip::tcp::endpoint endpoint(address, options.port);
  const auto failed = [&](const std::string& place) {
    return tl::unexpected("cannot serve HTTP on " + place + ": " + error.message() + " (error " +
                          std::to_string(error.value()) + "); is another celadond running?");
  };
  const std::string place = options.address + " port " + std::to_string(options.port);
  if (impl->tcp.open(endpoint.protocol(), error)) return failed(place);
  impl->tcp.set_option(asio::socket_base::reuse_address(true), error);
  if (impl->tcp.bind(endpoint, error) || impl->tcp.listen(64, error)) return failed(place);
  impl->accept<asio::ip::tcp>(impl->tcp);
  if (!options.unix_socket.empty()) {
    const asio::local::stream_protocol::endpoint path(options.unix_socket);
    // A socket file nobody answers is left over from a killed daemon.
    asio::local::stream_protocol::socket probe(impl->context);
    if (probe.connect(path, error) && error == asio::error::connection_refused) ::unlink(options.unix_socket.c_str());
    if (impl->unix.open(path.protocol(), error) || impl->unix.bind(path, error) || impl->unix.listen(64, error)) {
      return failed("unix socket " + options.unix_socket);
    }
    impl->unix_path = options.unix_socket;
    impl->accept<asio::local::stream_protocol>(impl->unix);
  }
  impl->start();
  return std::unique_ptr<HttpServer>(new HttpServer(std::move(impl)));
}

HttpServer::HttpServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
HttpServer::~HttpServer() {
  impl_->stop();
}
std::uint16_t HttpServer::port() const {
  return impl_->tcp.local_endpoint().port();
}

}  // namespace celadon
