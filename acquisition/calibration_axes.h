#pragma once
// Sections of a calibration file of what stands beside the table's axis: elevation, lift, fiducials on the platter; and
// the values that all its sections are made of. Grammar: CALIBRATION.md.

#include <string>
#include <vector>

#include "acquisition/calibration.h"
#include "acquisition/toml_section.h"

namespace celadon::calibration_sections {

/// A vector of length 1 within 1e-9.
/// @throws checked_toml::Refusal; so do the other readers
Eigen::Vector3d unit_vector_of(checked_toml::Section& section, const char* key);
std::string vector_text(const Eigen::Vector3d& v);
std::string measured_text(const Measured& m);
/// A line of the file.
std::string line_text(const char* key, const std::string& value);

ElevationAxis elevation_of(checked_toml::Section& root);
std::string elevation_text(const ElevationAxis& axis);

LiftAxis lift_of(checked_toml::Section& root);
std::string lift_text(const LiftAxis& axis);

/// @param name of the file, for messages  @param newer the file is of a newer minor version
std::vector<RimTag> rim_tags_of(checked_toml::Section& root, const std::string& name, bool newer);
std::string rim_tag_text(const RimTag& tag);

}  // namespace celadon::calibration_sections
