#pragma once
// Checked access to the values of a TOML text: every refusal names file, line, field, value and remedy.

#include <Eigen/Core>
#include <set>
#include <string>
#include <string_view>

#include "acquisition/calibration.h"
#include "acquisition/toml.h"

namespace celadon::checked_toml {

/// Leaves the parser; caught in parse_calibration, never seen outside.
struct Refusal {
  std::string message;
};

/// Shortest decimals that read back as the same double, always with a mark of a TOML float.
std::string number_text(double value);
/// A TOML basic string.
std::string quoted(const std::string& text);
/// The part of a text that an error message can quote.
std::string excerpt(std::string_view text);
/// A value, or what it is, for an error message.
std::string value_text(const toml::node& node);

/// One table of the file: hands out checked values, knows where it is for messages, and which keys were asked for.
class Section {
 public:
  Section(const toml::table& table, std::string file, std::string path, bool newer = false)
      : table_(&table), file_(std::move(file)), path_(std::move(path)), newer_(newer) {}

  /// @throws Refusal; so do all that follow
  [[noreturn]] void refuse(const toml::node& where, const std::string& field, const std::string& why) const;

  const toml::node& node(const std::string& key);
  Section section(const std::string& key);
  std::string text(const std::string& key);
  bool boolean(const std::string& key);
  int integer(const std::string& key, int smallest, int largest);
  double number(const std::string& key);
  /// A number that is not negative.
  double uncertainty(const std::string& key);
  Measured measured(const std::string& key);
  /// A measured value above zero.
  Measured positive(const std::string& key);
  Eigen::Vector3d vector(const std::string& key);
  Eigen::Matrix3d matrix(const std::string& key);

  /// The file is of a newer minor version: keys that nobody asks for are passed over, here and in its sections.
  void set_newer(bool newer) { newer_ = newer; }
  /// Refuses keys that nobody asked for.
  void finish() const;

 private:
  std::string full(const std::string& field) const { return path_.empty() ? field : path_ + "." + field; }
  double number_of(const toml::node& found, const std::string& field) const;
  Eigen::Vector3d vector_of(const toml::node& found, const std::string& field) const;

  const toml::table* table_;
  std::string file_, path_;
  std::set<std::string> used_;
  bool newer_ = false;
};

}  // namespace celadon::checked_toml
