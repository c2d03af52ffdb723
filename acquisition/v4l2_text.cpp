#include "acquisition/v4l2_text.h"

#include <algorithm>
#include <fstream>

namespace celadon {

std::string printable(const std::uint8_t* text, std::size_t size) {
  std::string out;
  for (std::size_t i = 0; i < size && text[i] != 0; ++i) out += text[i] >= 0x20 && text[i] < 0x7f ? char(text[i]) : '?';
  return out;
}

std::string usb_serial_at(const std::filesystem::path& node) {
  std::error_code error;
  const std::filesystem::path device = std::filesystem::canonical(node / "device", error);
  if (error) return "";
  std::string serial;
  std::ifstream(device.parent_path() / "serial") >> serial;
  return printable(reinterpret_cast<const std::uint8_t*>(serial.data()), std::min<std::size_t>(serial.size(), 64));
}

std::string usb_serial_of(const std::string& path) {
  std::error_code error;
  const std::filesystem::path node = std::filesystem::canonical(path, error).filename();
  return error ? "" : usb_serial_at("/sys/class/video4linux" / node);
}

}  // namespace celadon
