#include "sim/server.h"

#include <poll.h>
#include <sys/eventfd.h>

#include <algorithm>
#include <ctime>
#include <nlohmann/json.hpp>

#include "sim/usbip_server.h"

namespace celadon::sim {
namespace {

DeviceConfig on_clock(DeviceConfig device, bool lock_step) {
  if (!lock_step) device.start_ns = monotonic_ns();  // stamps are of the host's clock
  return device;
}

}  // namespace

Server::Server(const ServerOptions& options)
    : options_(options),
      model_(on_clock(options.device, options.lock_step)),
      pacer_(model_, options.lock_step),
      stop_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {}

tl::expected<std::unique_ptr<Server>, std::string> Server::open(const ServerOptions& options) {
  std::unique_ptr<Server> server(new Server(options));
  if (!server->stop_) return tl::unexpected(std::string("eventfd failed"));
  for (const std::string& text : options.faults) {
    const auto order = parse_fault_option(text, server->model_.now_ns());
    if (!order) return tl::unexpected(order.error());
    server->model_.inject(*order);
  }
  const auto plan = parse_fault_plan(options.fault_plan, {server->model_.now_ns(), options.device.seed, 0});
  if (!plan) return tl::unexpected(plan.error());
  for (const FaultOrder& order : *plan) server->model_.inject(order);
  auto store = FrameStore::open(server->model_, options.lock_step);
  if (!store) return tl::unexpected(store.error());
  FrameStore& frame_store = **store;
  server->services_.push_back(*std::move(store));
  if (!options.usbip.empty()) {
    auto usbip = std::make_unique<UsbipServer>(server->model_, server->pacer_, frame_store);
    if (options.usbip == "attach") {
      if (auto attached = usbip->attach(); !attached) return tl::unexpected(attached.error());
      server->usbip_address_ = options.usbip;
    } else {
      auto address = usbip->listen(options.usbip);
      if (!address) return tl::unexpected(address.error());
      server->usbip_address_ = *address;
    }
    server->services_.push_back(std::move(usbip));
  }
  auto modbus = std::make_unique<ModbusServer>(server->model_, server->pacer_);
  if (!options.modbus_tcp.empty()) {
    auto url = modbus->listen_tcp(options.modbus_tcp);
    if (!url) return tl::unexpected(url.error());
    server->modbus_url_ = *url;
  }
  if (options.modbus_rtu) {
    auto url = modbus->open_rtu(options.modbus_rtu_link);
    if (!url) return tl::unexpected(url.error());
    server->modbus_rtu_url_ = *url;
    if (server->modbus_url_.empty()) server->modbus_url_ = *url;
  }
  server->services_.push_back(std::move(modbus));
  if (!options.socket_dir.empty()) {
    std::error_code error;
    std::filesystem::create_directories(options.socket_dir, error);
    if (error)
      return tl::unexpected("making the folder " + options.socket_dir.string() + " failed: " + error.message());
    auto frames = FrameServer::open(options.socket_dir / "frames.sock", server->model_, server->pacer_, frame_store);
    if (!frames) return tl::unexpected(frames.error());
    server->services_.push_back(*std::move(frames));
    auto control =
        ControlSocket::open(options.socket_dir / "control.sock", server->model_, server->pacer_, server->modbus_url_);
    if (!control) return tl::unexpected(control.error());
    server->services_.push_back(*std::move(control));
  }
  return server;
}

std::string Server::ready_line() const {
  nlohmann::json line{
      {"ready", true},
      {"modbus_url", modbus_url_},
      {"socket_dir", options_.socket_dir.empty() ? "" : std::filesystem::absolute(options_.socket_dir).string()},
      {"lock_step", options_.lock_step},
      {"machine", model_.machine()}};
  if (!modbus_rtu_url_.empty()) line["modbus_rtu_url"] = modbus_rtu_url_;
  if (!usbip_address_.empty()) line["usbip"] = usbip_address_;
  return line.dump();
}

// Leases, watchdogs and buttons count milliseconds; frames have their own instants.
std::int64_t Server::poll_timeout_ns() const {
  constexpr std::int64_t kStep_ns = 2'000'000;
  if (pacer_.holds()) return 1'000'000'000;
  return std::clamp<std::int64_t>(pacer_.real_time_until(model_.next_event_ns()), 0, kStep_ns);
}

void Server::run() {
  std::vector<pollfd> polls;
  std::vector<std::size_t> begins;
  while (true) {
    polls.assign(1, {stop_.get(), POLLIN, 0});
    begins.clear();
    for (const auto& service : services_) {
      begins.push_back(polls.size());
      service->collect(polls);
    }
    begins.push_back(polls.size());
    const std::int64_t wait = poll_timeout_ns();
    const timespec timeout{wait / 1'000'000'000, wait % 1'000'000'000};
    const int ready = ppoll(polls.data(), polls.size(), &timeout, nullptr);
    if (ready < 0) {
      for (pollfd& p : polls) p.revents = 0;
    }
    if (polls[0].revents != 0) return;
    pacer_.catch_up();
    for (std::size_t i = 0; i < services_.size(); ++i) {
      services_[i]->serve(polls.data() + begins[i], begins[i + 1] - begins[i]);
    }
  }
}

void Server::stop() noexcept {
  const std::uint64_t one = 1;
  (void)!write(stop_.get(), &one, sizeof one);
}

}  // namespace celadon::sim
