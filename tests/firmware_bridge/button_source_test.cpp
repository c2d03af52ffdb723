// Buttons at the computer through the real libevdev and libgpiod, on mocked input devices and GPIO chips.

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/gpio.h>
#include <linux/input.h>
#include <umockdev.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <deque>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "firmware_bridge/button_source.h"

namespace celadon {
namespace {

using ::testing::HasSubstr;

/// A device node whose system calls this program answers.
class Node {
 public:
  Node(UMockdevTestbed* testbed, const std::string& path, const std::string& description, std::string node)
      : testbed_(testbed), path_("/sys" + path), handler_(umockdev_ioctl_base_new()) {
    GError* error = nullptr;
    if (!umockdev_testbed_add_from_string(testbed_, ("P: " + path + "\n" + description).c_str(), &error))
      throw std::runtime_error(error->message);
    g_signal_connect(handler_, "handle-ioctl", G_CALLBACK(on_ioctl), this);
    g_signal_connect(handler_, "handle-read", G_CALLBACK(on_read), this);
    if (!umockdev_testbed_attach_ioctl(testbed_, node.c_str(), handler_, &error))
      throw std::runtime_error(error->message);
  }
  virtual ~Node() {
    umockdev_testbed_remove_device(testbed_, path_.c_str());
    g_object_unref(handler_);
  }
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

 protected:
  static void answer(UMockdevIoctlClient* client, void* bytes, std::size_t size, long result) {
    UMockdevIoctlData* data = umockdev_ioctl_data_resolve(umockdev_ioctl_client_get_arg(client), 0, size, nullptr);
    umockdev_ioctl_data_update(data, 0, static_cast<guint8*>(bytes), static_cast<gint>(size));
    umockdev_ioctl_data_unref(data);
    umockdev_ioctl_client_complete(client, result, 0);
  }
  virtual void ioctl(UMockdevIoctlClient* client) = 0;
  virtual void read(UMockdevIoctlClient* client) = 0;
  std::mutex mutex_;  // the test's thread against the testbed's

 private:
  static gboolean on_ioctl(UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer self) {
    const std::lock_guard lock(static_cast<Node*>(self)->mutex_);
    static_cast<Node*>(self)->ioctl(client);
    return TRUE;
  }
  static gboolean on_read(UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer self) {
    const std::lock_guard lock(static_cast<Node*>(self)->mutex_);
    static_cast<Node*>(self)->read(client);
    return TRUE;
  }
  UMockdevTestbed* testbed_;
  const std::string path_;
  UMockdevIoctlBase* handler_;
};

/// Nodes stay when their device goes: each device has another number.
std::string next_number() {
  static int last = 9;
  return std::to_string(++last);
}

/// An input device with the keys KEY_A and KEY_PROG1.
class Keys final : public Node {
 public:
  explicit Keys(UMockdevTestbed* testbed, const std::string& number = next_number())
      : Node(testbed, "/devices/virtual/input/input" + number + "/event" + number,
             "N: input/event" + number + "=00\nE: SUBSYSTEM=input\nE: DEVNAME=/dev/input/event" + number +
                 "\nE: MAJOR=13\nE: MINOR=" + number + "\n",
             "/dev/input/event" + number),
        url("evdev:/dev/input/event" + number) {}
  const std::string url;

  void key(unsigned code, int value, std::int64_t time_us) {
    const std::lock_guard lock(mutex_);
    if (value == 1) down_.insert(code);
    if (value == 0) down_.erase(code);
    push(EV_KEY, code, value, time_us);
    push(EV_SYN, SYN_REPORT, 0, time_us);
  }
  void lose_events(std::int64_t time_us) {
    const std::lock_guard lock(mutex_);
    events_.clear();
    push(EV_SYN, SYN_DROPPED, 0, time_us);
    push(EV_SYN, SYN_REPORT, 0, time_us);
  }
  void unplug() {
    const std::lock_guard lock(mutex_);
    gone_ = true;
  }
  void take_by_another() {
    const std::lock_guard lock(mutex_);
    taken_ = true;
  }
  int clock() {
    const std::lock_guard lock(mutex_);
    return clock_;
  }

 private:
  void push(unsigned type, unsigned code, int value, std::int64_t time_us) {
    input_event event{};
    event.input_event_sec = time_us / 1'000'000;
    event.input_event_usec = time_us % 1'000'000;
    event.type = static_cast<__u16>(type);
    event.code = static_cast<__u16>(code);
    event.value = value;
    events_.push_back(event);
  }
  void ioctl(UMockdevIoctlClient* client) override {
    const unsigned long request = umockdev_ioctl_client_get_request(client);
    const std::size_t size = _IOC_SIZE(request);
    const auto number = static_cast<unsigned>(_IOC_NR(request));
    std::vector<std::uint8_t> bytes(size);
    const auto set = [&](unsigned bit) {
      if (bit / 8 < size) bytes[bit / 8] = static_cast<std::uint8_t>(bytes[bit / 8] | 1u << bit % 8);
    };
    const auto text = [&](const char* value) { std::strncpy(reinterpret_cast<char*>(bytes.data()), value, size); };
    if (gone_) return umockdev_ioctl_client_complete(client, -1, ENODEV);
    if (request == EVIOCGRAB) return umockdev_ioctl_client_complete(client, taken_ ? -1 : 0, taken_ ? EBUSY : 0);
    if (number == _IOC_NR(EVIOCSCLOCKID)) {
      UMockdevIoctlData* data =
          umockdev_ioctl_data_resolve(umockdev_ioctl_client_get_arg(client), 0, sizeof clock_, nullptr);
      std::memcpy(&clock_, data->data, sizeof clock_);
      umockdev_ioctl_data_unref(data);
      return umockdev_ioctl_client_complete(client, 0, 0);
    }
    if (number == _IOC_NR(EVIOCGNAME(0))) text("Mocked Keys");
    if (number == _IOC_NR(EVIOCGBIT(0, 0))) {
      set(EV_SYN);
      set(EV_KEY);
    }
    if (number == _IOC_NR(EVIOCGBIT(EV_KEY, 0))) {
      set(KEY_A);
      set(KEY_PROG1);
    }
    if (number == _IOC_NR(EVIOCGKEY(0))) {
      for (const unsigned code : down_) set(code);
    }
    if ((_IOC_DIR(request) & _IOC_READ) == 0) return umockdev_ioctl_client_complete(client, 0, 0);
    answer(client, bytes.data(), size, static_cast<long>(size));
  }
  void read(UMockdevIoctlClient* client) override {
    if (gone_) return umockdev_ioctl_client_complete(client, -1, ENODEV);
    if (events_.empty()) return umockdev_ioctl_client_complete(client, -1, EAGAIN);
    UMockdevIoctlData* data = umockdev_ioctl_client_get_arg(client);
    std::vector<input_event> events(events_.begin(), events_.end());
    events_.clear();
    const std::size_t size = events.size() * sizeof(input_event);
    umockdev_ioctl_data_update(data, 0, reinterpret_cast<guint8*>(events.data()), static_cast<gint>(size));
    umockdev_ioctl_client_complete(client, static_cast<long>(size), 0);
  }
  std::deque<input_event> events_;
  std::set<unsigned> down_;
  bool gone_ = false, taken_ = false;
  int clock_ = -1;
};

/// What the kernel hands out for a line whose edges are asked for.
class Line final : public Node {
 public:
  Line(UMockdevTestbed* testbed, const std::string& number)
      : Node(testbed, "/devices/platform/mock/line" + number,
             "N: line" + number + "=00\nE: SUBSYSTEM=gpio\nE: DEVNAME=/dev/line" + number +
                 "\nE: MAJOR=253\nE: MINOR=" + number + "\n",
             "/dev/line" + number),
        fd(::open(("/dev/line" + number).c_str(), O_RDWR)) {}
  const int fd;  ///< the reader closes it

  void edge(bool rising, std::uint64_t time_ns) {
    const std::lock_guard lock(mutex_);
    gpioevent_data event{};
    event.timestamp = time_ns;
    event.id = rising ? GPIOEVENT_EVENT_RISING_EDGE : GPIOEVENT_EVENT_FALLING_EDGE;
    events_.push_back(event);
  }
  void unplug() {
    const std::lock_guard lock(mutex_);
    gone_ = true;
  }
  void set_level(bool level) {
    const std::lock_guard lock(mutex_);
    level_ = level;
  }

 private:
  void ioctl(UMockdevIoctlClient* client) override {
    if (umockdev_ioctl_client_get_request(client) != GPIOHANDLE_GET_LINE_VALUES_IOCTL)
      return umockdev_ioctl_client_complete(client, -1, EINVAL);
    gpiohandle_data values{};
    values.values[0] = level_ ? 1 : 0;
    answer(client, &values, sizeof values, 0);
  }
  void read(UMockdevIoctlClient* client) override {
    if (gone_) return umockdev_ioctl_client_complete(client, -1, ENODEV);
    if (events_.empty()) return umockdev_ioctl_client_complete(client, -1, EAGAIN);
    const std::size_t size = events_.size() * sizeof(gpioevent_data);
    umockdev_ioctl_data_update(umockdev_ioctl_client_get_arg(client), 0, reinterpret_cast<guint8*>(events_.data()),
                               static_cast<gint>(size));
    events_.clear();
    umockdev_ioctl_client_complete(client, static_cast<long>(size), 0);
  }
  std::vector<gpioevent_data> events_;
  bool gone_ = false, level_ = false;
};

/// A GPIO chip with four lines; the button's is line 2, named START.
class Chip final : public Node {
 public:
  explicit Chip(UMockdevTestbed* testbed, const std::string& chip_number = next_number())
      : Node(testbed, "/devices/platform/mock/gpiochip" + chip_number,
             "N: gpiochip" + chip_number + "=00\nE: SUBSYSTEM=gpio\nE: DEVNAME=/dev/gpiochip" + chip_number +
                 "\nE: MAJOR=254\nE: MINOR=" + chip_number + "\nA: dev=254:" + chip_number + "\\n\n",
             "/dev/gpiochip" + chip_number),
        number(chip_number),
        line(testbed, chip_number) {}
  const std::string number;
  Line line;
  int error = 0;  ///< of the request for edges

  std::uint32_t flags() {
    const std::lock_guard lock(mutex_);
    return flags_;
  }

 private:
  template <class T>
  static T argument(UMockdevIoctlClient* client) {
    T value{};
    UMockdevIoctlData* data =
        umockdev_ioctl_data_resolve(umockdev_ioctl_client_get_arg(client), 0, sizeof value, nullptr);
    std::memcpy(&value, data->data, sizeof value);
    umockdev_ioctl_data_unref(data);
    return value;
  }
  void ioctl(UMockdevIoctlClient* client) override {
    switch (umockdev_ioctl_client_get_request(client)) {
      case GPIO_GET_CHIPINFO_IOCTL: {
        gpiochip_info info{};
        std::strcpy(info.name, ("gpiochip" + number).c_str());
        info.lines = 4;
        return answer(client, &info, sizeof info, 0);
      }
      case GPIO_GET_LINEINFO_IOCTL: {
        auto info = argument<gpioline_info>(client);
        if (info.line_offset == 2) std::strcpy(info.name, "START");
        if (error == EBUSY) {
          info.flags = GPIOLINE_FLAG_KERNEL;
          std::strcpy(info.consumer, "front panel");
        }
        return answer(client, &info, sizeof info, 0);
      }
      case GPIO_GET_LINEEVENT_IOCTL: {
        if (error != 0) return umockdev_ioctl_client_complete(client, -1, error);
        auto request = argument<gpioevent_request>(client);
        if (request.lineoffset != 2 || request.eventflags != GPIOEVENT_REQUEST_BOTH_EDGES)
          return umockdev_ioctl_client_complete(client, -1, EINVAL);
        flags_ = request.handleflags;
        request.fd = line.fd;
        return answer(client, &request, sizeof request, 0);
      }
      default:
        return umockdev_ioctl_client_complete(client, -1, EINVAL);
    }
  }
  void read(UMockdevIoctlClient* client) override { umockdev_ioctl_client_complete(client, -1, EINVAL); }
  std::uint32_t flags_ = 0;
};

class ButtonSourceTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() { testbed_ = umockdev_testbed_new(); }
  static void TearDownTestSuite() { g_clear_object(&testbed_); }
  static UMockdevTestbed* testbed_;
};
UMockdevTestbed* ButtonSourceTest::testbed_ = nullptr;

std::vector<std::pair<bool, std::int64_t>> edges_of(ButtonSource& button) {
  std::vector<ButtonEdge> edges;
  const auto read = button.read(edges);
  EXPECT_TRUE(read) << read.error().message;
  std::vector<std::pair<bool, std::int64_t>> pairs;
  for (const ButtonEdge& edge : edges) pairs.emplace_back(edge.down, edge.time_ns);
  return pairs;
}
using Edges = std::vector<std::pair<bool, std::int64_t>>;

TEST_F(ButtonSourceTest, AKeyTellsItsEdgesByTheKernelsStamps) {
  Keys keys(testbed_);
  auto button = open_button(keys.url + ":KEY_PROG1");
  ASSERT_TRUE(button) << button.error().message;
  EXPECT_EQ(keys.clock(), CLOCK_MONOTONIC);
  EXPECT_FALSE((*button)->down_at_open());
  EXPECT_EQ(edges_of(**button), Edges{});
  keys.key(KEY_PROG1, 1, 5'000'100);
  keys.key(KEY_A, 1, 5'000'200);
  keys.key(KEY_PROG1, 2, 5'250'000);
  keys.key(KEY_PROG1, 0, 5'300'000);
  EXPECT_EQ(edges_of(**button), (Edges{{true, 5'000'100'000}, {false, 5'300'000'000}}));
}

TEST_F(ButtonSourceTest, AnyKeyIsTheButtonWhereNoneIsNamed) {
  Keys keys(testbed_);
  keys.key(KEY_A, 1, 1);
  auto button = open_button(keys.url);
  ASSERT_TRUE(button) << button.error().message;
  EXPECT_TRUE((*button)->down_at_open());
  (void)edges_of(**button);
  keys.key(KEY_PROG1, 1, 100);
  keys.key(KEY_A, 0, 200);
  keys.key(KEY_PROG1, 0, 300);
  EXPECT_EQ(edges_of(**button), (Edges{{false, 300'000}}));
}

TEST_F(ButtonSourceTest, AfterLostEventsTheKeysStateIsTakenAnew) {
  Keys keys(testbed_);
  auto button = open_button(keys.url + ":KEY_A");
  ASSERT_TRUE(button) << button.error().message;
  keys.key(KEY_A, 1, 100);
  keys.lose_events(200);
  const auto edges = edges_of(**button);
  ASSERT_EQ(edges.size(), 1u);
  EXPECT_TRUE(edges.front().first);
}

TEST_F(ButtonSourceTest, DeparturesAndRefusalsOfKeysAreNamed) {
  {
    Keys keys(testbed_);
    auto button = open_button(keys.url);
    ASSERT_TRUE(button) << button.error().message;
    keys.unplug();
    std::vector<ButtonEdge> edges;
    const auto read = (*button)->read(edges);
    ASSERT_FALSE(read);
    EXPECT_EQ(read.error().message, "The button " + keys.url + " cannot be used: it was unplugged; plug it in.");
  }
  Keys keys(testbed_);
  const auto other = open_button(keys.url + ":KEY_B");
  ASSERT_FALSE(other);
  EXPECT_THAT(other.error().message, HasSubstr("\"Mocked Keys\" has no such key"));
  keys.take_by_another();
  const auto taken = open_button(keys.url + ":KEY_A");
  ASSERT_FALSE(taken);
  EXPECT_THAT(taken.error().message, HasSubstr("another program has taken it for itself; end that program."));
}

TEST_F(ButtonSourceTest, ALineTellsItsEdgesByTheKernelsStamps) {
  Chip chip(testbed_);
  auto button = open_button("gpio:gpiochip" + chip.number + ":2");
  ASSERT_TRUE(button) << button.error().message;
  EXPECT_FALSE((*button)->down_at_open());
  EXPECT_NE(chip.flags() & GPIOHANDLE_REQUEST_ACTIVE_LOW, 0u);
  EXPECT_NE(chip.flags() & GPIOHANDLE_REQUEST_BIAS_PULL_UP, 0u);
  EXPECT_EQ(edges_of(**button), Edges{});
  chip.line.edge(true, 5'000'000'100);
  chip.line.edge(false, 6'000'000'200);
  EXPECT_EQ(edges_of(**button), (Edges{{true, 5'000'000'100}, {false, 6'000'000'200}}));
  chip.line.unplug();
  std::vector<ButtonEdge> edges;
  const auto read = (*button)->read(edges);
  ASSERT_FALSE(read);
  EXPECT_THAT(read.error().message, HasSubstr("its chip is gone (No such device); plug it in."));
}

TEST_F(ButtonSourceTest, ALineIsFoundByNameAndMayBeActiveHigh) {
  Chip chip(testbed_);
  chip.line.set_level(true);
  auto button = open_button("gpio:/dev/gpiochip" + chip.number + ":START?active=high");
  ASSERT_TRUE(button) << button.error().message;
  EXPECT_TRUE((*button)->down_at_open());
  EXPECT_EQ(chip.flags() & GPIOHANDLE_REQUEST_ACTIVE_LOW, 0u);
  EXPECT_NE(chip.flags() & GPIOHANDLE_REQUEST_BIAS_PULL_DOWN, 0u);
}

TEST_F(ButtonSourceTest, RefusalsOfLinesAreNamed) {
  Chip chip(testbed_);
  for (const std::string& url : {"gpio:" + chip.number + ":4", "gpio:" + chip.number + ":STOP"}) {
    const auto button = open_button(url);
    ASSERT_FALSE(button);
    EXPECT_THAT(button.error().message, HasSubstr("among its 4; gpioinfo lists the lines."));
  }
  chip.error = EBUSY;
  const auto busy = open_button("gpio:" + chip.number + ":2");
  ASSERT_FALSE(busy);
  EXPECT_THAT(busy.error().message, HasSubstr("the line is used by front panel; free it, or name another line."));
  chip.error = ENXIO;
  const auto deaf = open_button("gpio:" + chip.number + ":2");
  ASSERT_FALSE(deaf);
  EXPECT_THAT(deaf.error().message, HasSubstr("the line tells no edges (No such device or address)"));
}

}  // namespace
}  // namespace celadon
