#include "daemon/checks/reference.h"

#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <string_view>

namespace celadon {
namespace {

constexpr const char* kForm = "; write cylinder:D=100,u=0.005 or sphere:D=50,U=0.008 (u: standard, U: expanded, k = 2)";

std::optional<double> number_from(std::string_view text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

struct FieldRange {
  double low, high;
  const char* words;
};
const std::map<std::string, FieldRange, std::less<>>& fields() {
  static const std::map<std::string, FieldRange, std::less<>> known = {
      {"D", {1, 1000, "a diameter of 1 to 1000 mm"}},
      {"u", {0, 10, "a standard uncertainty of 0 to 10 mm"}},
      {"U", {0, 10, "an expanded uncertainty of 0 to 10 mm"}},
      {"form", {0, 10, "a deviation of 0 to 10 mm"}},
      {"a", {0, 1e-3, "a coefficient of 0 to 0.001 per kelvin"}},
      {"T", {-20, 100, "a temperature of -20 to 100 degrees Celsius"}},
      {"uT", {0, 50, "a standard uncertainty of 0 to 50 K"}},
  };
  return known;
}

}  // namespace

const char* to_string(ReferenceShape shape) {
  return shape == ReferenceShape::sphere ? "sphere" : "cylinder";
}

double Reference::u_then_mm() const {
  return std::hypot(u_mm, diameter_mm * expansion_per_K * temperature_u_K);
}

tl::expected<Reference, std::string> parse_reference(const std::string& text) {
  const auto refused = [&](const std::string& why) {
    return tl::make_unexpected("the reference '" + text + "' " + why + kForm);
  };
  const auto colon = text.find(':');
  const std::string shape = text.substr(0, colon);
  Reference reference;
  if (shape == "sphere") {
    reference.shape = ReferenceShape::sphere;
  } else if (shape != "cylinder") {
    return refused("is neither a cylinder nor a sphere");
  }
  std::map<std::string, double> given;
  for (std::size_t at = colon; at != std::string::npos && at < text.size();) {
    const std::size_t next = text.find(',', at + 1);
    const std::string field = text.substr(at + 1, next == std::string::npos ? next : next - at - 1);
    at = next;
    const auto equals = field.find('=');
    const auto known = fields().find(std::string_view(field).substr(0, equals));
    if (equals == std::string::npos || known == fields().end())
      return refused("has '" + field + "', which is none of D=, u=, U=, form=, a=, T= and uT=");
    const auto value = number_from(std::string_view(field).substr(equals + 1));
    const FieldRange& range = known->second;
    if (!value || *value < range.low || *value > range.high) return refused("has '" + field + "', not " + range.words);
    if (!given.emplace(known->first, *value).second) return refused("has " + known->first + " twice");
  }
  if (!given.contains("D")) return refused("has no diameter");
  if (given.contains("u") == given.contains("U")) return refused("needs its uncertainty once, standard or expanded");
  if (!given.contains("a") && (given.contains("T") || given.contains("uT")))
    return refused("has a temperature without its coefficient a");
  const auto or_else = [&](const char* name, double otherwise) {
    const auto found = given.find(name);
    return found == given.end() ? otherwise : found->second;
  };
  reference.diameter_mm = given["D"];
  reference.u_mm = given.contains("u") ? given["u"] : given["U"] / 2;
  reference.form_mm = or_else("form", 0);
  reference.expansion_per_K = or_else("a", 0);
  reference.temperature_C = or_else("T", 20);
  reference.temperature_u_K = or_else("uT", 0);
  return reference;
}

}  // namespace celadon
