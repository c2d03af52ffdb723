#pragma once
// An artefact for acceptance tests as its certificate describes it: balls, distances between them, a flat. File
// grammar: ARTEFACT.md.

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "acquisition/calibration.h"

namespace celadon {

struct CertifiedSphere {
  std::string name;
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Zero();  ///< roughly, in the artefact's frame: z up from the table
  Measured diameter;
  double form_mm = 0;  ///< its own deviation from a sphere, peak to valley
};

struct CertifiedSpacing {
  std::size_t first = 0, second = 0;  ///< spheres
  Measured distance;
};

/// A rectangle with horizontal and upright edges.
struct CertifiedFlat {
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::UnitX();  ///< outward, length 1
  double width_mm = 0, height_mm = 0;
  double form_mm = 0;  ///< its own deviation from a plane, peak to valley
};

/// What is tested of a scanner.
enum class Characteristic : std::uint8_t { form, form95, size, spacing, flatness, flatness95 };
inline constexpr std::array kCharacteristics = {Characteristic::form,     Characteristic::form95,
                                                Characteristic::size,     Characteristic::spacing,
                                                Characteristic::flatness, Characteristic::flatness95};
/// "form", "form95", "size", "spacing", "flatness", "flatness95"
const char* to_string(Characteristic characteristic);

/// Maximum permissible errors of a scanner by characteristic, mm; where none is stated, nothing is judged.
struct PermissibleErrors {
  std::array<std::optional<double>, kCharacteristics.size()> mm{};
  std::optional<double>& of(Characteristic c) { return mm.at(static_cast<std::size_t>(c)); }
  const std::optional<double>& of(Characteristic c) const { return mm.at(static_cast<std::size_t>(c)); }
};

struct Artefact {
  std::string name;
  std::string certificate;               ///< what the file says of its origin; may be empty
  std::vector<CertifiedSphere> spheres;  ///< two or more
  std::vector<CertifiedSpacing> spacings;
  std::optional<CertifiedFlat> flat;
  PermissibleErrors permissible;
};

/// Errors: one sentence with file, line, field, value and remedy.
tl::expected<Artefact, std::string> read_artefact(const std::filesystem::path& file);
/// @param name  what messages call the text
tl::expected<Artefact, std::string> parse_artefact(const std::string& text, const std::string& name);

/// mpe = field *( "," field ), field = CHARACTERISTIC "=" MM, each once; they take the place of those in `permissible`.
/// Errors: one sentence with the field.
tl::expected<void, std::string> parse_permissible(const std::string& text, PermissibleErrors& permissible);

}  // namespace celadon
