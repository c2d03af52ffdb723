#include "tests/firmware_bridge/modbus_machine.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <pty.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <cstring>
#include <stdexcept>

namespace celadon::test {

using protocol::Exception;

Machine::Machine(const ControllerConfig& config) : config_(config) {
  core_ = std::make_unique<ControllerCore>(config_, plant_, boot_id_, now_us_);
}

void Machine::advance_locked(std::uint64_t time_us) {
  while (now_us_ < time_us) {
    std::uint64_t next = std::min(time_us, now_us_ + 10'000);
    if (core_->next_deadline_us() > now_us_) next = std::min(next, core_->next_deadline_us());
    now_us_ = next;
    core_->step(now_us_);
  }
}

void Machine::advance_to_us(std::uint64_t time_us) {
  const std::lock_guard lock(mutex_);
  advance_locked(time_us);
}

std::uint64_t Machine::now_us() {
  const std::lock_guard lock(mutex_);
  return now_us_;
}

void Machine::restart() {
  const std::lock_guard lock(mutex_);
  plant_ = TestPlant();
  now_us_ = 0;
  core_ = std::make_unique<ControllerCore>(config_, plant_, ++boot_id_, now_us_);
}

void Machine::press_button(std::uint64_t held_ms) {
  with([](TestPlant& p, ControllerCore&) { p.button = true; });
  advance_ms(held_ms);
  with([](TestPlant& p, ControllerCore&) { p.button = false; });
  advance_ms(100);
}

Exception Machine::read(protocol::Area area, std::uint16_t address, std::uint16_t count, std::uint16_t* words) {
  const std::lock_guard lock(mutex_);
  ++reads;
  advance_locked(now_us_ + kRequest_us);
  return area == protocol::Area::input ? core_->read_input(now_us_, address, count, words)
                                       : core_->read_holding(now_us_, address, count, words);
}

Exception Machine::write(std::uint16_t address, std::uint16_t count, const std::uint16_t* words) {
  const std::lock_guard lock(mutex_);
  ++writes;
  advance_locked(now_us_ + kRequest_us);
  plant_.inside_write = true;
  const Exception result = core_->write_holding(now_us_, address, count, words);
  plant_.inside_write = false;
  return result;
}

ModbusServer::ModbusServer(Registers& registers, Link link, int unit)
    : registers_(registers), link_(link), unit_(unit) {
  start();
}

ModbusServer::~ModbusServer() {
  stop();
}

std::string ModbusServer::url(const std::string& options) const {
  return link_ == Link::tcp ? "modbus-tcp://127.0.0.1:" + std::to_string(port_) + "?" + options
                            : "modbus-rtu:" + pty_path_ + "?" + options;
}

void ModbusServer::mishap(Mishap m, int times) {
  const std::lock_guard lock(mutex_);
  for (int i = 0; i < times; ++i) mishaps_.push_back(m);
}

void ModbusServer::release_withheld() {
  const std::lock_guard lock(mutex_);
  if (write(pty_master_, withheld_.data(), withheld_.size()) < 0) throw std::runtime_error(std::strerror(errno));
  withheld_.clear();
}

Mishap ModbusServer::next_mishap() {
  const std::lock_guard lock(mutex_);
  if (mishaps_.empty()) return Mishap::none;
  const Mishap m = mishaps_.front();
  mishaps_.pop_front();
  return m;
}

void ModbusServer::start() {
  if (link_ == Link::tcp) {
    listener_ = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const int on = 1;
    setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(static_cast<std::uint16_t>(port_));
    socklen_t size = sizeof address;
    if (bind(listener_, reinterpret_cast<sockaddr*>(&address), size) != 0 || listen(listener_, 4) != 0)
      throw std::runtime_error(std::strerror(errno));
    getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
  } else {
    char path[128];
    termios raw{};
    cfmakeraw(&raw);
    if (openpty(&pty_master_, &pty_slave_, path, &raw, nullptr) != 0) throw std::runtime_error(std::strerror(errno));
    pty_path_ = path;
  }
  running_ = true;
  thread_ = std::thread([this] { run(); });
}

void ModbusServer::stop() {
  if (!thread_.joinable()) return;
  running_ = false;
  thread_.join();
  for (int* fd : {&listener_, &pty_master_, &pty_slave_}) {
    if (*fd >= 0) close(*fd);
    *fd = -1;
  }
}

void ModbusServer::run() {
  modbus_mapping_t* mapping = modbus_mapping_new(0, 0, 0x10000, 0x10000);
  while (running_) {
    int fd = pty_master_;
    if (link_ == Link::tcp) {
      pollfd waiting{listener_, POLLIN, 0};
      if (poll(&waiting, 1, 20) <= 0) continue;
      fd = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
      if (fd < 0) continue;
    }
    modbus_t* context =
        link_ == Link::tcp ? modbus_new_tcp("127.0.0.1", port_) : modbus_new_rtu(pty_path_.c_str(), 115200, 'E', 8, 1);
    modbus_set_slave(context, link_ == Link::tcp ? MODBUS_TCP_SLAVE : unit_);
    modbus_set_socket(context, fd);
    modbus_set_indication_timeout(context, 0, 20'000);
    bool connected = true;
    while (running_ && connected) {
      connected = serve_one(context, mapping) || link_ == Link::rtu;
      pollfd newer{listener_, POLLIN, 0};  // as gateways with one connection do: the newer client gets it
      if (link_ == Link::tcp && poll(&newer, 1, 0) > 0) connected = false;
    }
    if (link_ == Link::tcp) close(fd);
    modbus_free(context);
  }
  modbus_mapping_free(mapping);
}

// False ends the connection.
bool ModbusServer::serve_one(modbus_t* context, modbus_mapping_t* mapping) {
  std::uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
  const int length = modbus_receive(context, query);
  if (length < 0) return errno == ETIMEDOUT || errno >= MODBUS_ENOBASE;
  if (length == 0) return true;  // for another unit
  const Mishap m = next_mishap();
  if (m == Mishap::ignore) return true;
  if (m == Mishap::busy) return modbus_reply_exception(context, query, MODBUS_EXCEPTION_SLAVE_OR_SERVER_BUSY) > 0;
  if (m == Mishap::bad_crc) return modbus_reply_exception(context, query, 8) > 0;
  if (m == Mishap::none) return reply(context, query, length, mapping);

  // The proper reply goes into a pipe of its own and is spoiled on the way.
  int spoiled[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, spoiled) != 0) return false;
  const int fd = modbus_get_socket(context);
  modbus_set_socket(context, spoiled[0]);
  reply(context, query, length, mapping);
  modbus_set_socket(context, fd);
  std::uint8_t bytes[MODBUS_TCP_MAX_ADU_LENGTH];
  ssize_t count = recv(spoiled[1], bytes, sizeof bytes, MSG_DONTWAIT);
  close(spoiled[0]);
  close(spoiled[1]);
  if (m == Mishap::close_link) return false;
  if (m == Mishap::drop || count <= 0) return true;
  if (m == Mishap::withhold) {
    const std::lock_guard lock(mutex_);
    withheld_.insert(withheld_.end(), bytes, bytes + count);
    return true;
  }
  if (m == Mishap::truncate) count /= 2;
  if (m == Mishap::garble && link_ == Link::tcp) bytes[1] ^= 0x55;
  if (m == Mishap::garble && link_ == Link::rtu) bytes[count - 1] ^= 0x55;
  const int header = modbus_get_header_length(context);
  if (m == Mishap::wrong_count && link_ == Link::tcp && count > header + 4) {  // two registers less, lengths consistent
    count -= 4;
    bytes[5] = static_cast<std::uint8_t>(bytes[5] - 4);
    bytes[header + 1] = static_cast<std::uint8_t>(bytes[header + 1] - 4);
  }
  return write(fd, bytes, static_cast<std::size_t>(count)) == count;
}

bool ModbusServer::reply(modbus_t* context, const std::uint8_t* query, int length, modbus_mapping_t* mapping) {
  const int header = modbus_get_header_length(context);
  const auto word = [&](int at) {
    return static_cast<std::uint16_t>(query[header + at] << 8 | query[header + at + 1]);
  };
  const int function = query[header];
  const std::uint16_t address = word(1);
  Exception result = Exception::illegal_function;
  if (function == MODBUS_FC_READ_INPUT_REGISTERS || function == MODBUS_FC_READ_HOLDING_REGISTERS) {
    const bool input = function == MODBUS_FC_READ_INPUT_REGISTERS;
    std::uint16_t words[125];
    result = registers_.read(input ? protocol::Area::input : protocol::Area::holding, address, word(3), words);
    if (result == Exception::none)
      std::memcpy((input ? mapping->tab_input_registers : mapping->tab_registers) + address, words, word(3) * 2u);
  } else if (function == MODBUS_FC_WRITE_MULTIPLE_REGISTERS) {
    std::uint16_t words[123];
    const std::uint16_t count = std::min<std::uint16_t>(word(3), 123);
    for (int i = 0; i < count; ++i) words[i] = word(6 + 2 * i);
    result = registers_.write(address, count, words);
  } else if (function == MODBUS_FC_WRITE_SINGLE_REGISTER) {
    const std::uint16_t value = word(3);
    result = registers_.write(address, 1, &value);
  }
  if (result != Exception::none) return modbus_reply_exception(context, query, static_cast<unsigned>(result)) > 0;
  return modbus_reply(context, query, length, mapping) > 0;
}

}  // namespace celadon::test
