// The API over real sockets against a service made of a list: routes, errors, ranges, events, and clients that are
// slow, many or hostile.

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <condition_variable>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <sstream>
#include <thread>

#include "daemon/http/api.h"
#include "daemon/http/http_client.h"
#include "daemon/http/http_server.h"
#include "tests/build_paths.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

class ListService : public ScanService {
 public:
  MachineState machine() const override {
    MachineState state;
    state.connected = true;
    state.machine = "Celadon test 1";
    return state;
  }
  tl::expected<ScanRecord, ServiceError> submit(const ScanRequest& request, const std::string& by) override {
    std::lock_guard lock(mutex_);
    ScanRecord record;
    record.id = records_.size() + 1;
    record.request = request;
    record.requested_by = by;
    records_[record.id] = record;
    return record;
  }
  std::vector<ScanRecord> scans() const override {
    std::lock_guard lock(mutex_);
    std::vector<ScanRecord> all;
    for (const auto& [id, record] : records_) all.push_back(record);
    return all;
  }
  std::optional<ScanRecord> scan(std::uint64_t id) const override {
    std::lock_guard lock(mutex_);
    const auto found = records_.find(id);
    return found == records_.end() ? std::nullopt : std::optional(found->second);
  }
  tl::expected<CalibrationRecord, ServiceError> calibrate(const CalibrationRequest& request,
                                                          const std::string& by) override {
    std::lock_guard lock(mutex_);
    CalibrationRecord record;
    record.id = 100 + calibrations_.size();
    record.request = request;
    record.requested_by = by;
    calibrations_[record.id] = record;
    return record;
  }
  std::vector<CalibrationRecord> calibrations() const override {
    std::lock_guard lock(mutex_);
    std::vector<CalibrationRecord> all;
    for (const auto& [id, record] : calibrations_) all.push_back(record);
    return all;
  }
  std::optional<CalibrationRecord> calibration(std::uint64_t id) const override {
    std::lock_guard lock(mutex_);
    const auto found = calibrations_.find(id);
    return found == calibrations_.end() ? std::nullopt : std::optional(found->second);
  }
  tl::expected<void, ServiceError> confirm(std::uint64_t id, std::optional<int> step) override {
    CalibrationRecord record = *calibration(id);
    if (record.state != ScanState::paused || step.value_or(record.step) != record.step)
      return tl::unexpected(ServiceError{409, "waits for no hand", "calibration is elsewhere"});
    record.state = ScanState::preparing;
    change(record);
    return {};
  }
  tl::expected<void, ServiceError> cancel(std::uint64_t id) override {
    if (auto calibrating = calibration(id)) {
      calibrating->state = ScanState::cancelled;
      change(*calibrating);
      return {};
    }
    ScanRecord record = *scan(id);
    if (is_final(record.state)) {
      return tl::unexpected(ServiceError{409, "already finished", "scan is " + std::string(to_string(record.state))});
    }
    record.state = ScanState::cancelled;
    change(record);
    return {};
  }
  std::uint64_t subscribe(std::function<void(std::uint64_t)> listener) override {
    std::lock_guard lock(mutex_);
    listener_ = std::move(listener);
    return 1;
  }
  void unsubscribe(std::uint64_t) override {
    std::lock_guard lock(mutex_);
    listener_ = {};
  }
  void change(const ScanRecord& record) {
    std::lock_guard lock(mutex_);
    records_[record.id] = record;
    if (listener_) listener_(record.id);
  }
  void change(const CalibrationRecord& record) {
    std::lock_guard lock(mutex_);
    calibrations_[record.id] = record;
    if (listener_) listener_(record.id);
  }

 private:
  mutable std::mutex mutex_;
  std::map<std::uint64_t, ScanRecord> records_;
  std::map<std::uint64_t, CalibrationRecord> calibrations_;
  std::function<void(std::uint64_t)> listener_;
};

class Http : public testing::Test {
 protected:
  Http() {
    folder_ = fs::temp_directory_path() / ("celadon-http-" + std::to_string(::getpid()));
    fs::create_directories(folder_);
    HttpServerOptions options;
    options.port = 0;
    options.unix_socket = folder_ / "api.sock";
    auto started = HttpServer::start(service_, options);
    if (!started) throw std::runtime_error(started.error());
    server_ = std::move(*started);
    url_ = "http://127.0.0.1:" + std::to_string(server_->port());
  }
  ~Http() override {
    server_.reset();
    fs::remove_all(folder_);
  }

  int connect_raw() const {
    const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(server_->port());
    ::inet_pton(AF_INET, "127.0.0.1", &address.sin_addr);
    EXPECT_EQ(::connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    return fd;
  }
  // Sends text and reads until the server closes or `until` was seen.
  std::string raw(const std::string& text, const std::string& until = "") const {
    const int fd = connect_raw();
    EXPECT_EQ(::send(fd, text.data(), text.size(), MSG_NOSIGNAL), static_cast<ssize_t>(text.size()));
    std::string answer;
    char piece[4096];
    for (ssize_t got; (got = ::recv(fd, piece, sizeof piece, 0)) > 0;) {
      answer.append(piece, static_cast<std::size_t>(got));
      if (!until.empty() && answer.find(until) != std::string::npos) break;
    }
    ::close(fd);
    return answer;
  }
  ScanRecord finished_scan_with(const std::string& name, const std::string& content) {
    ScanRecord record = *service_.submit({}, "api");
    record.state = ScanState::done;
    record.folder = folder_;
    record.files = {name};
    std::ofstream(folder_ / name, std::ios::binary) << content;
    service_.change(record);
    return record;
  }

  ListService service_;
  fs::path folder_;
  std::unique_ptr<HttpServer> server_;
  std::string url_;
};

TEST_F(Http, ScanIsCreatedFoundListedAndCancelled) {
  HttpClient client(url_);
  const auto created = client.post("/api/v1/scans", json{{"name", "vase 1"}, {"profiles", 400}});
  ASSERT_TRUE(created) << created.error();
  EXPECT_EQ(created->status, 201);
  EXPECT_EQ(created->location, "/api/v1/scans/1");
  EXPECT_EQ(json::parse(created->body)["request"]["profiles"], 400);
  EXPECT_EQ(json::parse(client.get(created->location)->body)["state"], "queued");
  EXPECT_EQ(json::parse(client.get("/api/v1/scans")->body)["scans"].size(), 1u);
  EXPECT_EQ(json::parse(client.post("/api/v1/scans/1/cancel", json::object())->body)["state"], "cancelled");
  const auto again = client.post("/api/v1/scans/1/cancel", json::object());
  EXPECT_EQ(again->status, 409);
  EXPECT_EQ(json::parse(again->body)["status"], 409);
}

TEST_F(Http, CalibrationIsCreatedFoundListedConfirmedAndCancelled) {
  HttpClient client(url_);
  const auto created = client.post("/api/v1/calibrations", json{{"board", "tags:10x7x8"}, {"width_mm", 80.1}});
  ASSERT_TRUE(created) << created.error();
  EXPECT_EQ(created->status, 201);
  EXPECT_EQ(created->location, "/api/v1/calibrations/100");
  EXPECT_EQ(json::parse(created->body)["request"]["width_mm"], 80.1);
  EXPECT_EQ(json::parse(client.get(created->location)->body)["state"], "queued");
  EXPECT_EQ(json::parse(client.get("/api/v1/calibrations")->body)["calibrations"].size(), 1u);
  EXPECT_EQ(client.get("/api/v1/scans/100")->status, 404) << "it is no scan";
  const std::string confirm = created->location + "/confirm";
  EXPECT_EQ(client.post(confirm, json::object())->status, 409);
  CalibrationRecord record = *service_.calibration(100);
  record.state = ScanState::paused;
  record.step = 2;
  record.instruction = "Hold the board.";
  record.look = BoardLook{true, "", true, false, 3, 25, "Tilt the board."};
  service_.change(record);
  const auto paused = json::parse(client.get(created->location)->body);
  EXPECT_EQ(paused["instruction"], "Hold the board.");
  EXPECT_EQ(paused["look"]["advice"], "Tilt the board.");
  EXPECT_EQ(client.post(confirm, json{{"step", 1}})->status, 409);
  EXPECT_EQ(client.post(confirm, json{{"hand", 1}})->status, 422);
  EXPECT_EQ(json::parse(client.post(confirm, json{{"step", 2}})->body)["state"], "preparing");
  EXPECT_EQ(json::parse(client.post(created->location + "/cancel", json::object())->body)["state"], "cancelled");
}

TEST_F(Http, CalibrationsAreFollowedAndTheirFileFetched) {
  CalibrationRecord record = *service_.calibrate({}, "api");
  record.folder = folder_;
  std::ofstream(folder_ / "calibration.toml") << "[camera]\n";
  std::vector<std::string> names;
  HttpClient client(url_);
  const auto followed = client.events("/api/v1/events", [&](const std::string& name, const std::string& data) {
    names.push_back(name + " " + json::parse(data)["state"].get<std::string>());
    record.state = record.state == ScanState::queued ? ScanState::paused : ScanState::done;
    record.files = {"calibration.toml"};
    service_.change(record);
    return names.size() < 3;
  });
  ASSERT_TRUE(followed) << followed.error();
  EXPECT_EQ(names, (std::vector<std::string>{"calibration queued", "calibration paused", "calibration done"}));
  names.clear();
  ASSERT_TRUE(client.events("/api/v1/calibrations/100/events", [&](const std::string& name, const std::string&) {
    names.push_back(name);
    return true;
  })) << "its stream ends with it";
  EXPECT_EQ(names, std::vector<std::string>{"calibration"});
  ASSERT_TRUE(client.download("/api/v1/calibrations/100/files/calibration.toml", folder_ / "copy.toml"));
  EXPECT_EQ(client.get("/api/v1/calibrations/100/files/calibration.json")->status, 404);
}

TEST_F(Http, SameApiOnTheUnixSocket) {
  HttpClient client("unix:" + (folder_ / "api.sock").string());
  const auto device = client.get("/api/v1/device");
  ASSERT_TRUE(device) << device.error();
  EXPECT_EQ(json::parse(device->body)["machine"], "Celadon test 1");
}

TEST_F(Http, ErrorsAreProblemDetailsThatNameTheValue) {
  HttpClient client(url_);
  struct Case {
    const char *method, *path, *body;
    int status;
    const char* names;
  };
  for (const Case& c : {Case{"POST", "/api/v1/scans", R"({"profiles": 3})", 422, "3"},
                        Case{"POST", "/api/v1/scans", R"({"profils": 300})", 422, "profils"},
                        Case{"POST", "/api/v1/scans", R"({"profiles": "many"})", 422, "profiles"},
                        Case{"POST", "/api/v1/scans", R"([1])", 422, "object"},
                        Case{"POST", "/api/v1/calibrations", R"({"width_mm": 0})", 422, "width_mm is 0"},
                        Case{"POST", "/api/v1/calibrations", R"({"board": "paper"})", 422, "paper"},
                        Case{"POST", "/api/v1/calibrations/9/confirm", R"({})", 404, "9"},
                        Case{"GET", "/api/v1/scans/77", "", 404, "77"}, Case{"GET", "/api/v1/scans/-1", "", 404, "-1"},
                        Case{"GET", "/api/v1/scans/18446744073709551617", "", 404, "18446744073709551617"},
                        Case{"GET", "/api/v1/nothing", "", 404, "nothing"}}) {
    const auto answer = std::string(c.method) == "GET" ? client.get(c.path) : client.post(c.path, json::parse(c.body));
    ASSERT_TRUE(answer) << answer.error();
    EXPECT_EQ(answer->status, c.status) << c.path << c.body;
    const auto problem = json::parse(answer->body);
    EXPECT_EQ(problem["status"], c.status);
    EXPECT_NE(problem["detail"].get<std::string>().find(c.names), std::string::npos) << problem;
  }
  const std::string not_a_number = R"({"width_mm": NaN})";
  EXPECT_NE(
      raw("POST /api/v1/calibrations HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nConnection: "
          "close\r\nContent-Length: " +
          std::to_string(not_a_number.size()) + "\r\n\r\n" + not_a_number)
          .find(" 400 "),
      std::string::npos);
  const auto wrong_method = raw("DELETE /api/v1/scans HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  EXPECT_NE(wrong_method.find(" 405 "), std::string::npos);
  EXPECT_NE(wrong_method.find("Allow: GET, POST"), std::string::npos);
}

TEST_F(Http, OtherSitesAndHostsAreRefused) {
  for (const char* header : {"Host: evil.example\r\n", "Host: localhost\r\nOrigin: http://evil.example\r\n",
                             "Host: localhost\r\nOrigin: null\r\n", "Host: localhost.evil.example\r\n"}) {
    EXPECT_NE(raw(std::string("GET /api/v1/device HTTP/1.1\r\nConnection: close\r\n") + header + "\r\n").find(" 403 "),
              std::string::npos)
        << header;
  }
  EXPECT_NE(raw("POST /api/v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/plain\r\nConnection: close\r\n"
                "Content-Length: 2\r\n\r\n{}")
                .find(" 415 "),
            std::string::npos);
  EXPECT_TRUE(service_.scans().empty());
}

TEST_F(Http, DownloadsWholeAndInRanges) {
  std::string content;
  for (int i = 0; i < 300000; ++i) content += static_cast<char>(i * 7 % 251);
  finished_scan_with("vase.step", content);
  HttpClient client(url_);
  ASSERT_TRUE(client.download("/api/v1/scans/1/files/vase.step", folder_ / "copy.step"));
  std::ifstream in(folder_ / "copy.step", std::ios::binary);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(in), {}), content);
  const std::string head = "GET /api/v1/scans/1/files/vase.step HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n";
  const auto part = raw(head + "Range: bytes=100-199\r\n\r\n");
  EXPECT_NE(part.find(" 206 "), std::string::npos);
  EXPECT_NE(part.find("Content-Range: bytes 100-199/300000"), std::string::npos);
  EXPECT_EQ(part.substr(part.size() - 100), content.substr(100, 100));
  EXPECT_NE(raw(head + "Range: bytes=300000-\r\n\r\n").find(" 416 "), std::string::npos);
  EXPECT_NE(raw(head + "Range: lines=1-2\r\n\r\n").find(" 200 "), std::string::npos);
  for (const char* name : {"report.json", "..%2F..%2Fetc%2Fpasswd", "../../etc/passwd", "."}) {
    EXPECT_NE(raw(std::string("GET /api/v1/scans/1/files/") + name +
                  " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
                  .find(" 404 "),
              std::string::npos)
        << name;
  }
}

TEST(ParseRange, FollowsTheRules) {
  const auto range = [](const char* header) { return parse_range(header, 1000); };
  EXPECT_EQ(range("bytes=0-0")->last, 1u);
  EXPECT_EQ(range("bytes=-10")->first, 990u);
  EXPECT_EQ(range("bytes=-5000")->first, 0u);
  EXPECT_EQ(range("bytes=990-5000")->last, 1000u);
  EXPECT_EQ(range("bytes=1000-")->first, range("bytes=1000-")->last);
  for (const char* ignored : {"", "bytes=", "bytes=a-b", "bytes=5-2", "bytes=0-1,3-4", "bytes=--3", "items=0-1"}) {
    EXPECT_FALSE(range(ignored)) << ignored;
  }
}

TEST_F(Http, EventsBeginWithTheStateAndEndWithTheScan) {
  ScanRecord record = *service_.submit({}, "button");
  std::vector<std::string> states;
  HttpClient client(url_);
  const auto followed = client.events("/api/v1/scans/1/events", [&](const std::string& name, const std::string& data) {
    EXPECT_EQ(name, "scan");
    states.push_back(json::parse(data)["state"]);
    if (states.size() == 1) {
      record.state = ScanState::scanning;
      service_.change(record);
    } else if (states.size() == 2) {
      record.state = ScanState::done;
      service_.change(record);
    }
    return true;
  });
  ASSERT_TRUE(followed) << followed.error();
  EXPECT_EQ(states, (std::vector<std::string>{"queued", "scanning", "done"}));
}

TEST_F(Http, ClientsThatNeverReadDoNotHoldUpAnybody) {
  ScanRecord record = *service_.submit({}, "api");
  CalibrationRecord calibration = *service_.calibrate({}, "api");
  calibration.state = ScanState::scanning;
  std::vector<int> silent;
  for (int i = 0; i < 40; ++i) {
    const int fd = connect_raw();
    const std::string head = "GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n";
    ASSERT_GT(::send(fd, head.data(), head.size(), MSG_NOSIGNAL), 0);
    silent.push_back(fd);
  }
  record.state = ScanState::scanning;
  for (int i = 0; i < 20000; ++i) {  // far more changes than any socket buffer holds
    record.progress.frames = i;
    service_.change(record);
    calibration.message = "look " + std::to_string(i);
    service_.change(calibration);
  }
  HttpClient client(url_);
  const auto answer = client.get("/api/v1/scans/1");
  ASSERT_TRUE(answer) << answer.error();
  EXPECT_EQ(json::parse(answer->body)["progress"]["frames"], 19999);
  EXPECT_EQ(json::parse(client.get("/api/v1/calibrations/100")->body)["message"], "look 19999");
  for (const int fd : silent) ::close(fd);
}

TEST_F(Http, MoreConnectionsThanItServesAreToldSo) {
  std::vector<int> idle;
  for (int i = 0; i < 128; ++i) idle.push_back(connect_raw());
  EXPECT_NE(raw("GET /api/v1/device HTTP/1.1\r\nHost: localhost\r\n\r\n", "detail").find(" 503 "), std::string::npos);
  for (const int fd : idle) ::close(fd);
}

TEST_F(Http, HostileBytesGetAnAnswerOrAClosedDoor) {
  for (const std::string& bytes :
       {std::string("\0\0\0\0\r\n\r\n", 8), std::string("GET"), std::string("GET / HTTP/9.9\r\n\r\n"),
        "GET /" + std::string(20000, 'a') + " HTTP/1.1\r\n\r\n",
        std::string("POST /api/v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                    "Content-Length: 99999999999\r\n\r\n"),
        std::string("POST /api/v1/scans HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n")}) {
    const int fd = connect_raw();
    ASSERT_GE(::send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL), 0);
    ::shutdown(fd, SHUT_WR);
    char piece[4096];
    while (::recv(fd, piece, sizeof piece, 0) > 0) {
    }
    ::close(fd);
  }
  EXPECT_TRUE(HttpClient(url_).get("/api/v1/device"));
}

TEST_F(Http, OnlyLoopbackIsServed) {
  HttpServerOptions options;
  options.address = "0.0.0.0";
  const auto refused = HttpServer::start(service_, options);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().find("0.0.0.0"), std::string::npos);
  options.address = "127.0.0.1";
  options.port = server_->port();
  const auto taken = HttpServer::start(service_, options);
  ASSERT_FALSE(taken);
  EXPECT_NE(taken.error().find(std::to_string(options.port)), std::string::npos);
}

TEST(OpenApi, NamesExactlyTheRoutesThatExist) {
  std::ifstream in(std::string(CELADON_SOURCE_DIR) + "/daemon/openapi.yaml");
  std::set<std::string> written;
  std::string path;
  for (std::string line; std::getline(in, line);) {
    std::smatch match;
    if (std::regex_match(line, match, std::regex("  (/[^:]*):"))) path = match[1];
    if (line.rfind("components:", 0) == 0) break;
    if (std::regex_match(line, match, std::regex("    (get|post|delete|put):"))) {
      std::string method = match[1];
      for (char& c : method) c = static_cast<char>(std::toupper(c));
      written.insert(method + " " + path);
    }
  }
  const auto routes = api_routes();
  EXPECT_EQ(written, std::set<std::string>(routes.begin(), routes.end()));
}

}  // namespace
}  // namespace celadon
