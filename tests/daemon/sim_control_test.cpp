// The client of the virtual scanner's control socket against a server that speaks CONTROL.md by hand.

#include "daemon/sim_control.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cmath>
#include <functional>
#include <thread>

#include "daemon/scan_truth.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::TemporaryFolder;

/// Serves one connection with a function from request to answer line; an empty answer closes it.
class HandServer {
 public:
  HandServer(const std::filesystem::path& folder, std::function<std::string(const std::string&)> answer)
      : answer_(std::move(answer)), listener_(::socket(AF_UNIX, SOCK_STREAM, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::snprintf(address.sun_path, sizeof address.sun_path, "%s/control.sock", folder.c_str());
    EXPECT_EQ(::bind(listener_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    EXPECT_EQ(::listen(listener_, 4), 0);
    thread_ = std::thread([this] { serve(); });
  }
  ~HandServer() {
    ::shutdown(listener_, SHUT_RDWR);
    thread_.join();
    ::close(listener_);
  }

 private:
  void serve() {
    for (int fd = 0; (fd = ::accept(listener_, nullptr, nullptr)) >= 0; ::close(fd)) {
      std::string line;
      char c = 0;
      while (::read(fd, &c, 1) == 1) {
        if (c != '\n') {
          line += c;
          continue;
        }
        const std::string text = answer_(line);
        if (text.empty()) break;
        line.clear();
        if (::send(fd, text.data(), text.size(), MSG_NOSIGNAL) < 0) break;
      }
    }
  }
  std::function<std::string(const std::string&)> answer_;
  int listener_;
  std::thread thread_;
};

TEST(SimControl, SpeaksTheProtocol) {
  const TemporaryFolder folder;
  const HandServer server(folder.path(), [](const std::string& request) -> std::string {
    if (request == "hello") return "{\"ok\": true, \"version\": 1, \"lock_step\": true}\n";
    if (request == "state") return "{\"ok\": true, \"lasers_on\": 0}\n";
    return "{\"ok\": false, \"error\": \"what is " + request + "\"}\n";
  });
  auto control = SimControl::open(folder.path());
  ASSERT_TRUE(control) << control.error();
  EXPECT_TRUE((*control)->lock_step());
  EXPECT_EQ((*control)->ask("state").value()["lasers_on"], 0);
  const auto refused = (*control)->ask("dance");
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().find("what is dance"), std::string::npos);
  const auto many = (*control)->ask_all(std::vector<std::string>(1000, "state"));
  ASSERT_TRUE(many);
  EXPECT_EQ(many->size(), 1000u);
}

TEST(SimControl, NamesWhatIsMissingOrOfAnotherVersion) {
  const TemporaryFolder folder;
  const auto absent = SimControl::open(folder.path());
  ASSERT_FALSE(absent);
  EXPECT_NE(absent.error().find("control.sock"), std::string::npos);
  EXPECT_FALSE(SimControl::open(std::string(300, 'x')));
  const HandServer server(folder.path(), [](const std::string&) { return "{\"ok\": true, \"version\": 2}\n"; });
  const auto other = SimControl::open(folder.path());
  ASSERT_FALSE(other);
  EXPECT_NE(other.error().find("version 2"), std::string::npos) << other.error();
}

TEST(SimClock, DeclaresItsWaits) {
  const TemporaryFolder folder;
  std::int64_t time_ns = 1000;
  const HandServer server(folder.path(), [&](const std::string& request) -> std::string {
    if (request == "hello") return "{\"ok\": true, \"version\": 1, \"lock_step\": true}\n";
    if (request.rfind("wait-until ", 0) == 0) time_ns = std::max<std::int64_t>(time_ns, std::stoll(request.substr(11)));
    return "{\"ok\": true, \"time_ns\": " + std::to_string(time_ns) + "}\n";
  });
  auto control = SimControl::open(folder.path());
  ASSERT_TRUE(control);
  SimClock clock(std::move(*control));
  EXPECT_EQ(clock.now_ns(), 1000);
  clock.sleep_until(3'600'000'000'000);  // an hour of device time
  EXPECT_EQ(clock.now_ns(), 3'600'000'000'000);
  clock.sleep_until(5);
  EXPECT_EQ(clock.now_ns(), 3'600'000'000'000);
}

TEST(SimClock, RunsOnWhenTheSimulatorIsGone) {
  const TemporaryFolder folder;
  std::unique_ptr<SimClock> clock;
  {
    int requests = 0;
    const HandServer server(folder.path(), [&](const std::string&) -> std::string {
      if (++requests > 2) return "";
      return "{\"ok\": true, \"version\": 1, \"time_ns\": 7000000}\n";
    });
    auto control = SimControl::open(folder.path());
    ASSERT_TRUE(control);
    clock = std::make_unique<SimClock>(std::move(*control));
    EXPECT_EQ(clock->now_ns(), 7'000'000);
    const std::int64_t after = clock->now_ns();
    EXPECT_GE(after, 7'000'000);
    clock->sleep_until(after + 1'000'000);
    EXPECT_GE(clock->now_ns(), after + 1'000'000);
  }
}

TEST(SimTruth, ComparesTheFitWithTheClosedForm) {
  const TemporaryFolder folder;
  const HandServer server(folder.path(), [](const std::string& request) -> std::string {
    if (request == "hello") return "{\"ok\": true, \"version\": 1}\n";
    if (request == "scene") return "{\"ok\": true, \"name\": \"cone\", \"z_min_mm\": 0, \"z_max_mm\": 100}\n";
    double theta = 0, z = 0;
    if (std::sscanf(request.c_str(), "truth %lf %lf", &theta, &z) != 2 || z > 90) {
      return "{\"ok\": false, \"error\": \"nothing there\"}\n";
    }
    return "{\"ok\": true, \"r_mm\": " + std::to_string(30 + z / 10) + "}\n";
  });
  auto control = SimControl::open(folder.path());
  ASSERT_TRUE(control);
  SimTruth truth(std::move(*control));
  const auto points = truth.points();
  ASSERT_TRUE(points) << points.error();
  EXPECT_GT(points->size(), 3000u);
  EXPECT_LT(points->size(), 4096u);
  // A fitted cone that is 0.05 mm too wide, from z = 20 to 80.
  BaseSurface base;
  base.band_start = 20;
  base.band_end = 80;
  Eigen::MatrixXd c(2, 1);
  c << 32.05, 38.05;
  const RangeFunction cone(base, 1, 0, {0, 0, 1, 1}, {0, 4}, c);
  const auto error = truth_error(std::vector<const RangeFunction*>{&cone}, *points);
  ASSERT_TRUE(error);
  EXPECT_NEAR(error->bias, 0.05, 1e-6);
  EXPECT_NEAR(error->rms, 0.05, 1e-6);
  EXPECT_NEAR(error->max, 0.05, 1e-6);
  const RangeFunction far(
      BaseSurface{BaseKind::cylinder, BaseArcs::full_circle(), 200, 300, Eigen::Isometry3d::Identity()}, 1, 0,
      {0, 0, 1, 1}, {0, 4}, c);
  EXPECT_FALSE(truth_error(std::vector<const RangeFunction*>{&far}, *points));
}

}  // namespace
}  // namespace celadon
