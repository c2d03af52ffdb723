// The client of the frame ring against a small server that can lie.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <filesystem>
#include <functional>
#include <thread>

#include "acquisition/frame_ring.h"
#include "acquisition/frame_sources.h"

namespace celadon {
namespace {

using frame_ring::Hello;
using frame_ring::Reply;
using frame_ring::ReplyKind;
using frame_ring::Request;
using frame_ring::RequestKind;
using testing::AllOf;
using testing::HasSubstr;
using Kind = CameraError::Kind;

constexpr std::uint32_t kWidth = 80, kHeight = 10, kStride = 96, kSlots = 3, kSlotBytes = 4096;

Hello good_hello() {
  Hello hello;
  hello.slot_count = kSlots;
  hello.slot_bytes = kSlotBytes;
  hello.width_px = kWidth;
  hello.height_px = kHeight;
  hello.stride_bytes = kStride;
  hello.format = 1;
  hello.frame_period_ns = 1'000'000;
  hello.exposure_ns = 500'000;
  std::snprintf(static_cast<char*>(hello.identity), sizeof hello.identity, "fake camera");
  return hello;
}

/// Greets one client and answers its requests by a script until it hangs up.
class FakeServer {
 public:
  struct Plan {
    Hello hello = good_hello();
    std::size_t hello_size = sizeof(Hello);
    std::size_t memory_bytes = kSlots * kSlotBytes;
    bool send_memory = true, seal = true, greet = true;
    /// The answer to the n-th request of a kind; nothing: hang up.
    std::function<std::optional<Reply>(const Request&, int)> answer;
    std::size_t reply_size = sizeof(Reply);
  };

  explicit FakeServer(Plan plan) : plan_(std::move(plan)) {
    folder_ = std::filesystem::path(testing::TempDir()) / ("ring" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder_);
    const std::string path = folder_ / "frames.sock";
    ::unlink(path.c_str());
    listener_ = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::snprintf(static_cast<char*>(address.sun_path), sizeof address.sun_path, "%s", path.c_str());
    EXPECT_EQ(::bind(listener_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    EXPECT_EQ(::listen(listener_, 1), 0);
    memory_ = ::memfd_create("frames", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    EXPECT_EQ(::ftruncate(memory_, static_cast<off_t>(plan_.memory_bytes)), 0);
    EXPECT_EQ(::fcntl(memory_, F_ADD_SEALS, plan_.seal ? F_SEAL_SHRINK : 0), 0);
    for (std::uint32_t slot = 0; slot < kSlots && plan_.memory_bytes == kSlots * kSlotBytes; ++slot) {
      const std::vector<std::uint8_t> bytes(kSlotBytes, static_cast<std::uint8_t>(slot + 1));
      EXPECT_EQ(::pwrite(memory_, bytes.data(), bytes.size(), slot * kSlotBytes), kSlotBytes);
    }
    thread_ = std::thread([this] { serve(); });
  }
  FakeServer(const FakeServer&) = delete;
  FakeServer& operator=(const FakeServer&) = delete;
  ~FakeServer() {
    ::shutdown(listener_, SHUT_RDWR);
    thread_.join();
    ::close(listener_);
    ::close(memory_);
    std::filesystem::remove_all(folder_);
  }

  std::string folder() const { return folder_; }
  std::vector<Request> requests;  ///< read after the client has gone

 private:
  void serve() {
    const int client = ::accept(listener_, nullptr, nullptr);
    if (client < 0) return;
    if (plan_.greet) greet(client);
    int count[6] = {};
    Request request;
    while (plan_.answer && ::recv(client, &request, sizeof request, 0) == sizeof request) {
      requests.push_back(request);
      if (request.kind == RequestKind::give_back) continue;
      const auto reply = plan_.answer(request, count[static_cast<int>(request.kind)]++);
      if (!reply) break;
      ::send(client, &*reply, plan_.reply_size, MSG_NOSIGNAL);
    }
    ::close(client);
  }
  void greet(int client) const {
    std::vector<char> bytes(std::max(plan_.hello_size, sizeof(Hello)));
    std::memcpy(bytes.data(), &plan_.hello, sizeof(Hello));
    iovec vector{bytes.data(), plan_.hello_size};
    alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))] = {};
    msghdr message{};
    message.msg_iov = &vector;
    message.msg_iovlen = 1;
    if (plan_.send_memory) {
      message.msg_control = control;
      message.msg_controllen = sizeof control;
      cmsghdr* header = CMSG_FIRSTHDR(&message);
      header->cmsg_level = SOL_SOCKET;
      header->cmsg_type = SCM_RIGHTS;
      header->cmsg_len = CMSG_LEN(sizeof(int));
      std::memcpy(CMSG_DATA(header), &memory_, sizeof memory_);
    }
    EXPECT_EQ(::sendmsg(client, &message, MSG_NOSIGNAL), static_cast<ssize_t>(plan_.hello_size));
  }

  Plan plan_;
  std::filesystem::path folder_;
  int listener_ = -1, memory_ = -1;
  std::thread thread_;
};

/// Frames in turn from all slots; numbers 0, 1, 2, ...
std::optional<Reply> steady(const Request& request, int n) {
  switch (request.kind) {
    case RequestKind::start:
      return Reply{.kind = ReplyKind::started};
    case RequestKind::stop:
      return Reply{.kind = ReplyKind::stopped};
    case RequestKind::set_exposure:
      return Reply{.kind = ReplyKind::exposure, .value = request.value / 1000 * 1000};
    default:
      return Reply{.kind = ReplyKind::frame,
                   .slot = static_cast<std::uint32_t>(n) % kSlots,
                   .sequence = static_cast<std::uint64_t>(n),
                   .stamp_ns = 1000 * n,
                   .exposure_ns = 500'000,
                   .bytes_used = kStride * kHeight};
  }
}

/// `steady` with the answers to `next` changed.
FakeServer::Plan with_frames(const std::function<std::optional<Reply>(Reply, int)>& change) {
  FakeServer::Plan plan;
  plan.answer = [change](const Request& request, int n) -> std::optional<Reply> {
    auto reply = steady(request, n);
    return request.kind == RequestKind::next ? change(*reply, n) : reply;
  };
  return plan;
}

std::unique_ptr<FrameSource> started(const FakeServer& server, std::int64_t limit_ns = 20'000'000'000) {
  auto source = open_sim_source(server.folder(), limit_ns);
  EXPECT_TRUE(source) << source.error().message;
  EXPECT_TRUE((*source)->start());
  return std::move(*source);
}

TEST(SimSource, frames_are_read_in_place_and_slots_given_back) {
  FakeServer::Plan plan;
  plan.answer = steady;
  FakeServer server(plan);
  {
    auto source = started(server);
    EXPECT_EQ(source->mode(), (CameraMode{.width_px = kWidth,
                                          .height_px = kHeight,
                                          .stride_bytes = kStride,
                                          .frame_period_ns = 1'000'000,
                                          .exposure_ns = 500'000,
                                          .identity = "fake camera",
                                          .simulated = true}));
    EXPECT_EQ(source->set_exposure(1'234'567).value(), 1'234'000);
    EXPECT_EQ(source->mode().exposure_ns, 1'234'000);
    for (int i = 0; i < 10; ++i) {
      auto frame = source->next(1'000'000);
      ASSERT_TRUE(frame) << frame.error().message;
      EXPECT_EQ(frame->bytes().size(), kStride * kHeight);
      EXPECT_EQ(frame->bytes()[0], i % 3 + 1);
      EXPECT_EQ(frame->info.sequence, static_cast<std::uint64_t>(i));
      EXPECT_EQ(frame->info.stamp_ns, 1000 * i);
      EXPECT_EQ(frame->info.lost_before, 0u);
      EXPECT_FALSE(frame->info.corrupt);
    }
    source->stop();
    source->stop();  // harmless
  }
  // start, exposure, ten frames each given back, stop, the exposure that was found.
  ASSERT_EQ(server.requests.size(), 2u + 20u + 2u);
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(server.requests[static_cast<std::size_t>(2 + 2 * i)].value, 1'000'000);
    const Request& back = server.requests[static_cast<std::size_t>(3 + 2 * i)];
    EXPECT_EQ(back.kind, RequestKind::give_back);
    EXPECT_EQ(back.value, i % 3);
  }
  EXPECT_EQ(server.requests[22].kind, RequestKind::stop);
  EXPECT_EQ(server.requests[23].kind, RequestKind::set_exposure);
  EXPECT_EQ(server.requests[23].value, 500'000);
}

TEST(SimSource, the_exposure_that_was_found_is_put_back_once) {
  FakeServer::Plan plan;
  plan.answer = steady;
  FakeServer server(plan);
  {
    auto source = started(server);
    source->restore_exposure();  // nobody set it
    ASSERT_TRUE(source->set_exposure(1'000'000));
    ASSERT_TRUE(source->set_exposure(2'000'000));
    source->restore_exposure();
    EXPECT_EQ(source->mode().exposure_ns, 500'000);
  }
  std::vector<std::int64_t> set;
  for (const Request& request : server.requests) {
    if (request.kind == RequestKind::set_exposure) set.push_back(request.value);
  }
  EXPECT_EQ(set, (std::vector<std::int64_t>{1'000'000, 2'000'000, 500'000}));
}

TEST(SimSource, lost_and_damaged_frames_are_told) {
  FakeServer server(with_frames([](Reply reply, int n) {
    reply.sequence = std::array<std::uint64_t, 4>{5, 6, 10, 11}[static_cast<std::size_t>(n)];
    reply.corrupt = n == 1;
    if (n == 3) reply.bytes_used -= 1;
    return std::optional(reply);
  }));
  auto source = started(server);
  std::vector<std::uint32_t> lost;
  std::vector<bool> corrupt;
  for (int i = 0; i < 4; ++i) {
    auto frame = source->next(0);
    ASSERT_TRUE(frame);
    lost.push_back(frame->info.lost_before);
    corrupt.push_back(frame->info.corrupt);
  }
  EXPECT_EQ(lost, (std::vector<std::uint32_t>{0, 0, 3, 0}));
  EXPECT_EQ(corrupt, (std::vector<bool>{false, true, false, true}));
}

TEST(SimSource, a_stalled_stream_times_out_and_goes_on) {
  FakeServer server(with_frames([](Reply reply, int n) {
    if (n == 0) reply.kind = ReplyKind::timed_out;
    return std::optional(reply);
  }));
  auto source = started(server);
  const auto stalled = source->next(25'000'000);
  ASSERT_FALSE(stalled);
  EXPECT_EQ(stalled.error().kind, Kind::timed_out);
  EXPECT_THAT(stalled.error().message, AllOf(HasSubstr("sim:"), HasSubstr("25 ms")));
  EXPECT_TRUE(source->next(0));
}

TEST(SimSource, an_unplugged_camera_is_told_by_name) {
  FakeServer server(with_frames([](Reply reply, int) {
    reply.kind = ReplyKind::fault;
    reply.value = ENODEV;
    return std::optional(reply);
  }));
  auto source = started(server);
  const auto gone = source->next(0);
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, Kind::unplugged);
  EXPECT_EQ(gone.error().errno_value, ENODEV);
  EXPECT_THAT(gone.error().message, HasSubstr("unplugged"));
}

TEST(SimSource, a_server_that_hangs_up_or_falls_silent_is_lost_for_good) {
  {
    FakeServer server(with_frames([](Reply, int) { return std::nullopt; }));
    auto source = started(server);
    EXPECT_EQ(source->next(0).error().kind, Kind::unplugged);
    EXPECT_EQ(source->next(0).error().kind, Kind::unplugged);
  }
  FakeServer::Plan silent;
  silent.answer = [](const Request& request, int n) {
    auto reply = steady(request, n);
    if (request.kind == RequestKind::next) reply->kind = ReplyKind{0};
    return reply;
  };
  FakeServer server(silent);
  auto source = started(server);
  EXPECT_EQ(source->next(0).error().kind, Kind::protocol);
  // A later answer must not be taken for that of another request.
  EXPECT_EQ(source->next(0).error().kind, Kind::unplugged);
}

TEST(SimSource, a_server_that_never_answers_is_given_up_by_the_watchdog) {
  FakeServer::Plan plan;
  plan.greet = false;
  plan.answer = steady;
  FakeServer server(plan);
  const auto source = open_sim_source(server.folder(), 20'000'000);
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().kind, Kind::timed_out);
  EXPECT_THAT(source.error().message, HasSubstr("no answer within 20 ms"));
}

TEST(SimSource, frames_that_cannot_be_are_refused) {
  struct Lie {
    std::function<void(Reply&, int)> change;
    const char* what;
  };
  for (const Lie& lie : {Lie{[](Reply&r, int) { r.slot = kSlots; }, "slot 3"},
                         Lie{[](Reply&r, int) { r.slot = UINT32_MAX; }, "slot 4294967295"},
                         Lie{[](Reply&r, int) { r.bytes_used = kSlotBytes + 1; }, "4097 bytes"},
                         Lie{[](Reply&r, int) { r.sequence = 9; }, "came after"},
                         Lie{[](Reply&r, int) { r.slot = 1; }, "lent already"}}) {
    FakeServer server(with_frames([&](Reply reply, int n) {
      lie.change(reply, n);
      return std::optional(reply);
    }));
    auto source = started(server);
    auto first = source->next(0);
    if (first) {
      const auto second = source->next(0);
      ASSERT_FALSE(second) << lie.what;
      EXPECT_EQ(second.error().kind, Kind::protocol);
      EXPECT_THAT(second.error().message, HasSubstr(lie.what));
    } else {
      EXPECT_EQ(first.error().kind, Kind::protocol);
      EXPECT_THAT(first.error().message, HasSubstr(lie.what));
    }
  }
}

TEST(SimSource, answers_of_another_length_are_refused) {
  FakeServer::Plan plan;
  plan.answer = steady;
  plan.reply_size = sizeof(Reply) - 4;
  FakeServer server(plan);
  auto source = open_sim_source(server.folder());
  ASSERT_TRUE(source);
  EXPECT_THAT((*source)->start().error().message, AllOf(HasSubstr("44 bytes instead of 48"), HasSubstr("same build")));
}

TEST(SimSource, greetings_that_lie_are_refused) {
  struct Lie {
    std::function<void(FakeServer::Plan&)> change;
    const char* what;
  };
  const std::vector<Lie> lies{
      {[](auto& p) { p.hello.magic = 7; }, "CLFR"},
      {[](auto& p) { p.hello.version = 2; }, "version 2"},
      {[](auto& p) {
         p.hello.version = 2;
         p.hello_size = sizeof(Hello) + 8;
       },
       "version 2"},
      {[](auto& p) { p.hello.width_px = 0; }, "0 x 10"},
      {[](auto& p) { p.hello.height_px = 1u << 31; }, "80 x 2147483648"},
      {[](auto& p) { p.hello.stride_bytes = kWidth - 1; }, "79 bytes apart"},
      {[](auto& p) { p.hello.format = 2; }, "160 bytes"},
      {[](auto& p) { p.hello.format = 3; }, "format 3"},
      {[](auto& p) { p.hello.shutter = 2; }, "shutter 2"},
      {[](auto& p) { p.hello.slot_count = 0; }, "0 slots"},
      {[](auto& p) { p.hello.slot_count = kSlots + 1; }, "12288 bytes and the slots need 16384"},
      {[](auto& p) { p.hello.slot_bytes = kStride * kHeight - 1; }, "does not fit"},
      {[](auto& p) { p.hello.slot_bytes = UINT32_MAX; }, "the slots need 12884901885"},
      {[](auto& p) { p.hello.frame_period_ns = 0; }, "frame period is 0"},
      {[](auto& p) { std::memset(p.hello.identity, 'x', sizeof p.hello.identity); }, "no end"},
      {[](auto& p) { p.hello_size = 40; }, "40 bytes"},
      {[](auto& p) { p.hello_size = 4; }, "only 4 bytes"},
      {[](auto& p) { p.send_memory = false; }, "without the frames' memory"},
      {[](auto& p) { p.seal = false; }, "not sealed"},
      {[](auto& p) { p.memory_bytes = 4096; }, "4096 bytes and the slots need 12288"},
  };
  for (const Lie& lie : lies) {
    FakeServer::Plan plan;
    plan.answer = steady;
    lie.change(plan);
    FakeServer server(plan);
    const auto source = open_sim_source(server.folder());
    ASSERT_FALSE(source) << lie.what;
    EXPECT_EQ(source.error().kind, Kind::protocol);
    EXPECT_THAT(source.error().message, HasSubstr(lie.what));
  }
}

TEST(SimSource, a_folder_without_a_scanner_is_named) {
  const auto source = open_frame_source("sim:/no/such/folder");
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().kind, Kind::not_found);
  EXPECT_THAT(source.error().message, AllOf(HasSubstr("/no/such/folder/frames.sock"), HasSubstr("start celadon-sim")));
  EXPECT_THAT(open_frame_source("sim:/" + std::string(200, 'x')).error().message, HasSubstr("107 characters"));
}

}  // namespace
}  // namespace celadon
