#pragma once
// The command line of celadon-sim.

#include <CLI/CLI.hpp>
#include <cstdint>
#include <string>
#include <vector>

#include "sim/device_model.h"

namespace celadon::sim {

/// Everything the command line says.
struct Options {
  std::string scene = "vase", format = "grey", shutter = "global", speed = "real", modbus_tcp = "127.0.0.1:0",
              modbus_rtu, usbip, date;
  std::uint64_t seed = 1;
  int width = 1280, height = 1024;
  double fps = 60, exposure_ms = 4, delay_ms = 8, sheet_offset_mm = 0.3, sheet_tilt_mrad = 2, sheet_sigma_mm = 0.25;
  double line_levels = 150, speckle = 0.2, read_noise = 1.5, electrons = 40, ambient = 1, reflection = 0.1, glaze = 0;
  double backlash_deg = 0;
  int lasers = 1, rim_tags = 0;
  std::string texture = "none", paint = "none";
  bool elevation = false, lift = false;
  double board_pitch_x = 0, board_pitch_y = 0, board_bow_mm = 0;
  double sheet_bow_mm = 0, spindle_radial_um = 0, spindle_axial_um = 0, spindle_tilt_urad = 0,
         encoder_eccentricity_mdeg = 0, thermal_drift_mrad = 0, thermal_time_s = 600, subsurface = 0,
         subsurface_depth_mm = 0.5, fields_contrast = 1, fields_pitch_mm = 8;
  bool locked = false;
  std::string socket_dir;
  std::vector<std::string> faults;
  std::string fault_plan;
};

void add_machine_options(CLI::App& app, Options& o);
DeviceConfig device_of(const Options& o);

}  // namespace celadon::sim
