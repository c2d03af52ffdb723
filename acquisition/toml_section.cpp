#include "acquisition/toml_section.h"

#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <utility>

namespace celadon::checked_toml {

/// Shortest decimals that read back as the same double, always with a mark of a TOML float.
std::string number_text(double value) {
  std::array<char, 32> buffer;
  const auto end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr;
  std::string text(buffer.data(), end);
  if (text.find_first_of(".en") == std::string::npos) text += ".0";
  return text;
}

namespace {

/// The character that begins at a byte of UTF-8, and its length; a broken one is U+FFFD of one byte.
std::pair<std::uint32_t, std::size_t> character_at(std::string_view text, std::size_t at) {
  const auto byte = [&](std::size_t i) { return std::uint32_t{static_cast<unsigned char>(text[i])}; };
  const std::uint32_t first = byte(at);
  if (first < 0x80) return {first, 1};
  const std::size_t length = first >> 5 == 0x6 ? 2 : first >> 4 == 0xE ? 3 : first >> 3 == 0x1E ? 4 : 0;
  constexpr std::pair<std::uint32_t, std::size_t> kBroken{0xFFFD, 1};
  if (length == 0 || text.size() - at < length) return kBroken;
  std::uint32_t code = first & (0x7Fu >> length);
  for (std::size_t i = 1; i < length; ++i) {
    if (byte(at + i) >> 6 != 0x2) return kBroken;
    code = code << 6 | (byte(at + i) & 0x3F);
  }
  constexpr std::array<std::uint32_t, 5> kSmallest = {0, 0, 0x80, 0x800, 0x10000};
  if (code < kSmallest[length] || code > 0x10FFFF || (code >= 0xD800 && code <= 0xDFFF)) return kBroken;
  return {code, length};
}

}  // namespace

std::string quoted(const std::string& text) {
  std::string out(1, '"');
  for (std::size_t at = 0; at < text.size();) {
    const auto [code, length] = character_at(text, at);
    if (code == '"' || code == '\\') {
      out += '\\';
      out += text[at];
    } else if (code < 0x20 || code >= 0x7F) {
      std::array<char, 16> escape;
      std::snprintf(escape.data(), escape.size(), code > 0xFFFF ? "\\U%08X" : "\\u%04X", unsigned{code});
      out += escape.data();
    } else {
      out += text[at];
    }
    at += length;
  }
  return out + '"';
}

tl::expected<toml::table, std::string> parse_ascii(std::string_view text) {
  const auto at = [](auto line, auto column) {
    return "line " + std::to_string(line) + ", column " + std::to_string(column) + ": ";
  };
  std::size_t line = 1, begin = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto byte = static_cast<unsigned char>(text[i]);
    if (byte >= 0x80) {
      std::array<char, 8> hex;
      std::snprintf(hex.data(), hex.size(), "0x%02X", unsigned{byte});
      return tl::unexpected(at(line, i - begin + 1) + "holds the byte " + hex.data() +
                            ", which is not ASCII; write the character as \\u and four hexadecimal digits in a quoted "
                            "text, or leave it out");
    }
    if (byte == '\n') {
      ++line;
      begin = i + 1;
    }
  }
  toml::parse_result parsed = toml::parse(text);
  if (!parsed) {
    const toml::parse_error& cause = parsed.error();
    return tl::unexpected(at(cause.source().begin.line, cause.source().begin.column) + "is not TOML: " +
                          std::string(cause.description()) + "; correct the line or copy the file again");
  }
  return std::move(parsed).table();
}

/// The part of a text that an error message can quote.
std::string excerpt(std::string_view text) {
  return quoted(std::string(text.substr(0, 60))) + (text.size() > 60 ? "..." : "");
}

std::string value_text(const toml::node& node) {
  if (const auto* text = node.as_string()) return excerpt(text->get());
  if (const auto* real = node.as_floating_point()) return number_text(real->get());
  if (const auto* whole = node.as_integer()) return std::to_string(whole->get());
  if (const auto* truth = node.as_boolean()) return truth->get() ? "true" : "false";
  if (node.is_array()) return "an array of " + std::to_string(node.as_array()->size());
  if (node.is_table()) return "a table";
  return "a date or time";
}

void Section::refuse(const toml::node& where, const std::string& field, const std::string& why) const {
  throw Refusal{file_ + ", line " + std::to_string(where.source().begin.line) + ", " + full(field) + ": " + why};
}

const toml::node& Section::node(const std::string& key) {
  used_.insert(key);
  const toml::node* found = table_->get(key);
  if (found == nullptr) {
    refuse(*table_, key, std::string("is missing; ") + remedy_);
  }
  return *found;
}

Section Section::section(const std::string& key) {
  const toml::node& found = node(key);
  if (!found.is_table()) refuse(found, key, "is " + value_text(found) + " and must be a table");
  return {*found.as_table(), file_, full(key), newer_, remedy_};
}

std::string Section::text(const std::string& key) {
  const toml::node& found = node(key);
  if (!found.is_string()) refuse(found, key, "is " + value_text(found) + " and must be a text in quotes");
  if (found.as_string()->get().empty()) refuse(found, key, "is an empty text; name it");
  return found.as_string()->get();
}

bool Section::boolean(const std::string& key) {
  const toml::node& found = node(key);
  if (!found.is_boolean()) refuse(found, key, "is " + value_text(found) + " and must be true or false");
  return found.as_boolean()->get();
}

int Section::integer(const std::string& key, int smallest, int largest) {
  return static_cast<int>(whole(key, smallest, largest));
}

std::int64_t Section::whole(const std::string& key, std::int64_t smallest, std::int64_t largest) {
  const toml::node& found = node(key);
  const auto* value = found.as_integer();
  if (value == nullptr || value->get() < smallest || value->get() > largest) {
    refuse(found, key,
           "is " + value_text(found) + " and must be a whole number from " + std::to_string(smallest) + " to " +
               std::to_string(largest));
  }
  return value->get();
}

double Section::number(const std::string& key) {
  return number_of(node(key), key);
}

double Section::uncertainty(const std::string& key) {
  const double u = number(key);
  if (u < 0) refuse(node(key), key, "is " + number_text(u) + " and a standard uncertainty cannot be negative");
  return u;
}

Measured Section::measured(const std::string& key) {
  Section pair = section(key);
  const Measured out{pair.number("value"), pair.uncertainty("u")};
  pair.finish();
  return out;
}

Measured Section::positive(const std::string& key) {
  const Measured out = measured(key);
  if (out.value <= 0) refuse(node(key), key + ".value", "is " + number_text(out.value) + " and must be above 0");
  return out;
}

Eigen::Vector3d Section::vector(const std::string& key) {
  return vector_of(node(key), key);
}

std::vector<Eigen::Vector3d> Section::vectors(const std::string& key, std::size_t count) {
  const toml::node& found = node(key);
  const auto* rows = found.as_array();
  if (rows == nullptr || rows->size() != count) {
    refuse(found, key, "is " + value_text(found) + " and must be an array of " + std::to_string(count) + " rows");
  }
  std::vector<Eigen::Vector3d> out;
  for (std::size_t i = 0; i < count; ++i) {
    out.push_back(vector_of(*rows->get(i), key + "[" + std::to_string(i) + "]"));
  }
  return out;
}

Eigen::Matrix3d Section::matrix(const std::string& key) {
  const std::vector<Eigen::Vector3d> rows = vectors(key, 3);
  Eigen::Matrix3d out;
  out << rows[0].transpose(), rows[1].transpose(), rows[2].transpose();
  return out;
}

std::vector<std::string> Section::texts(const std::string& key) {
  const toml::node& found = node(key);
  const auto* items = found.as_array();
  if (items == nullptr || items->empty()) {
    refuse(found, key, "is " + value_text(found) + " and must be an array of texts");
  }
  std::vector<std::string> out;
  for (const toml::node& item : *items) {
    const auto* text = item.as_string();
    if (text == nullptr) refuse(item, key, "holds " + value_text(item) + " and must be an array of texts");
    out.push_back(text->get());
  }
  return out;
}

Eigen::MatrixXd Section::symmetric(const std::string& key, Eigen::Index size) {
  const toml::node& found = node(key);
  const auto* rows = found.as_array();
  if (rows == nullptr || static_cast<Eigen::Index>(rows->size()) != size) {
    refuse(found, key, "is " + value_text(found) + " and must be an array of " + std::to_string(size) + " rows");
  }
  Eigen::MatrixXd out(size, size);
  for (Eigen::Index i = 0; i < size; ++i) {
    const toml::node& row = *rows->get(static_cast<std::size_t>(i));
    const std::string field = key + "[" + std::to_string(i) + "]";
    const auto* items = row.as_array();
    if (items == nullptr || static_cast<Eigen::Index>(items->size()) != i + 1) {
      refuse(row, field, "is " + value_text(row) + " and must be an array of " + std::to_string(i + 1) + " numbers");
    }
    for (Eigen::Index j = 0; j <= i; ++j) {
      const auto& item = *items->get(static_cast<std::size_t>(j));
      out(i, j) = out(j, i) = number_of(item, field + "[" + std::to_string(j) + "]");
    }
  }
  return out;
}

void Section::finish() const {
  if (newer_) return;
  for (const auto& [key, value] : *table_) {
    if (!used_.contains(std::string(key.str()))) {
      refuse(value, excerpt(key.str()), "is not a key of this version; correct its spelling or remove it");
    }
  }
}

double Section::number_of(const toml::node& found, const std::string& field) const {
  double value = 0;
  if (const auto* real = found.as_floating_point()) {
    value = real->get();
  } else if (const auto* whole = found.as_integer()) {
    value = static_cast<double>(whole->get());
  } else {
    refuse(found, field, "is " + value_text(found) + " and must be a number");
  }
  if (!std::isfinite(value)) refuse(found, field, "is " + number_text(value) + " and must be finite; correct it");
  return value;
}

Eigen::Vector3d Section::vector_of(const toml::node& found, const std::string& field) const {
  const auto* items = found.as_array();
  if (items == nullptr || items->size() != 3) {
    refuse(found, field, "is " + value_text(found) + " and must be an array of three numbers");
  }
  return {number_of(*items->get(0), field + "[0]"), number_of(*items->get(1), field + "[1]"),
          number_of(*items->get(2), field + "[2]")};
}

}  // namespace celadon::checked_toml
