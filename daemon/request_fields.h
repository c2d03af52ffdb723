#pragma once
// Checked fields of what clients ask for in JSON: a refusal names the field, its value and what to give instead.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>

#include <nlohmann/json.hpp>

namespace celadon::request_fields {

/// Thrown for a request that is not taken: one sentence with value and remedy.
struct Refusal {
  std::string detail;
};

inline std::string short_dump(const nlohmann::json& value) {
  std::string text = value.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
  if (text.size() > 60) text = text.substr(0, 57) + "...";
  return text;
}

[[noreturn]] inline void refuse(const std::string& field, const nlohmann::json& value, const std::string& allowed) {
  throw Refusal{field + " is " + short_dump(value) + "; give " + allowed + "."};
}

inline std::string text_field(const std::string& field, const nlohmann::json& value, const std::string& allowed) {
  if (!value.is_string()) refuse(field, value, allowed);
  return value.get<std::string>();
}

template <std::size_t N>
std::string one_of(const std::string& field, const nlohmann::json& value, const std::array<const char*, N>& names) {
  std::string allowed = "one of";
  for (const char* name : names) allowed += std::string(name == names.front() ? " " : ", ") + name;
  std::string text = text_field(field, value, allowed);
  if (std::find(names.begin(), names.end(), text) == names.end()) refuse(field, value, allowed);
  return text;
}

inline int whole_field(const std::string& field, const nlohmann::json& value, int low, int high) {
  const std::string allowed = "a whole number from " + std::to_string(low) + " to " + std::to_string(high);
  if (!value.is_number_integer()) refuse(field, value, allowed);
  // An unsigned value beyond the signed range would turn negative when read as signed.
  if (value.is_number_unsigned() && value.get<std::uint64_t>() > static_cast<std::uint64_t>(high)) {
    refuse(field, value, allowed);
  }
  const auto number = value.get<std::int64_t>();
  if (number < low || number > high) refuse(field, value, allowed);
  return static_cast<int>(number);
}

inline double number_between(const std::string& field, const nlohmann::json& value, double low, double high,
                             const char* unit) {
  char allowed[80];
  std::snprintf(allowed, sizeof allowed, "a number from %g to %g %s", low, high, unit);
  if (!value.is_number()) refuse(field, value, allowed);
  const auto number = value.get<double>();
  if (!std::isfinite(number) || number < low || number > high) refuse(field, value, allowed);
  return number;
}

/// From 0 on.
inline double number_field(const std::string& field, const nlohmann::json& value, double high, const char* unit) {
  return number_between(field, value, 0, high, unit);
}

}  // namespace celadon::request_fields
