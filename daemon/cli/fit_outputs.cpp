#include "daemon/cli/fit_outputs.h"

#include <algorithm>
#include <cstdio>

#include "daemon/cli/commands.h"
#include "daemon/cli/summary.h"

namespace celadon::cli {

std::string missing_folder(const std::string& output) {
  const auto folder = std::filesystem::absolute(output).parent_path();
  if (std::filesystem::is_directory(folder)) return {};
  return "'" + output + "' cannot be written: there is no folder '" + folder.string() + "'; create it first";
}

tl::expected<OutputFiles, std::string> output_files(const std::vector<std::string>& outputs,
                                                    const std::string& report) {
  OutputFiles files;
  for (const auto& output : outputs) {
    const auto format = result_format_of(output);
    if (!format) {
      return tl::make_unexpected("'" + output +
                                 "' has no known ending; use .step, .stl, .ply, .svg (errors), surface.json or "
                                 "report.json");
    }
    if (auto missing = missing_folder(output); !missing.empty()) return tl::make_unexpected(std::move(missing));
    files.emplace_back(*format, output);
  }
  if (!report.empty()) files.emplace_back(ResultFormat::report_json, report);
  std::stable_sort(files.begin(), files.end(), [](const auto& a, const auto& b) {
    return (a.first == ResultFormat::report_json) < (b.first == ResultFormat::report_json);
  });
  return files;
}

int finish(std::span<const RangeFit> pieces, const OutputFiles& outputs, ResultNotes& notes,
           const ResultOptions& options, const std::function<nlohmann::ordered_json()>& report, StopWatch& watch,
           const std::string& title, bool json) {
  std::vector<FittedSurface> surfaces;
  for (const RangeFit& piece : pieces)
    surfaces.push_back({piece.function, piece.surface, piece.deviation ? &*piece.deviation : nullptr});
  for (const auto& [format, file] : outputs) {
    const auto written = format == ResultFormat::report_json  ? write_report(report(), file)
                         : format == ResultFormat::errors_svg ? write_errors(pieces, report(), file)
                                                              : write_surface(surfaces, format, file, notes, options);
    if (!written) return fail(written.error().exit_code, written.error().message);
    notes.seconds.push_back({to_string(format), watch.lap()});
  }
  const auto result = report();
  if (json) {
    std::printf("%s\n", result.dump().c_str());
  } else {
    std::printf("%s\n%s", title.c_str(), summary_of(nlohmann::json(result)).c_str());
    for (const auto& [format, file] : outputs) std::printf("  wrote       %s\n", file.c_str());
  }
  return 0;
}

}  // namespace celadon::cli
