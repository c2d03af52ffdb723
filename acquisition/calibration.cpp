// Grammar: CALIBRATION.md.
#include "acquisition/calibration.h"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <memory>
#include <set>
#include <stdexcept>
#include <string_view>
#include <system_error>

#include <Eigen/Eigenvalues>

#include "acquisition/calibration_axes.h"
#include "acquisition/calibration_change.h"
#include "acquisition/lens.h"
#include "acquisition/toml_section.h"

namespace celadon {
namespace {

using namespace checked_toml;
using namespace calibration_sections;

constexpr std::size_t kLargestCalibration = std::size_t{1} << 20;
constexpr double kRotationTolerance = 1e-9;
constexpr int kMajor = 1, kMinor = 3;
constexpr const char* kFormat = "celadon-calibration";
constexpr std::array<const char*, 5> kDistortionKeys{"k1", "k2", "p1", "p2", "k3"};

bool is_date(const std::string& text) {
  const auto digits = [&](std::size_t from, std::size_t count) {
    return std::all_of(text.begin() + static_cast<std::ptrdiff_t>(from),
                       text.begin() + static_cast<std::ptrdiff_t>(from + count),
                       [](char c) { return c >= '0' && c <= '9'; });
  };
  const auto in = [&](std::size_t from, int low, int high) {
    const int value = (text[from] - '0') * 10 + (text[from + 1] - '0');
    return digits(from, 2) && value >= low && value <= high;
  };
  if (text.size() < 10 || !digits(0, 4) || text[4] != '-' || !in(5, 1, 12) || text[7] != '-' || !in(8, 1, 31)) {
    return false;
  }
  if (text.size() == 10) return true;
  if (text.size() < 20 || text[10] != 'T' || !in(11, 0, 23) || text[13] != ':' || !in(14, 0, 59) || text[16] != ':' ||
      !in(17, 0, 60) || text.back() != 'Z') {
    return false;
  }
  return text.size() == 20 || (text[19] == '.' && text.size() > 21 && digits(20, text.size() - 21));
}

/// @returns whether the file's minor version is newer than this reader's
bool check_version(Section& root) {
  if (const std::string format = root.text("format"); format != kFormat) {
    root.refuse(root.node("format"), "format",
                "is " + excerpt(format) + " and must be \"" + kFormat + "\"; this is not a calibration file");
  }
  const std::string version = root.text("version");
  int major = 0, minor = 0;
  const char* const end = version.data() + version.size();
  const auto first = std::from_chars(version.data(), end, major);
  const bool dot = first.ec == std::errc{} && first.ptr != end && *first.ptr == '.';
  const auto second = dot ? std::from_chars(first.ptr + 1, end, minor) : first;
  if (!dot || second.ec != std::errc{} || second.ptr != end || major < 0 || minor < 0) {
    root.refuse(root.node("version"), "version",
                "is " + excerpt(version) + " and must read MAJOR.MINOR, such as \"1.0\"");
  }
  if (major != kMajor) {
    root.refuse(root.node("version"), "version",
                "is " + excerpt(version) + " and this program reads version 1; " +
                    (major > kMajor ? "update Celadon or calibrate again" : "calibrate again"));
  }
  return minor > kMinor;
}

CameraModel camera_of(Section& root) {
  Section section = root.section("camera_model");
  CameraModel camera;
  camera.width_px = section.integer("width_px", 1, 65535);
  camera.height_px = section.integer("height_px", 1, 65535);
  camera.fx_px = section.positive("fx_px");
  camera.fy_px = section.positive("fy_px");
  const auto centre = [&](const char* key, int size) {
    const Measured out = section.measured(key);
    if (!(out.value >= -size && out.value <= 2.0 * size)) {
      section.refuse(section.node(key), std::string(key) + ".value",
                     "is " + number_text(out.value) + ", more than one image size (" + std::to_string(size) +
                         " px) outside the image; calibrate again");
    }
    return out;
  };
  camera.cx_px = centre("cx_px", camera.width_px);
  camera.cy_px = centre("cy_px", camera.height_px);
  for (std::size_t i = 0; i < kDistortionKeys.size(); ++i) camera.distortion[i] = section.measured(kDistortionKeys[i]);
  if (!invertible(camera)) {
    section.refuse(section.node("k1"), "k1 ... k3",
                   "describe a distortion that folds the image over inside its border, so that pixels have no single "
                   "ray; calibrate the camera again with the board near every corner");
  }
  section.finish();
  return camera;
}

LaserPlane laser_of(Section section) {
  LaserPlane plane;
  plane.laser = section.integer("number", 0, 255);
  plane.normal_C = unit_vector_of(section, "normal");
  plane.distance_mm = section.number("distance_mm");
  if (std::abs(plane.distance_mm) < 1e-3) {
    section.refuse(section.node("distance_mm"), "distance_mm",
                   "is " + number_text(plane.distance_mm) +
                       ": a plane through the camera's centre measures nothing; calibrate the laser again");
  }
  plane.u_normal_rad = section.uncertainty("u_normal_rad");
  plane.u_distance_mm = section.uncertainty("u_distance_mm");
  section.finish();
  return plane;
}

std::vector<LaserPlane> lasers_of(Section& root, const std::string& name, bool newer) {
  const toml::node& found = root.node("laser");
  const auto* tables = found.as_array();
  if (tables == nullptr || tables->empty() || !tables->is_array_of_tables()) {
    root.refuse(found, "laser", "is " + value_text(found) + " and must be one or more tables [[laser]]");
  }
  std::vector<LaserPlane> lasers;
  for (std::size_t i = 0; i < tables->size(); ++i) {
    const toml::table& table = *tables->get(i)->as_table();
    lasers.push_back(laser_of({table, name, "laser[" + std::to_string(i) + "]", newer}));
    const int number = lasers.back().laser;
    if (std::count_if(lasers.begin(), lasers.end(), [&](const LaserPlane& l) { return l.laser == number; }) > 1) {
      root.refuse(table, "laser[" + std::to_string(i) + "].number",
                  "is " + std::to_string(number) + ", which an earlier laser has; number each laser once");
    }
  }
  return lasers;
}

AxisPose axis_of(Section& root) {
  Section section = root.section("axis");
  AxisPose axis;
  const Eigen::Matrix3d rotation = section.matrix("rotation");
  const double error = (rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(error <= kRotationTolerance)) {
    section.refuse(section.node("rotation"), "rotation",
                   "differs from a rotation by " + number_text(error) +
                       " (R R^T - 1) and may by 1e-9; write all its digits or calibrate again");
  }
  if (rotation.determinant() < 0) {
    section.refuse(section.node("rotation"), "rotation",
                   "is a reflection (its determinant is -1); exchange the sign of one axis or calibrate again");
  }
  axis.X_CW.linear() = rotation;
  axis.X_CW.translation() = section.vector("translation_mm");
  axis.u_direction_rad = section.uncertainty("u_direction_rad");
  axis.u_position_mm = section.uncertainty("u_position_mm");
  section.finish();
  return axis;
}

CalibrationCovariance covariance_of(Section& root, const Calibration& calibration) {
  Section section = root.section("covariance");
  CalibrationCovariance out{section.texts("names"), {}};
  for (std::size_t i = 0; i < out.names.size(); ++i) {
    const std::string& name = out.names[i];
    const auto refuse_name = [&](const std::string& why) {
      section.refuse(section.node("names"), "names[" + std::to_string(i) + "]", "is " + excerpt(name) + why);
    };
    if (!has_parameter(calibration, name)) refuse_name(", which is no number of this calibration; calibrate again");
    if (std::count(out.names.begin(), out.names.end(), name) > 1) refuse_name(" and stands twice; calibrate again");
  }
  out.matrix = section.symmetric("lower", static_cast<Eigen::Index>(out.names.size()));
  // In units of its own standard deviations: the numbers' sizes differ by 10^8.
  const Eigen::VectorXd deviations = out.matrix.diagonal().cwiseSqrt();
  bool sound = (out.matrix.diagonal().array() >= 0).all();
  if (sound) {
    const Eigen::VectorXd inverse = (deviations.array() > 0).select(deviations.cwiseInverse(), 1.0);
    const Eigen::MatrixXd correlation = inverse.asDiagonal() * out.matrix * inverse.asDiagonal();
    constexpr double kRounding = 1e-9;
    sound = correlation.allFinite() &&
            Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(correlation, Eigen::EigenvaluesOnly).eigenvalues()[0] >=
                -kRounding * static_cast<double>(out.names.size());
  }
  if (!sound) {
    section.refuse(section.node("lower"), "lower",
                   "is no covariance: some combination of the numbers would have a negative variance; copy the file "
                   "again or calibrate again");
  }
  section.finish();
  return out;
}

TableEncoder encoder_of(Section& section) {
  // An encoder that errs by more within a turn than by half a turn would turn back somewhere.
  constexpr double kLargest = 0.5;  // of the scale
  TableEncoder out;
  out.scale = section.positive("scale");
  out.direction = section.number("direction");
  if (out.direction != 1 && out.direction != -1) {
    section.refuse(section.node("direction"), "direction", "is " + number_text(out.direction) + " and must be 1 or -1");
  }
  if (section.has("cos_rad")) out.cos_rad = section.measured("cos_rad");
  if (section.has("sin_rad")) out.sin_rad = section.measured("sin_rad");
  for (const auto& [key, number] : {std::pair{"cos_rad", out.cos_rad}, std::pair{"sin_rad", out.sin_rad}}) {
    if (std::abs(number.value) > kLargest * out.scale.value) {
      section.refuse(section.node(key), key,
                     "is " + number_text(number.value) + " and must be within half of the scale; calibrate again");
    }
  }
  return out;
}

Calibration calibration_of(const toml::table& table, const std::string& name) {
  Section root(table, name, "");
  const bool newer = check_version(root);
  root.set_newer(newer);
  Calibration out;
  out.machine = root.text("machine");
  out.camera = root.text("camera");
  out.date = root.text("date");
  if (!is_date(out.date)) {
    root.refuse(root.node("date"), "date",
                "is " + excerpt(out.date) + " and must be ISO 8601 in UTC, such as \"2025-03-31T14:05:00Z\"");
  }
  out.simulated = root.boolean("simulated");
  out.camera_model = camera_of(root);
  out.lasers = lasers_of(root, name, newer);
  out.axis = axis_of(root);

  Section encoder = root.section("encoder");
  out.encoder = encoder_of(encoder);
  encoder.finish();

  Section geometry = root.section("geometry");
  out.scale = geometry.positive("scale");
  out.systematic_mm = geometry.uncertainty("systematic_mm");
  if (geometry.has("u_drift_mm")) out.u_drift_mm = geometry.uncertainty("u_drift_mm");
  geometry.finish();

  Section time = root.section("time");
  out.time = {time.measured("stamp_offset_ns"), time.measured("exposure_factor"), time.measured("line_time_ns")};
  time.finish();
  if (root.has("elevation")) out.elevation = elevation_of(root);
  if (root.has("lift")) out.lift = lift_of(root);
  if (root.has("rim_tag")) out.rim_tags = rim_tags_of(root, name, newer);
  if (root.has("covariance")) out.covariance = covariance_of(root, out);
  root.finish();
  return out;
}

tl::unexpected<CalibrationError> error(std::string message) {
  return tl::unexpected(CalibrationError{std::move(message)});
}

}  // namespace

AxisCrossing crossing_of(const ElevationAxis& elevation) {
  // The point (0, 0, z) whose part across the line, P (z e_z - o) with P = 1 - d d^T, is shortest.
  const Eigen::Vector3d &o = elevation.origin_mm, &d = elevation.direction;
  AxisCrossing out;
  out.z_mm = (o.z() - d.z() * d.dot(o)) / (1 - d.z() * d.z());
  const Eigen::Vector3d between = out.z_mm * Eigen::Vector3d::UnitZ() - o;
  out.gap_mm = (between - d * d.dot(between)).norm();
  return out;
}

Eigen::Isometry3d head_turn(const ElevationAxis& elevation, double reading_rad) {
  Eigen::Isometry3d out = Eigen::Isometry3d::Identity();
  out.linear() = Eigen::AngleAxisd(elevation.scale.value * reading_rad, elevation.direction).toRotationMatrix();
  out.translation() = elevation.origin_mm - out.linear() * elevation.origin_mm;
  return out;
}

Eigen::Affine3d camera_to_object(const Calibration& calibration, const AxisStop& stop) {
  Eigen::Affine3d out(calibration.axis.X_CW.inverse());
  out.prescale(calibration.scale.value);
  if (stop.elevation_rad != 0) {
    if (!calibration.elevation) throw std::invalid_argument("camera_to_object: no elevation axis is calibrated");
    out = head_turn(*calibration.elevation, stop.elevation_rad) * out;
  }
  if (stop.lift_mm != 0) {
    if (!calibration.lift) throw std::invalid_argument("camera_to_object: no lift axis is calibrated");
    out.pretranslate(-calibration.lift->scale.value * stop.lift_mm * calibration.lift->direction);
  }
  return out;
}

tl::expected<Calibration, CalibrationError> read_calibration(const std::filesystem::path& file) {
  const std::string name = "calibration " + file.string();
  std::error_code is_folder_error;
  if (std::filesystem::is_directory(file, is_folder_error)) {
    return error(name + " is a folder; give the calibration file in it");
  }
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> stream(std::fopen(file.c_str(), "rb"), &std::fclose);
  if (stream == nullptr) {
    const int cause = errno;
    return error(name + " cannot be opened: " + std::strerror(cause) + " (errno " + std::to_string(cause) +
                 "); give the file of this machine with --calibration or calibrate first");
  }
  std::string text(kLargestCalibration + 1, '\0');
  text.resize(std::fread(text.data(), 1, text.size(), stream.get()));
  if (std::ferror(stream.get()) != 0) return error(name + " cannot be read; check the disk or copy the file again");
  return parse_calibration(text, name);
}

tl::expected<Calibration, CalibrationError> parse_calibration(const std::string& text, const std::string& name) {
  if (text.empty()) return error(name + " is empty; copy the calibration file again or calibrate again");
  if (text.size() > kLargestCalibration) {
    return error(name + " is longer than 1 MiB and cannot be a calibration file; give the right file");
  }
  const auto parsed = parse_ascii(text);
  if (!parsed) return error(name + ", " + parsed.error());
  try {
    return calibration_of(*parsed, name);
  } catch (const Refusal& refusal) {
    return error(refusal.message);
  }
}

std::string format_calibration(const Calibration& calibration) {
  const CameraModel& camera = calibration.camera_model;
  std::string out =
      "# Celadon calibration; grammar: acquisition/CALIBRATION.md. mm, rad, ns, px; u: standard uncertainty.\n";
  const auto line = [&](const char* key, const std::string& value) { out += line_text(key, value); };
  line("format", quoted(kFormat));
  line("version", quoted(std::to_string(kMajor) + "." + std::to_string(kMinor)));
  line("machine", quoted(calibration.machine));
  line("camera", quoted(calibration.camera));
  line("date", quoted(calibration.date));
  line("simulated", calibration.simulated ? "true" : "false");

  out += "\n[camera_model]\n";
  line("width_px", std::to_string(camera.width_px));
  line("height_px", std::to_string(camera.height_px));
  line("fx_px", measured_text(camera.fx_px));
  line("fy_px", measured_text(camera.fy_px));
  line("cx_px", measured_text(camera.cx_px));
  line("cy_px", measured_text(camera.cy_px));
  for (std::size_t i = 0; i < kDistortionKeys.size(); ++i)
    line(kDistortionKeys[i], measured_text(camera.distortion[i]));

  for (const LaserPlane& plane : calibration.lasers) {
    out += "\n[[laser]]\n";
    line("number", std::to_string(plane.laser));
    line("normal", vector_text(plane.normal_C));
    line("distance_mm", number_text(plane.distance_mm));
    line("u_normal_rad", number_text(plane.u_normal_rad));
    line("u_distance_mm", number_text(plane.u_distance_mm));
  }

  const Eigen::Matrix3d rotation = calibration.axis.X_CW.linear();
  out += "\n[axis]\nrotation = [\n";
  for (Eigen::Index i = 0; i < 3; ++i) out += "  " + vector_text(rotation.row(i).transpose()) + ",\n";
  out += "]\n";
  line("translation_mm", vector_text(calibration.axis.X_CW.translation()));
  line("u_direction_rad", number_text(calibration.axis.u_direction_rad));
  line("u_position_mm", number_text(calibration.axis.u_position_mm));

  out += "\n[encoder]\n";
  const TableEncoder& encoder = calibration.encoder;
  line("scale", measured_text(encoder.scale));
  line("direction", encoder.direction < 0 ? "-1" : "1");
  if (encoder.cos_rad != Measured{} || encoder.sin_rad != Measured{}) {
    line("cos_rad", measured_text(encoder.cos_rad));
    line("sin_rad", measured_text(encoder.sin_rad));
  }
  out += "\n[geometry]\n";
  line("scale", measured_text(calibration.scale));
  line("systematic_mm", number_text(calibration.systematic_mm));
  if (calibration.u_drift_mm > 0) line("u_drift_mm", number_text(calibration.u_drift_mm));
  out += "\n[time]\n";
  line("stamp_offset_ns", measured_text(calibration.time.stamp_offset_ns));
  line("exposure_factor", measured_text(calibration.time.exposure_factor));
  line("line_time_ns", measured_text(calibration.time.line_time_ns));

  if (calibration.elevation) out += elevation_text(*calibration.elevation);
  if (calibration.lift) out += lift_text(*calibration.lift);
  for (const RimTag& tag : calibration.rim_tags) out += rim_tag_text(tag);

  if (calibration.covariance) {
    const CalibrationCovariance& covariance = *calibration.covariance;
    out += "\n[covariance]\nnames = [";
    for (std::size_t i = 0; i < covariance.names.size(); ++i) out += (i > 0 ? ", " : "") + quoted(covariance.names[i]);
    out += "]\nlower = [\n";
    for (Eigen::Index i = 0; i < covariance.matrix.rows(); ++i) {
      out += "  [";
      for (Eigen::Index j = 0; j <= i; ++j) out += (j > 0 ? ", " : "") + number_text(covariance.matrix(i, j));
      out += "],\n";
    }
    out += "]\n";
  }
  return out;
}

tl::expected<void, CalibrationError> check_calibration(const Calibration& calibration, const std::string& machine,
                                                       const std::string& camera, int width_px, int height_px) {
  const CameraModel& model = calibration.camera_model;
  if (calibration.machine != machine) {
    return error("the calibration is of the machine \"" + calibration.machine + "\" and the machine connected is \"" +
                 machine + "\"; give this machine's calibration or calibrate it");
  }
  if (calibration.camera != camera) {
    return error("the calibration is of the camera \"" + calibration.camera + "\" and the camera connected is \"" +
                 camera + "\"; give this camera's calibration or calibrate again");
  }
  if (model.width_px != width_px || model.height_px != height_px) {
    const auto size = [](int w, int h) { return std::to_string(w) + " x " + std::to_string(h) + " px"; };
    return error("the calibration is for images of " + size(model.width_px, model.height_px) +
                 " and the camera delivers " + size(width_px, height_px) +
                 "; set the camera to the calibrated size or calibrate at this one");
  }
  return {};
}

}  // namespace celadon
