// celadon line: the laser line in a photograph, as CSV and as an overlay to look at.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "acquisition/image_file.h"
#include "acquisition/laser_line.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/overlay_image.h"
#include "daemon/files/atomic_file.h"

namespace celadon::cli {
namespace {

struct LineArguments {
  std::string on, off, output, overlay, channel = "red", along = "rows";
  LaserLineOptions options;
};

const char* to_text(RowStatus status) {
  switch (status) {
    case RowStatus::found:
      return "found";
    case RowStatus::saturated:
      return "saturated";
    case RowStatus::ambiguous:
      return "ambiguous";
    case RowStatus::no_line:
      break;
  }
  return "no line";
}

std::string csv_of(const std::vector<LineRow>& rows, const std::vector<float>& smoothed, LineAlong along) {
  std::string csv = along == LineAlong::rows ? "row,x_px," : "column,y_px,";
  csv += "sigma_px,amplitude,width_px,status,smoothed_px\n";
  for (std::size_t y = 0; y < rows.size(); ++y) {
    const LineRow& row = rows[y];
    char text[160];
    if (row.x_px >= 0) {
      std::snprintf(text, sizeof text, "%zu,%.4f,%.4f,%.1f,%.3f,%s,", y, static_cast<double>(row.x_px),
                    static_cast<double>(row.sigma_px), static_cast<double>(row.amplitude),
                    static_cast<double>(row.width_px), to_text(row.status));
    } else {
      std::snprintf(text, sizeof text, "%zu,,,,,%s,", y, to_text(row.status));
    }
    csv += text;
    if (smoothed[y] >= 0) {
      std::snprintf(text, sizeof text, "%.4f", static_cast<double>(smoothed[y]));
      csv += text;
    }
    csv += '\n';
  }
  return csv;
}

void print_summary(const std::vector<LineRow>& rows, const std::vector<float>& smoothed, LineAlong along) {
  std::size_t found = 0, saturated = 0, ambiguous = 0, compared = 0;
  double squares = 0;
  std::vector<float> sigmas;
  for (std::size_t y = 0; y < rows.size(); ++y) {
    ambiguous += rows[y].status == RowStatus::ambiguous ? 1 : 0;
    if (rows[y].x_px < 0) continue;
    ++found;
    saturated += rows[y].status == RowStatus::saturated ? 1 : 0;
    sigmas.push_back(rows[y].sigma_px);
    if (smoothed[y] < 0) continue;
    ++compared;
    squares += std::pow(static_cast<double>(rows[y].x_px - smoothed[y]), 2);
  }
  const auto percent = [&](std::size_t n) { return 100.0 * static_cast<double>(n) / static_cast<double>(rows.size()); };
  const char* what = along == LineAlong::rows ? "rows" : "columns";
  std::printf("%-11s %zu, with a line %zu (%.1f %%), of these saturated %zu; ambiguous %zu (%.1f %%)\n", what,
              rows.size(), found, percent(found), saturated, ambiguous, percent(ambiguous));
  if (found == 0) return;
  std::nth_element(sigmas.begin(), sigmas.begin() + static_cast<std::ptrdiff_t>(found / 2), sigmas.end());
  std::printf("uncertainty median standard deviation %.3f px (from amplitude, width, noise, speckle)\n",
              static_cast<double>(sigmas[found / 2]));
  if (compared > 0) {
    std::printf("residual    %.3f px RMS of the %s against a local smooth line (+-8 %s)\n",
                std::sqrt(squares / static_cast<double>(compared)), what, what);
  }
  std::printf("SIMD        %s\n", laser_line_simd_target());
}

int line(const LineArguments& arguments) {
  const ColourChannel channel = arguments.channel == "green"  ? ColourChannel::green
                                : arguments.channel == "luma" ? ColourChannel::luma
                                                              : ColourChannel::red;
  GreyImage on, off;
  if (const auto read = read_image(arguments.on, channel, on); !read) return fail(2, read.error().message);
  if (!arguments.off.empty()) {
    if (const auto read = read_image(arguments.off, channel, off); !read) return fail(2, read.error().message);
    if (off.width_px != on.width_px || off.height_px != on.height_px) {
      return fail(2, "'" + arguments.off + "' has " + std::to_string(off.width_px) + " x " +
                         std::to_string(off.height_px) + " pixels and '" + arguments.on + "' " +
                         std::to_string(on.width_px) + " x " + std::to_string(on.height_px) +
                         "; give two pictures of one camera mode");
    }
  }
  LaserLineOptions options = arguments.options;
  const bool columns = arguments.along == "columns";
  options.along = columns ? LineAlong::columns : LineAlong::rows;
  constexpr int kShortest = 64, kLongest = 4096, kNarrowest = 16;
  const int length_px = columns ? on.height_px : on.width_px;
  if (length_px < kShortest || length_px > kLongest) {
    return fail(2, "'" + arguments.on + "' is " + std::to_string(length_px) + " pixels " + (columns ? "high" : "wide") +
                       "; the extractor takes " + std::to_string(kShortest) + " to " + std::to_string(kLongest));
  }
  if (columns && on.width_px < kNarrowest) {
    return fail(2, "'" + arguments.on + "' is " + std::to_string(on.width_px) +
                       " pixels wide; along columns the extractor takes " + std::to_string(kNarrowest) + " and more");
  }
  CameraMode mode;
  mode.width_px = on.width_px;
  mode.height_px = on.height_px;
  mode.stride_bytes = static_cast<std::size_t>(on.width_px);
  std::vector<LineRow> rows(static_cast<std::size_t>(columns ? on.width_px : on.height_px));
  LaserLineExtractor extractor(options);
  extractor.extract(mode, on.bytes, off.bytes, rows);
  std::vector<float> smoothed(rows.size());
  smooth_line(rows, smoothed);

  const auto write = [](const std::string& file, const std::string& bytes) {
    const auto written = write_file_atomically(file, bytes);
    return written ? 0 : fail(4, written.error().message);
  };
  if (!arguments.output.empty()) {
    if (const int code = write(arguments.output, csv_of(rows, smoothed, options.along))) return code;
  }
  if (!arguments.overlay.empty()) {
    if (const int code = write(arguments.overlay, overlay_png(on, rows, options.along))) return code;
  }
  print_summary(rows, smoothed, options.along);
  const bool any = std::any_of(rows.begin(), rows.end(), [](const LineRow& row) { return row.x_px >= 0; });
  return any ? 0
             : fail(1, std::string("no ") + (columns ? "column" : "row") + " of '" + arguments.on +
                           "' has a laser line; is it the right picture, --channel, --along and --off?");
}

}  // namespace

void add_line_command(CLI::App& program, Run& run) {
  auto arguments = std::make_shared<LineArguments>();
  auto* command = program.add_subcommand(
      "line", "Find the laser line in a picture (PNG or PGM), one sub-pixel position a row or column.");
  command->option_defaults()->always_capture_default();
  command->add_option("ON", arguments->on, "picture with the laser on")->required();
  command->add_option("--off", arguments->off, "picture with the laser off, subtracted");
  command->add_option(
      "-o,--output", arguments->output,
      "CSV file: row or column, position in it [px], standard deviation [px], amplitude, width [px], status");
  command->add_option("--overlay", arguments->overlay, "PNG file: the picture with the line drawn over it");
  command->add_option("--channel", arguments->channel, "of a colour picture: that of the laser, or luma")
      ->check(CLI::IsMember({"red", "green", "luma"}));
  command
      ->add_option("--along", arguments->along,
                   "search the line in rows (it stands upright) or in columns (it lies: a camera on its side)")
      ->check(CLI::IsMember({"rows", "columns"}));
  command->add_option("--contrast", arguments->options.minimum_contrast, "least contrast of a line [grey levels]")
      ->check(CLI::Range(1, 255));
  command->add_option("--read-noise", arguments->options.read_noise, "of the camera [grey levels]")
      ->check(CLI::PositiveNumber);
  command->add_option("--speckle", arguments->options.speckle_contrast, "contrast of the laser's speckle, 0 to 1")
      ->check(CLI::Range(0.0, 1.0));
  command->callback([arguments, &run] { run = [arguments] { return line(*arguments); }; });
}

}  // namespace celadon::cli
