#include "daemon/export/step_characters.h"

#include <charconv>
#include <cstdint>

namespace celadon {
namespace {

/// One code point off the front; U+FFFD for bytes that are not UTF-8.
char32_t take_code_point(std::string_view& utf8) {
  const auto lead = static_cast<unsigned char>(utf8.front());
  const std::size_t length = lead < 0x80                   ? 1
                             : lead >= 0xF0 && lead < 0xF8 ? 4
                             : lead >= 0xE0                ? 3
                             : lead >= 0xC2                ? 2
                                                           : 0;
  if (length == 0 || length > utf8.size() || lead >= 0xF8) {
    utf8.remove_prefix(1);
    return 0xFFFD;
  }
  char32_t code = length == 1 ? lead : lead & (0xFFU >> (length + 1));
  for (std::size_t i = 1; i < length; ++i) {
    const auto byte = static_cast<unsigned char>(utf8[i]);
    if ((byte & 0xC0U) != 0x80U) {
      utf8.remove_prefix(1);
      return 0xFFFD;
    }
    code = (code << 6U) | (byte & 0x3FU);
  }
  utf8.remove_prefix(length);
  return code;
}

void append_hexadecimal(std::string& text, std::uint32_t value, int digits) {
  for (int shift = 4 * (digits - 1); shift >= 0; shift -= 4) {
    text += "0123456789ABCDEF"[(value >> static_cast<unsigned>(shift)) & 0xFU];
  }
}

bool starts_number(char c) {
  return (c >= '0' && c <= '9') || c == '-' || c == '+';
}
bool continues_number(char c) {
  return starts_number(c) || c == '.' || c == 'E' || c == 'e';
}

/// @param token digits that may be an integer, which stays as it is
void append_real(std::string& text, std::string_view token) {
  double value = 0;
  const std::string_view digits = token.front() == '+' ? token.substr(1) : token;
  const auto parsed = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (token.find('.') == std::string_view::npos || parsed.ec != std::errc() ||
      parsed.ptr != digits.data() + digits.size()) {
    text += token;
    return;
  }
  char buffer[40];
  const auto shortest = std::to_chars(buffer, buffer + sizeof buffer, value == 0 ? 0.0 : value);
  std::string_view written(buffer, static_cast<std::size_t>(shortest.ptr - buffer));
  const std::size_t exponent = written.find('e');
  const std::string_view mantissa = written.substr(0, exponent);
  text += mantissa;
  if (mantissa.find('.') == std::string_view::npos) {
    text += '.';
  }
  if (exponent != std::string_view::npos) {
    text += 'E';
    text += written.substr(exponent + 1);
  }
}

}  // namespace

std::string step_string(std::string_view utf8) {
  std::string text;
  while (!utf8.empty()) {
    const char32_t code = take_code_point(utf8);
    if (code == U'\'' || code == U'\\') {
      text.append(2, static_cast<char>(code));
    } else if (code >= 0x20 && code < 0x7F) {
      text += static_cast<char>(code);
    } else if (code <= 0xFFFF) {
      text += "\\X2\\";
      append_hexadecimal(text, code, 4);
      text += "\\X0\\";
    } else {
      text += "\\X4\\";
      append_hexadecimal(text, code, 8);
      text += "\\X0\\";
    }
  }
  return text;
}

std::string with_shortest_reals(std::string_view data, std::string_view marker, std::string_view replacement) {
  std::string text;
  text.reserve(data.size());
  bool in_string = false;
  for (std::size_t i = 0; i < data.size();) {
    const char c = data[i];
    if (in_string && !marker.empty() && data.substr(i, marker.size()) == marker) {
      text += replacement;
      i += marker.size();
      continue;
    }
    const char before = i == 0 ? '\n' : data[i - 1];
    const bool at_number = !in_string && starts_number(c) &&
                           (before == '(' || before == ',' || before == ' ' || before == '\n' || before == '=');
    if (!at_number) {
      in_string = in_string != (c == '\'');
      text += c;
      ++i;
      continue;
    }
    std::size_t end = i + 1;
    while (end < data.size() && continues_number(data[end])) {
      ++end;
    }
    append_real(text, data.substr(i, end - i));
    i = end;
  }
  return text;
}

}  // namespace celadon
