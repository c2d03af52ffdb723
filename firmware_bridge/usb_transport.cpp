#include "firmware_bridge/usb_transport.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "firmware_bridge/clock.h"
#include "firmware_bridge/usb_controller.h"
#include "firmware_bridge/usb_protocol.h"
#include "firmware_bridge/usb_stream.h"
#include "firmware_bridge/usb_trace.h"

namespace celadon {
namespace {

using Kind = DeviceError::Kind;
namespace usb = protocol::usb;
namespace reg = protocol::reg;

constexpr int kArrivalShare = 5;    // of the time-out: a lost link is tried several times
constexpr int kTraceTransfers = 2;  // one is filled while the other is handled

class UsbTransport final : public Transport {
 public:
  UsbTransport(std::string url, UsbPlace place) : url_(std::move(url)), place_(std::move(place)) {}
  ~UsbTransport() override { close(); }

  tl::expected<void, LinkError> read_inputs(std::uint16_t address, std::span<std::uint16_t> registers) override {
    return read(usb::Request::read_input, address, registers);
  }
  tl::expected<void, LinkError> read_holding(std::uint16_t address, std::span<std::uint16_t> registers) override {
    return read(usb::Request::read_holding, address, registers);
  }
  tl::expected<void, LinkError> write_holding(std::uint16_t address,
                                              std::span<const std::uint16_t> registers) override {
    if (auto fits = check_count(registers.size()); !fits) return fits;
    for (std::size_t i = 0; i < registers.size(); ++i) usb::put_word(data() + 2 * i, registers[i]);
    return exchange(usb::kTypeOut, usb::Request::write_holding, address, registers.size());
  }

  tl::expected<void, LinkError> reconnect() override { return connect(place_.timeout_ms / kArrivalShare); }
  /// @param arrival_ms an absent controller is waited for so long
  tl::expected<void, LinkError> connect(int arrival_ms) {
    close();
    auto opened = open_usb_controller(place_, arrival_ms);
    if (!opened) {
      LinkError error = std::move(opened.error());
      if (error.kind == Kind::not_found && connections_ > 0) {
        error = usb_link_error(LIBUSB_ERROR_NO_DEVICE);
        error.cause += " and is not back";
      }
      return tl::unexpected(std::move(error));
    }
    ++connections_;
    controller_ = std::move(*opened);
    if (controller_.event_endpoint != 0 && controller_.event_bytes >= usb::kEventBytes) {
      events_.emplace(controller_.handle.get(), controller_.event_endpoint, true, controller_.event_bytes, 1,
                      [this](std::span<const std::uint8_t> bytes) { event_came_ |= bytes.size() >= usb::kEventBytes; });
    }
    event_came_ = true;  // whatever happened while nobody listened
    if (wants_trace_) start_trace();
    pump(0, nullptr);
    return {};
  }

  const std::string& url() const override { return url_; }
  std::uint64_t connections() const override { return connections_; }
  bool has_events() const override { return events_.has_value(); }

  bool wait_for_event(std::int64_t wait_ns) override {
    const std::int64_t until_ns = clock_.now_ns() + wait_ns;
    do {
      const bool up = pump(event_came_ ? 0 : until_ns - clock_.now_ns(), nullptr);
      if (std::exchange(event_came_, false) || !up) return true;  // also of a link that is down: the next poll tells
    } while (clock_.now_ns() < until_ns);
    return false;
  }

  std::size_t take_trace(std::span<TraceSample> samples) override {
    if (!std::exchange(wants_trace_, true)) start_trace();
    pump(0, nullptr);
    return trace_buffer_.take(samples);
  }

 private:
  std::uint8_t* data() { return control_buffer_.data() + LIBUSB_CONTROL_SETUP_SIZE; }

  static tl::expected<void, LinkError> check_count(std::size_t count) {
    if (count > 0 && count <= usb::kMaxRegisters) return {};
    return tl::unexpected(LinkError{
        Kind::refused, EINVAL,
        "a block of " + std::to_string(count) + " registers is outside 1 to " + std::to_string(usb::kMaxRegisters),
        false});
  }

  tl::expected<void, LinkError> read(usb::Request request, std::uint16_t address, std::span<std::uint16_t> registers) {
    if (auto fits = check_count(registers.size()); !fits) return fits;
    if (auto done = exchange(usb::kTypeIn, request, address, registers.size()); !done) return done;
    for (std::size_t i = 0; i < registers.size(); ++i) registers[i] = usb::get_word(data() + 2 * i);
    return {};
  }

  /// One request with its data in data(); of a STALL the reason is fetched.
  tl::expected<void, LinkError> exchange(std::uint8_t type, usb::Request request, std::uint16_t address,
                                         std::size_t count) {
    if (!controller_.handle) {
      if (auto connected = connect(0); !connected) return connected;
    }
    const auto bytes = static_cast<int>(2 * count);
    int moved = control(type, request, address, bytes);
    if (moved == bytes) return {};
    if (moved >= 0)
      return tl::unexpected(
          LinkError{Kind::broken_reply, moved,
                    "the controller moved " + std::to_string(moved) + " of " + std::to_string(bytes) + " bytes", true});
    LinkError error = usb_link_error(moved);
    if (moved == LIBUSB_ERROR_TIMEOUT)
      error.cause = "no complete reply within " + std::to_string(place_.timeout_ms) + " ms";
    if (moved == LIBUSB_ERROR_PIPE) {
      moved = control(usb::kTypeIn, usb::Request::exception, 0, 2);
      const int code = moved == 2 ? usb::get_word(data()) : 0;
      error = {Kind::refused, code, "the controller refused the request with exception " + std::to_string(code), false};
      if (moved < 0 && moved != LIBUSB_ERROR_PIPE) error = usb_link_error(moved);
    }
    if (error.kind == Kind::lost) close();
    return tl::unexpected(std::move(error));
  }

  struct Control {
    int done = 0, moved = 0;
    libusb_transfer_status status = LIBUSB_TRANSFER_ERROR;
  };
  static void LIBUSB_CALL on_control(libusb_transfer* transfer) {
    auto& control = *static_cast<Control*>(transfer->user_data);
    control.moved = transfer->actual_length;
    control.status = transfer->status;
    control.done = 1;
  }

  /// @returns bytes moved or libusb's code
  int control(std::uint8_t type, usb::Request request, std::uint16_t address, int bytes) {
    const std::unique_ptr<libusb_transfer, void (*)(libusb_transfer*)> transfer(libusb_alloc_transfer(0),
                                                                                libusb_free_transfer);
    if (!transfer) return LIBUSB_ERROR_NO_MEM;
    Control control;
    libusb_fill_control_setup(control_buffer_.data(), type, static_cast<std::uint8_t>(request), address,
                              controller_.interface, static_cast<std::uint16_t>(bytes));
    libusb_fill_control_transfer(transfer.get(), controller_.handle.get(), control_buffer_.data(), on_control, &control,
                                 static_cast<unsigned>(place_.timeout_ms));
    if (const int code = libusb_submit_transfer(transfer.get()); code != 0) return code;
    // libusb's own time-out ends it; the transfer and its buffer are in use until then, whatever goes wrong here.
    while (control.done == 0) pump(kForever_ns, &control.done);
    switch (control.status) {
      case LIBUSB_TRANSFER_COMPLETED:
        return control.moved;
      case LIBUSB_TRANSFER_STALL:
        return LIBUSB_ERROR_PIPE;
      case LIBUSB_TRANSFER_NO_DEVICE:
        return LIBUSB_ERROR_NO_DEVICE;
      case LIBUSB_TRANSFER_TIMED_OUT:
        return LIBUSB_ERROR_TIMEOUT;
      case LIBUSB_TRANSFER_OVERFLOW:
        return LIBUSB_ERROR_OVERFLOW;
      default:
        return LIBUSB_ERROR_IO;
    }
  }

  void start_trace() {
    if (!controller_.handle || controller_.trace_endpoint == 0) return;
    trace_.emplace(controller_.handle.get(), controller_.trace_endpoint, false, controller_.trace_bytes,
                   kTraceTransfers, [this](std::span<const std::uint8_t> bytes) { trace_buffer_.receive(bytes); });
  }

  /// Handles what libusb has, once: returns when something happened, `done` is set or the time is over. @returns false
  /// when there is no controller, or no longer
  bool pump(std::int64_t wait_ns, int* done) {
    if (!controller_.handle) return false;
    bool up = true;
    for (std::optional<UsbStream>* stream : {&events_, &trace_}) {
      if (*stream) up = (*stream)->keep_reading() != LIBUSB_ERROR_NO_DEVICE && up;
    }
    const std::int64_t wait_us = up ? std::clamp<std::int64_t>(wait_ns, 0, kForever_ns) / 1000 : 0;
    timeval wait{wait_us / 1'000'000, wait_us % 1'000'000};
    libusb_handle_events_timeout_completed(controller_.context.get(), &wait, done);
    for (std::optional<UsbStream>* stream : {&events_, &trace_}) {
      if (*stream) up = (*stream)->keep_reading() != LIBUSB_ERROR_NO_DEVICE && up;
    }
    return up;
  }

  void close() {
    for (std::optional<UsbStream>* stream : {&events_, &trace_}) {
      if (!*stream) continue;
      (*stream)->cancel();
      while (!(*stream)->idle()) {
        timeval soon{0, 100'000};
        libusb_handle_events_timeout_completed(controller_.context.get(), &soon, nullptr);
      }
      stream->reset();
    }
    if (controller_.handle) libusb_release_interface(controller_.handle.get(), controller_.interface);
    controller_.handle.reset();
    controller_.context.reset();
    controller_ = {};
  }

  static constexpr std::int64_t kForever_ns = 1'000'000'000;  // a look around once a second

  std::string url_;
  UsbPlace place_;
  MonotonicClock clock_;  // events come in real time
  UsbController controller_;
  std::optional<UsbStream> events_, trace_;
  std::array<std::uint8_t, LIBUSB_CONTROL_SETUP_SIZE + 2 * usb::kMaxRegisters> control_buffer_{};
  UsbTrace trace_buffer_;
  std::uint64_t connections_ = 0;
  bool event_came_ = false, wants_trace_ = false;
};

}  // namespace

tl::expected<std::unique_ptr<Transport>, DeviceError> open_usb_transport(const std::string& url) {
  const auto failed = [&](Kind kind, std::string cause, std::string remedy) {
    return tl::unexpected(
        DeviceError{kind, "connect", url, std::move(cause), "its state unknown and untouched", std::move(remedy)});
  };
  auto place = parse_usb_url(url);
  if (!place) return failed(Kind::refused, place.error(), "write usb:[VID:PID][/SERIAL] or usb:SERIAL");
  auto transport = std::make_unique<UsbTransport>(url, std::move(*place));
  if (auto connected = transport->connect(0); !connected) {
    const LinkError& error = connected.error();
    return failed(error.kind, error.cause, error.kind == Kind::not_found ? "plug it in and switch it on" : "");
  }
  return transport;
}

}  // namespace celadon
