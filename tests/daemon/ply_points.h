#pragma once
// A reader of its own for binary PLY vertices: each property by its name, whatever the order.

#include <cstdint>
#include <cstring>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace celadon::testing {

/// A column for each property, as numbers. @throws std::runtime_error if the file is no such PLY or its size is wrong
inline std::map<std::string, std::vector<double>> read_ply_points(std::string_view bytes) {
  const std::string_view kEnd = "end_header\n";
  const std::size_t end = bytes.find(kEnd);
  if (!bytes.starts_with("ply\nformat binary_little_endian 1.0\n") || end == std::string_view::npos)
    throw std::runtime_error("no binary PLY");
  std::istringstream header{std::string(bytes.substr(0, end))};
  std::vector<std::pair<std::string, std::string>> properties;  // type, name
  std::size_t count = 0;
  for (std::string line; std::getline(header, line);) {
    std::istringstream words(line);
    std::string word, type, name;
    words >> word >> type >> name;
    if (word == "element" && type == "vertex") count = std::stoul(name);
    if (word == "property") properties.emplace_back(type, name);
  }
  std::map<std::string, std::vector<double>> columns;
  std::string_view rest = bytes.substr(end + kEnd.size());
  for (std::size_t i = 0; i < count; ++i) {
    for (const auto& [type, name] : properties) {
      const std::size_t size = type == "float" ? 4 : type == "uchar" ? 1 : throw std::runtime_error("type " + type);
      if (rest.size() < size) throw std::runtime_error("too short");
      float number = 0;
      if (size == 4) std::memcpy(&number, rest.data(), 4);
      columns[name].push_back(size == 4 ? static_cast<double>(number) : static_cast<std::uint8_t>(rest[0]));
      rest.remove_prefix(size);
    }
  }
  if (!rest.empty()) throw std::runtime_error("too long");
  return columns;
}

}  // namespace celadon::testing
