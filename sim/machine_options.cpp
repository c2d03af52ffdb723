#include "sim/machine_options.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/machine_axes.h"

namespace celadon::sim {

void add_machine_options(CLI::App& app, Options& o) {
  std::string known;
  for (const std::string& name : Scene::names()) known += name + ", ";
  app.add_option("--scene", o.scene,
                 "object on the table: " + known +
                     "artefact, empty, mesh:FILE (STL or PLY, millimetres), board:chessboard:11x8x8 or "
                     "board:tags:10x7x12 with or "
                     "without their sizes, with a pose after @")
      ->capture_default_str();
  app.add_option("--seed", o.seed, "of every random number")->capture_default_str();
  app.add_option("--width", o.width, "image width, px")->check(CLI::Range(64, 4096))->capture_default_str();
  app.add_option("--height", o.height, "image height, px")->check(CLI::Range(64, 4096))->capture_default_str();
  app.add_option("--format", o.format, "pixel format")->check(CLI::IsMember({"grey", "yuyv"}))->capture_default_str();
  app.add_option("--shutter", o.shutter, "global: all rows at once; rolling: row after row")
      ->check(CLI::IsMember({"global", "rolling"}))
      ->capture_default_str();
  app.add_option("--fps", o.fps, "frames a second")->check(CLI::Range(1.0, 1000.0))->capture_default_str();
  app.add_option("--exposure", o.exposure_ms, "exposure at the start, ms")
      ->check(CLI::Range(0.02, 900.0))
      ->capture_default_str();
  app.add_option("--frame-delay", o.delay_ms, "from read out to arrived, ms")
      ->check(CLI::Range(0.0, 5000.0))
      ->capture_default_str();
  app.add_option("--sheet-offset", o.sheet_offset_mm, "laser sheet misses the axis by, mm")
      ->check(CLI::Range(-20.0, 20.0))
      ->capture_default_str();
  app.add_option("--sheet-tilt", o.sheet_tilt_mrad, "laser sheet leans by, mrad")
      ->check(CLI::Range(-200.0, 200.0))
      ->capture_default_str();
  app.add_option("--sheet-sigma", o.sheet_sigma_mm, "laser sheet's thickness, standard deviation, mm")
      ->check(CLI::Range(0.01, 2.0))
      ->capture_default_str();
  app.add_option("--line-levels", o.line_levels, "brightness of the line, grey levels at 4 ms")
      ->check(CLI::Range(0.0, 5000.0))
      ->capture_default_str();
  app.add_option("--speckle", o.speckle, "speckle contrast, 0: none")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--read-noise", o.read_noise, "standard deviation, grey levels")
      ->check(CLI::Range(0.0, 50.0))
      ->capture_default_str();
  app.add_option("--electrons", o.electrons, "electrons a grey level (shot noise)")
      ->check(CLI::Range(0.1, 1e9))
      ->capture_default_str();
  app.add_option("--ambient", o.ambient, "room light, relative")->check(CLI::Range(0.0, 100.0))->capture_default_str();
  app.add_option("--reflection", o.reflection, "stray second line, share of the line")
      ->check(CLI::Range(0.0, 5.0))
      ->capture_default_str();
  app.add_option("--glaze", o.glaze, "gloss of the object, relative to its matt brightness")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  app.add_option("--backlash", o.backlash_deg, "play of the drive, degrees")
      ->check(CLI::Range(0.0, 10.0))
      ->capture_default_str();
  app.add_option("--lasers", o.lasers, "1, or 2: one on each side of the camera")
      ->check(CLI::Range(1, 2))
      ->capture_default_str();
  app.add_flag("--elevation", o.elevation,
               "camera and lasers turn together about a horizontal axis, -10 to 70 degrees");
  app.add_flag("--lift", o.lift, "the table rises and sinks, -150 to 150 mm");
  app.add_option("--rim-tags", o.rim_tags, "AprilTags (tag36h11, from 100 on) round the platter's edge")
      ->check(CLI::Range(0, 24))
      ->capture_default_str();
  app.add_option("--texture", o.texture, "the object's surface is speckled, by this seed, or none")
      ->check(CLI::IsMember({"none"}) | CLI::TypeValidator<std::uint64_t>("SEED"))
      ->capture_default_str();
  app.add_option("--paint", o.paint,
                 "the object is painted: third:ALBEDO, dark on a third of the turn; bands:ALBEDO, in every other 12 mm "
                 "of its height; sectors: red, green and blue, a third of the turn each; or none")
      ->check(CLI::Validator(
          [](const std::string& text) {
            const auto paint = Paint::parse(text);
            return paint ? std::string() : paint.error();
          },
          "PAINT"))
      ->capture_default_str();
  app.add_option("--board-pitch-x", o.board_pitch_x, "boards are printed too long along their rows, relative")
      ->check(CLI::Range(-0.05, 0.05))
      ->capture_default_str();
  app.add_option("--board-pitch-y", o.board_pitch_y, "boards are printed too long along their columns, relative")
      ->check(CLI::Range(-0.05, 0.05))
      ->capture_default_str();
  app.add_option("--board-bow", o.board_bow_mm, "the ends of boards lie behind their middle by, mm")
      ->check(CLI::Range(-20.0, 20.0))
      ->capture_default_str();
  app.add_option("--sheet-bow", o.sheet_bow_mm, "effect: the sheet is bowed by, mm at 50 mm above and below its middle")
      ->check(CLI::Range(-2.0, 2.0))
      ->capture_default_str();
  app.add_option("--spindle-radial", o.spindle_radial_um, "effect: radial error motion, micrometres")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app.add_option("--spindle-axial", o.spindle_axial_um, "effect: axial error motion, micrometres")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app.add_option("--spindle-tilt", o.spindle_tilt_urad, "effect: tilt error motion, microradians")
      ->check(CLI::Range(0.0, 10'000.0))
      ->capture_default_str();
  app.add_option("--encoder-eccentricity", o.encoder_eccentricity_mdeg, "effect: error once a turn, millidegrees")
      ->check(CLI::Range(0.0, 5000.0))
      ->capture_default_str();
  app.add_option("--thermal-drift", o.thermal_drift_mrad, "effect: the camera turns as it warms up, mrad in the end")
      ->check(CLI::Range(-50.0, 50.0))
      ->capture_default_str();
  app.add_option("--thermal-time", o.thermal_time_s, "time constant of --thermal-drift, s")
      ->check(CLI::Range(1.0, 1e6))
      ->capture_default_str();
  app.add_option("--subsurface", o.subsurface, "effect: share of the light that enters the object and leaves it nearby")
      ->check(CLI::Range(0.0, 0.95))
      ->capture_default_str();
  app.add_option("--subsurface-depth", o.subsurface_depth_mm, "how far that light goes, mm")
      ->check(CLI::Range(0.05, 10.0))
      ->capture_default_str();
  app.add_option("--fields", o.fields_contrast, "effect: fields of two reflectances on the object, bright : dark")
      ->check(CLI::Range(1.0, 100.0))
      ->capture_default_str();
  app.add_option("--fields-pitch", o.fields_pitch_mm, "height of a field, mm")
      ->check(CLI::Range(0.5, 100.0))
      ->capture_default_str();
  app.add_option("--date", o.date, "date of the true calibration, ISO 8601 in UTC (default: now)");
}

DeviceConfig device_of(const Options& o) {
  CameraConfig camera;
  camera.width_px = o.width - o.width % 2;
  camera.height_px = o.height;
  camera.format = o.format == "yuyv" ? PixelFormat::yuyv : PixelFormat::grey8;
  camera.shutter = o.shutter == "rolling" ? Shutter::rolling : Shutter::global;
  camera.period_ns = std::llround(1e9 / o.fps);
  camera.readout_ns = camera.period_ns * 84 / 100;
  camera.exposure_ns = std::min<std::int64_t>(std::llround(o.exposure_ms * 1e6), camera.period_ns - 100'000);
  camera.delay_ns = std::llround(o.delay_ms * 1e6);
  DeviceConfig device = default_device(camera, o.sheet_offset_mm, o.sheet_tilt_mrad * 1e-3);
  device.scene = o.scene;
  device.rim_tags = o.rim_tags;
  if (o.texture != "none") device.texture = std::stoull(o.texture);
  device.paint = Paint::parse(o.paint).value_or(Paint());
  device.print = {o.board_pitch_x, o.board_pitch_y, o.board_bow_mm};
  device.seed = o.seed;
  device.date = o.date;
  device.locked_at_start = o.locked;
  device.turntable.backlash_rad = o.backlash_deg * std::numbers::pi / 180;
  device.turntable.encoder_eccentricity_rad = o.encoder_eccentricity_mdeg * 1e-3 * std::numbers::pi / 180;
  device.thermal = {o.thermal_drift_mrad * 1e-3, o.thermal_time_s};
  OpticsConfig& optics = device.optics;
  optics.sheet.sigma_mm = o.sheet_sigma_mm;
  optics.sheet.bow_mm = o.sheet_bow_mm;
  if (o.lasers == 2) optics.second_sheet = mirrored_sheet(optics.sheet);
  optics.axes = draw_axes(o.seed, optics.X_CW, o.elevation, o.lift);
  optics.spindle = {o.spindle_radial_um * 1e-3, o.spindle_axial_um * 1e-3, o.spindle_tilt_urad * 1e-6};
  optics.subsurface = {o.subsurface, o.subsurface_depth_mm};
  optics.fields = {o.fields_contrast, o.fields_pitch_mm};
  optics.line_levels = o.line_levels;
  optics.speckle_contrast = o.speckle;
  optics.noise.read_levels = static_cast<float>(o.read_noise);
  optics.noise.electrons_per_level = static_cast<float>(o.electrons);
  optics.ambient_low *= o.ambient;
  optics.ambient_high *= o.ambient;
  optics.object_ambient *= o.ambient;
  optics.reflection = o.reflection;
  optics.glaze = o.glaze;
  return device;
}

}  // namespace celadon::sim
