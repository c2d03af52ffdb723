#pragma once
// Paint on the object: a surface whose reflectance differs by angle or by height, or whose colour does.

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>

#include <tl/expected.hpp>

namespace celadon::sim {

/// Where the object is painted, and how bright the paint is: laser and room light there are so much weaker.
struct Paint {
  enum class Where : std::uint8_t {
    nowhere,
    third,   ///< of the turn: psi from 0 to 120 degrees of the object frame
    bands,   ///< around it: z from 12 to 24 mm, 36 to 48 mm ...
    sectors  ///< all of it: red from 0 to 120 degrees of psi, green to 240, blue to 360
  };
  static constexpr double kBand_mm = 12, kEdge_mm = 1;  ///< over which paint and bare surface merge

  Where where = Where::nowhere;
  double albedo = 1;  ///< of the bare surface: 1

  /// Of sectors: shares of red, green and blue light that come back. No paint swallows the laser's red altogether.
  static const std::array<Eigen::Array3d, 3> kSectors;

  /// "none", "third:ALBEDO", "bands:ALBEDO", 0.001 to 1, or "sectors". The error is a sentence.
  static tl::expected<Paint, std::string> parse(const std::string& text);
  /// At a point of the object frame, of red light: the laser's.
  double albedo_at(const Eigen::Vector3d& p_O) const;
  bool coloured() const { return where == Where::sectors; }
  /// Of red, green and blue light. @pre coloured()
  static Eigen::Array3d reflectance_at(const Eigen::Vector3d& p_O);
  /// It looks the same from all sides.
  bool of_revolution() const { return where != Where::third && where != Where::sectors; }
};
std::string to_string(const Paint& paint);

}  // namespace celadon::sim
