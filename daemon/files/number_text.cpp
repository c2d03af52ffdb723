#include "daemon/files/number_text.h"

#include <charconv>
#include <limits>

namespace celadon {
namespace {

bool blank(char c) {
  return c == ' ' || c == '\t';
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && blank(text.front())) {
    text.remove_prefix(1);
  }
  while (!text.empty() && blank(text.back())) {
    text.remove_suffix(1);
  }
  return text;
}

}  // namespace

Separator separator_of(std::string_view line) {
  if (line.find(';') != std::string_view::npos) {
    return Separator::semicolon;
  }
  return line.find(',') != std::string_view::npos ? Separator::comma : Separator::blank;
}

std::optional<std::string_view> take_field(std::string_view& rest, Separator separator) {
  if (separator == Separator::blank) {
    std::size_t start = 0;
    while (start < rest.size() && blank(rest[start])) {
      ++start;
    }
    if (start == rest.size()) {
      rest = {};
      return std::nullopt;
    }
    std::size_t end = start;
    while (end < rest.size() && !blank(rest[end])) {
      ++end;
    }
    const std::string_view field = rest.substr(start, end - start);
    rest.remove_prefix(end);
    return field;
  }
  if (rest.data() == nullptr) {
    return std::nullopt;
  }
  const std::size_t end = rest.find(static_cast<char>(separator));
  const std::string_view field = trimmed(rest.substr(0, end));
  // A line that ends with a separator has an empty last field; a null view marks that none is left.
  rest = end == std::string_view::npos ? std::string_view() : rest.substr(end + 1);
  return field;
}

std::optional<double> parse_number(std::string_view field) {
  if (!field.empty() && field.front() == '+') {
    field.remove_prefix(1);
    if (!field.empty() && field.front() == '-') {
      return std::nullopt;
    }
  }
  double value = 0;
  const char* end = field.data() + field.size();
  const auto [stop, error] = std::from_chars(field.data(), end, value);
  if (error == std::errc::result_out_of_range && stop == end) {
    const bool tiny = field.find("e-") != std::string_view::npos || field.find("E-") != std::string_view::npos;
    return tiny ? 0.0 : std::numeric_limits<double>::infinity();
  }
  if (error == std::errc() && stop == end) {
    return value;
  }
  // 1.#QNAN, -1.#IND, 1.#INF
  if (error == std::errc() && end - stop > 3 && *stop == '#') {
    return std::numeric_limits<double>::quiet_NaN();
  }
  return std::nullopt;
}

std::string in_quotes(std::string_view field) {
  std::string text = "\"";
  for (const char c : field.substr(0, 40)) {
    text += c >= ' ' && c <= '~' ? c : '?';
  }
  return text + (field.size() > 40 ? "...\"" : "\"");
}

}  // namespace celadon
