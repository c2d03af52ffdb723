#pragma once
// Dark paint on the object: a surface whose reflectance differs by angle or by height.

#include <Eigen/Core>
#include <cstdint>
#include <string>

#include <tl/expected.hpp>

namespace celadon::sim {

/// Where the object is painted, and how bright the paint is: laser and room light there are so much weaker.
struct Paint {
  enum class Where : std::uint8_t {
    nowhere,
    third,  ///< of the turn: psi from 0 to 120 degrees of the object frame
    bands   ///< around it: z from 12 to 24 mm, 36 to 48 mm ...
  };
  static constexpr double kBand_mm = 12, kEdge_mm = 1;  ///< over which paint and bare surface merge

  Where where = Where::nowhere;
  double albedo = 1;  ///< of the bare surface: 1

  /// "none", "third:ALBEDO" or "bands:ALBEDO", 0.001 to 1. The error is a sentence.
  static tl::expected<Paint, std::string> parse(const std::string& text);
  /// At a point of the object frame.
  double albedo_at(const Eigen::Vector3d& p_O) const;
  /// It looks the same from all sides.
  bool of_revolution() const { return where != Where::third; }
};
std::string to_string(const Paint& paint);

}  // namespace celadon::sim
