// Grammar: CALIBRATION.md.
#include "acquisition/calibration_axes.h"

#include <algorithm>
#include <cmath>

namespace celadon::calibration_sections {

using namespace checked_toml;

namespace {

constexpr double kUnitTolerance = 1e-9;
constexpr double kMostOffNominal = 0.70710678118654752;  // sine and cosine of 45 degrees
constexpr int kTags = 587;                               // of the family tag36h11
constexpr double kSmallestTag_mm = 0.5;

RimTag rim_tag_of(Section section) {
  RimTag tag;
  tag.number = section.integer("number", 0, kTags - 1);
  const std::vector<Eigen::Vector3d> corners = section.vectors("corners_mm", 4);
  std::copy(corners.begin(), corners.end(), tag.corners_mm.begin());
  const double side = (tag.corners_mm[1] - tag.corners_mm[0]).norm();
  if (!(side >= kSmallestTag_mm)) {
    section.refuse(section.node("corners_mm"), "corners_mm",
                   "make a tag " + number_text(side) + " mm wide, less than " + number_text(kSmallestTag_mm) +
                       " mm; calibrate again");
  }
  tag.u_mm = section.uncertainty("u_mm");
  section.finish();
  return tag;
}

}  // namespace

Eigen::Vector3d unit_vector_of(Section& section, const char* key) {
  const Eigen::Vector3d out = section.vector(key);
  if (const double length = out.norm(); !(std::abs(length - 1) <= kUnitTolerance)) {
    section.refuse(section.node(key), key,
                   "has length " + number_text(length) +
                       " and must have length 1 within 1e-9; divide it by its length "
                       "and write all its digits");
  }
  return out;
}

std::string measured_text(const Measured& m) {
  return "{ value = " + number_text(m.value) + ", u = " + number_text(m.u) + " }";
}

std::string vector_text(const Eigen::Vector3d& v) {
  return std::string("[").append(number_text(v.x())) + ", " + number_text(v.y()) + ", " + number_text(v.z()) + "]";
}

std::string line_text(const char* key, const std::string& value) {
  return std::string(key).append(" = ").append(value).append("\n");
}

ElevationAxis elevation_of(Section& root) {
  Section section = root.section("elevation");
  ElevationAxis axis;
  axis.origin_mm = section.vector("origin_mm");
  axis.direction = unit_vector_of(section, "direction");
  if (const double up = axis.direction.z(); std::abs(up) > kMostOffNominal) {
    section.refuse(section.node("direction"), "direction",
                   "has z = " + number_text(up) +
                       ", more than 45 degrees from horizontal, so that it cannot raise the head; calibrate the "
                       "elevation axis again");
  }
  axis.u_direction_rad = section.uncertainty("u_direction_rad");
  axis.u_origin_mm = section.uncertainty("u_origin_mm");
  axis.scale = section.positive("scale");
  section.finish();
  return axis;
}

std::string elevation_text(const ElevationAxis& axis) {
  return "\n[elevation]\n" + line_text("origin_mm", vector_text(axis.origin_mm)) +
         line_text("direction", vector_text(axis.direction)) +
         line_text("u_direction_rad", number_text(axis.u_direction_rad)) +
         line_text("u_origin_mm", number_text(axis.u_origin_mm)) + line_text("scale", measured_text(axis.scale));
}

LiftAxis lift_of(Section& root) {
  Section section = root.section("lift");
  LiftAxis axis;
  axis.direction = unit_vector_of(section, "direction");
  if (const double up = axis.direction.z(); up < kMostOffNominal) {
    section.refuse(section.node("direction"), "direction",
                   "has z = " + number_text(up) +
                       ", more than 45 degrees from the rotary axis, so that it does not raise the table; calibrate "
                       "the lift axis again");
  }
  axis.u_direction_rad = section.uncertainty("u_direction_rad");
  axis.scale = section.positive("scale");
  section.finish();
  return axis;
}

std::string lift_text(const LiftAxis& axis) {
  return "\n[lift]\n" + line_text("direction", vector_text(axis.direction)) +
         line_text("u_direction_rad", number_text(axis.u_direction_rad)) +
         line_text("scale", measured_text(axis.scale));
}

std::vector<RimTag> rim_tags_of(Section& root, const std::string& name, bool newer) {
  const toml::node& found = root.node("rim_tag");
  const auto* tables = found.as_array();
  if (tables == nullptr || tables->empty() || !tables->is_array_of_tables()) {
    root.refuse(found, "rim_tag", "is " + value_text(found) + " and must be one or more tables [[rim_tag]]");
  }
  std::vector<RimTag> tags;
  for (std::size_t i = 0; i < tables->size(); ++i) {
    const std::string path = "rim_tag[" + std::to_string(i) + "]";
    const toml::table& table = *tables->get(i)->as_table();
    tags.push_back(rim_tag_of({table, name, path, newer}));
    const int number = tags.back().number;
    if (std::count_if(tags.begin(), tags.end(), [&](const RimTag& tag) { return tag.number == number; }) > 1) {
      root.refuse(table, path + ".number",
                  "is " + std::to_string(number) + ", which an earlier tag has; calibrate again");
    }
  }
  return tags;
}

std::string rim_tag_text(const RimTag& tag) {
  std::string out = "\n[[rim_tag]]\n" + line_text("number", std::to_string(tag.number)) + "corners_mm = [\n";
  for (const Eigen::Vector3d& corner : tag.corners_mm) out += "  " + vector_text(corner) + ",\n";
  return out + "]\n" + line_text("u_mm", number_text(tag.u_mm));
}

}  // namespace celadon::calibration_sections
