#pragma once
// Checked access to the values of a TOML text: every refusal names file, line, field, value and remedy.

#include <Eigen/Core>
#include <cstdint>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"
#include "acquisition/toml.h"

namespace celadon::checked_toml {

/// Leaves the parser; caught by the readers of files, never seen outside.
struct Refusal {
  std::string message;
};

/// Parses a text of ASCII. toml++ 3 is not defined for hostile bytes beyond it; characters beyond it are written
/// \u00E9.
/// @returns the error as "line 3, column 7: ..." with a remedy
tl::expected<toml::table, std::string> parse_ascii(std::string_view text);

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
  /// @param remedy  for a key that is missing
  Section(const toml::table& table, std::string file, std::string path, bool newer = false,
          const char* remedy = "add it as CALIBRATION.md describes, or calibrate again")
      : table_(&table), file_(std::move(file)), path_(std::move(path)), newer_(newer), remedy_(remedy) {}

  /// @throws Refusal; so do all that follow
  [[noreturn]] void refuse(const toml::node& where, const std::string& field, const std::string& why) const;

  bool has(const std::string& key) const { return table_->contains(key); }
  const toml::node& node(const std::string& key);
  Section section(const std::string& key);
  std::string text(const std::string& key);
  bool boolean(const std::string& key);
  int integer(const std::string& key, int smallest, int largest);
  std::int64_t whole(const std::string& key, std::int64_t smallest, std::int64_t largest);
  double number(const std::string& key);
  /// A number that is not negative.
  double uncertainty(const std::string& key);
  Measured measured(const std::string& key);
  /// A measured value above zero.
  Measured positive(const std::string& key);
  Eigen::Vector3d vector(const std::string& key);
  std::vector<Eigen::Vector3d> vectors(const std::string& key, std::size_t count);
  Eigen::Matrix3d matrix(const std::string& key);
  std::vector<std::string> texts(const std::string& key);
  /// A symmetric matrix from the rows of its lower triangle.
  Eigen::MatrixXd symmetric(const std::string& key, Eigen::Index size);

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
  const char* remedy_;
};

}  // namespace celadon::checked_toml
