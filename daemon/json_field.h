#pragma once
// Checked reading of JSON: every access says where it is. Throws JsonProblem; callers make a sentence of it.

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace celadon {

/// What is wrong with a field: one sentence without an end.
struct JsonProblem {
  std::string text;
};

/// A field of a JSON text and where it is.
class JsonField {
 public:
  JsonField(const nlohmann::json& value, std::string place) : value_(value), place_(std::move(place)) {}

  JsonField at(const char* name) const {
    if (!value_.is_object()) fail("is not an object");
    const auto found = value_.find(name);
    if (found == value_.end()) throw JsonProblem{"the field " + path(name) + " is missing"};
    return {*found, path(name)};
  }
  bool has(const char* name) const { return value_.is_object() && value_.contains(name); }
  JsonField at(std::size_t index) const { return {value_[index], place_ + "[" + std::to_string(index) + "]"}; }
  std::size_t size() const {
    if (!value_.is_array()) fail("is not a list");
    return value_.size();
  }
  double number() const {
    if (!value_.is_number()) fail("is not a number");
    const auto x = value_.get<double>();
    if (!std::isfinite(x)) fail("is not finite");
    return x;
  }
  int whole(int low, int high) const {
    if (!value_.is_number_integer()) fail("is not a whole number");
    const auto x = value_.get<std::int64_t>();
    if (x < low || x > high) {
      fail("is " + value_.dump() + ", outside " + std::to_string(low) + " .. " + std::to_string(high));
    }
    return static_cast<int>(x);
  }
  bool boolean() const {
    if (!value_.is_boolean()) fail("is neither true nor false");
    return value_.get<bool>();
  }
  std::string text() const {
    if (!value_.is_string()) fail("is not a text");
    return value_.get<std::string>();
  }
  std::vector<double> numbers() const {
    std::vector<double> out(size());
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = at(i).number();
    return out;
  }
  std::vector<double> numbers(std::size_t count) const {
    if (size() != count) fail("has " + std::to_string(size()) + " numbers instead of " + std::to_string(count));
    return numbers();
  }
  Eigen::Vector3d vector() const {
    const auto v = numbers(3);
    return {v[0], v[1], v[2]};
  }
  /// A right-handed orthonormal frame (to 1e-9): origin, x, y, z.
  Eigen::Isometry3d frame() const {
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    X.translation() = at("origin").vector();
    X.linear().col(0) = at("x").vector();
    X.linear().col(1) = at("y").vector();
    X.linear().col(2) = at("z").vector();
    const Eigen::Matrix3d R = X.linear();
    if ((R.transpose() * R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-9 || R.determinant() < 0)
      fail("is not right-handed and orthonormal");
    return X;
  }
  [[noreturn]] void fail(const std::string& what) const { throw JsonProblem{"the field " + place_ + " " + what}; }

 private:
  std::string path(const char* name) const { return place_.empty() ? name : place_ + "." + name; }
  const nlohmann::json& value_;
  std::string place_;
};

}  // namespace celadon
