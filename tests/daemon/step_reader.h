#pragma once
// A small reader of ISO 10303-21 text, independent of every CAD library: tokens, entities, complex entities, and
// rational B-spline surfaces evaluated by de Boor's algorithm.

#include <Eigen/Core>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace celadon::testing {

struct StepValue {
  enum class Kind { integer, real, string, enumeration, reference, list, typed, omitted, derived };
  Kind kind = Kind::omitted;
  double number = 0;             ///< of integer and real; the id of a reference
  std::string text;              ///< of string (decoded to UTF-8) and enumeration; the type of typed
  std::vector<StepValue> items;  ///< of list; the one value of typed

  /// @throws std::runtime_error if the value is of another kind
  int id() const;
  double real() const;  ///< real only: an integer where a real belongs is an error
  int integer() const;
  bool boolean() const;
  const std::string& string() const;
  const std::vector<StepValue>& list() const;
};

struct StepRecord {
  std::string type;
  std::vector<StepValue> arguments;
};

/// One record for a simple entity, several for a complex one.
struct StepEntity {
  std::vector<StepRecord> records;
  /// @throws std::runtime_error if it has no such record
  const StepRecord& record(const std::string& type) const;
  bool is(const std::string& type) const;
};

struct StepFile {
  std::map<std::string, StepRecord> header;
  std::map<int, StepEntity> entities;

  /// @throws std::runtime_error with the offset of what is wrong; references that lead nowhere are wrong too
  static StepFile parse(std::string_view text);
  static StepFile read(const std::string& path);

  const StepEntity& at(int id) const;
  std::vector<int> all(const std::string& type) const;
  /// The only one of its type. @throws std::runtime_error
  int only(const std::string& type) const;
  Eigen::Vector3d triple(int id) const;  ///< of CARTESIAN_POINT, DIRECTION
};

struct StepSurface {
  int degree_u = 0, degree_v = 0;
  std::vector<double> knots_u, knots_v;  ///< with their multiplicities written out
  int count_u = 0, count_v = 0;
  std::vector<Eigen::Vector4d> points;  ///< (x, y, z, weight), index i * count_v + j

  static StepSurface of(const StepFile& file, int id);
  Eigen::Vector3d evaluate(double u, double v) const;
};

struct StepCurve {
  int degree = 0;
  std::vector<double> knots;
  std::vector<Eigen::Vector4d> points;

  static StepCurve of(const StepFile& file, int id);
  Eigen::Vector3d evaluate(double t) const;
};

}  // namespace celadon::testing
