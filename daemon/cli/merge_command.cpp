// celadon merge: partial sums to one surface, or to sums of more.

#include <algorithm>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "daemon/cli/fit_outputs.h"
#include "daemon/cli/model_option.h"
#include "daemon/cli/partial_fit.h"
#include "daemon/files/atomic_file.h"
#include "daemon/partial_sums.h"
#include "daemon/usage_error.h"
#include "fitting/gathered_fit.h"

namespace celadon::cli {
namespace {

struct MergeArguments {
  std::vector<std::string> parts, outputs;
  std::string model = "auto", space = "curvature", name = "merged", date, report;
  double tolerance_mm = 0, form_tolerance_mm = -1, chord_mm = 0;
  bool ap214 = false, json = false;
};

bool is_part(const std::string& output) {
  return std::filesystem::path(output).extension() == ".part";
}

int write_sums(const PartialSums& sums, const std::string& output) {
  if (const std::string missing = missing_folder(output); !missing.empty()) return fail(2, missing);
  const auto written = write_file_atomically(output, format_part(sums));
  if (!written) return fail(4, written.error().message);
  std::printf("  summed      %zu of %zu points\n  wrote       %s\n", sums.samples.sums.samples(),
              sums.samples.look.points(), output.c_str());
  return 0;
}

// Inputs that more than one part names: perhaps the same samples, perhaps files of one name in other folders.
std::vector<std::string> named_twice(const std::vector<std::string>& inputs) {
  std::vector<std::string> result;
  for (std::size_t k = 1; k < inputs.size(); ++k)
    if (inputs[k] == inputs[k - 1] && (result.empty() || result.back() != inputs[k])) result.push_back(inputs[k]);
  return result;
}

int merge(const MergeArguments& arguments) {
  StopWatch watch;
  const bool sums_only = arguments.outputs.size() == 1 && is_part(arguments.outputs.front());
  const auto outputs = output_files(sums_only ? std::vector<std::string>{} : arguments.outputs, arguments.report);
  if (!outputs) return fail(2, outputs.error());
  std::vector<NamedPart> parts;
  for (const std::string& file : arguments.parts) {
    auto part = read_part(file);
    if (!part) return fail(2, part.error());
    parts.push_back(std::move(*part));
  }
  const auto merged = merge_parts(std::move(parts));
  if (!merged) return fail(2, merged.error());
  if (sums_only) return write_sums(*merged, arguments.outputs.front());

  ResultNotes notes;
  notes.name = arguments.name;
  notes.date = arguments.date;
  for (const std::string& input : named_twice(merged->inputs))
    notes.warnings.push_back("More than one part has sums of an input '" + input +
                             "'; if it is the same file, its samples count twice.");
  notes.seconds.push_back({"read", watch.lap()});
  RangeFitOptions options;
  take_from_grid(merged->grid, options);
  options.model = model_from(arguments.model);
  options.tolerance_mm = arguments.tolerance_mm;
  if (arguments.form_tolerance_mm >= 0) options.form_tolerance_mm = arguments.form_tolerance_mm;
  options.continuity = continuity_from(arguments.space);
  auto fitted = fit_gathered(merged->samples, options);
  if (!fitted) return fail(2, fitted.error().message);
  fitted->report.stopped_by += "; from the sums of " + std::to_string(merged->inputs.size()) + " inputs";
  place(*fitted, merged->grid.X_FL);
  notes.seconds.push_back({"fit", watch.lap()});
  ResultOptions files;
  files.ap214 = arguments.ap214;
  files.chord_mm = arguments.chord_mm;
  const std::string title = std::to_string(arguments.parts.size()) + " parts";
  return finish(
      std::span(&*fitted, 1), *outputs, notes, files, [&] { return report_json(*fitted, notes); }, watch, title,
      arguments.json);
}

}  // namespace

void add_merge_command(CLI::App& program, Run& run) {
  auto arguments = std::make_shared<MergeArguments>();
  auto* command = program.add_subcommand(
      "merge",
      "Add the sums of parts (celadon fit --partial) and fit one surface to them; or write them as one part, to be\n"
      "merged again with more. The same parts give the same bytes in whatever order.");
  command->option_defaults()->always_capture_default();
  command->add_option("PART", arguments->parts, "parts of one grid file")->required();
  command
      ->add_option(
          "-o,--output", arguments->outputs,
          "files to write, by their endings: .step, .stl, .ply, .json (surface), .svg (picture of the errors),\n"
          "report.json; or one .part")
      ->expected(1, -1);
  command->add_option("--report", arguments->report, "write the report as JSON to this file");
  add_model_options(*command, arguments->model, arguments->tolerance_mm, arguments->form_tolerance_mm,
                    arguments->space);
  command->add_option("--chord", arguments->chord_mm, "chord tolerance of meshes [mm]; 0: 1e-4 of the size")
      ->check(not_negative());
  command->add_option("--name", arguments->name, "name of the part in the files");
  command->add_option("--date", arguments->date, "date in the files, ISO 8601 UTC; default: none");
  command->add_flag("--ap214", arguments->ap214, "STEP AP214 instead of AP242");
  command->add_flag("--json", arguments->json, "print the report as one line of JSON instead of text");
  command->callback([arguments, &run] { run = [arguments] { return merge(*arguments); }; });
}

}  // namespace celadon::cli
