// celadon fit: a cloud or native samples to an exact surface and its files.

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>

#include <CLI/CLI.hpp>

#include "acquisition/calibration.h"
#include "daemon/cli/commands.h"
#include "daemon/cli/constraint_options.h"
#include "daemon/cli/fit_input.h"
#include "daemon/cli/fit_outputs.h"
#include "daemon/cli/log_file.h"
#include "daemon/cli/model_option.h"
#include "daemon/cli/partial_fit.h"
#include "daemon/files/atomic_file.h"
#include "daemon/files/cloud_files.h"
#include "daemon/report.h"
#include "daemon/results.h"
#include "daemon/shape_fit.h"
#include "daemon/usage_error.h"
#include "fitting/composite_fit.h"
#include "fitting/covered_angles.h"
#include "fitting/even_points.h"
#include "fitting/range_fit.h"
#include "fitting/shape_choice.h"
#include "fitting/spherical_stream.h"
#include "fitting/window_stream.h"

namespace celadon::cli {
namespace {

constexpr std::size_t kAnglePoints = 24000;

struct FitArguments {
  std::string input, turned_over, raised, axis = "auto", unit = "mm", shape = "cylinder", model = "auto",
                                          space = "curvature", rims = "plane", name, date, report;
  std::vector<std::string> outputs, angles;
  std::vector<double> heights, shoulders_mm;
  double tolerance_mm = 0, form_tolerance_mm = -1, fair_mm = 0, chord_mm = 0;
  std::optional<double> centre_z_mm, split_above_mm, split_below_mm, lift_mm;
  std::vector<int> degree = {3, 3}, knots;
  std::string grid, write_grid;
  ConstraintArguments known;
  bool axis_named = false, lift_exact = false, ap214 = false, json = false, partial = false;
  std::vector<std::string> named;  ///< options that were
  bool names(const char* option) const { return std::find(named.begin(), named.end(), option) != named.end(); }
};

RangeFitOptions fit_options(const FitArguments& arguments) {
  RangeFitOptions options;
  options.model = model_from(arguments.model);
  options.tolerance_mm = arguments.tolerance_mm;
  options.fair_mm = arguments.fair_mm;
  if (arguments.form_tolerance_mm >= 0) options.form_tolerance_mm = arguments.form_tolerance_mm;
  options.degree_u = arguments.degree[0];
  options.degree_v = arguments.degree[1];
  if (!arguments.knots.empty()) {
    options.z_intervals = arguments.knots[0];
    options.intervals_per_arc = arguments.knots[1];
  }
  options.continuity = continuity_from(arguments.space);
  return options;
}

// The shape as it was named, or as the samples want it; what was not named of it comes from the samples.
tl::expected<ShapeChoice, std::string> shape_of(const FitArguments& arguments, ProfileStream& samples,
                                                bool about_origin) {
  ShapeChoice named;
  if (arguments.shape == "composite") {
    named.shape = BodyShape::composite;
    named.split = {.below_mm = arguments.split_below_mm,
                   .above_mm = arguments.split_above_mm,
                   .shoulders = shoulders_at(samples, arguments.shoulders_mm)};
    if (named.split.any()) return named;
  }
  if (arguments.shape == "sphere" && (arguments.centre_z_mm || about_origin)) {
    named.shape = BodyShape::sphere;
    named.centre_z_mm = arguments.centre_z_mm.value_or(0);
    return named;
  }
  return shape_named(arguments.shape, samples);
}

// The part of the turn as it was named, or as the samples cover it.
tl::expected<BaseArcs, std::string> angles_of(const std::vector<std::string>& named, ProfileStream& samples) {
  if (named.empty()) return BaseArcs::full_circle();
  if (named.size() == 1 && named[0] == "auto") return covered_angles(even_points(samples, kAnglePoints));
  double degrees[2] = {0, 0};
  for (std::size_t k = 0; k < named.size() && named.size() == 2; ++k) {
    char* end = nullptr;
    degrees[k] = std::strtod(named[k].c_str(), &end);
    if (named[k].empty() || *end != 0 || !std::isfinite(degrees[k])) degrees[0] = degrees[1] = 0;
  }
  const double range = degrees[1] - degrees[0];
  if (!(range > 0 && range <= 360))
    return tl::make_unexpected("--angles '" + named[0] + (named.size() == 2 ? " " + named[1] : "") +
                               "' is neither auto nor two angles FROM TO in degrees, up to 360 apart");
  return BaseArcs::open(degrees[0] * std::numbers::pi / 180, range * std::numbers::pi / 180);
}

// What the options say together; empty: nothing is wrong.
std::string contradiction(const FitArguments& arguments) {
  const bool sphere = arguments.shape == "sphere";
  const bool split = arguments.split_above_mm || arguments.split_below_mm;
  if (arguments.partial && arguments.grid.empty())
    return "--partial needs the grid that all parts share; name it with --grid (celadon fit --write-grid makes one)";
  if (arguments.partial && (arguments.outputs.size() != 1 || !arguments.report.empty()))
    return "--partial writes one file; name it with -o FILE.part";
  if (arguments.known.any() && arguments.shape != "cylinder")
    return "--fix-radius, --fix-angle-below, --fix-angle-above, --symmetry and --mirror are for --shape cylinder; "
           "leave "
           "them out or change the shape";
  if (symmetry_of(arguments.known).any() && !(arguments.grid.empty() && arguments.write_grid.empty()))
    return "--symmetry and --mirror do not go with a grid of the whole turn; leave them or the grid out";
  if (!arguments.heights.empty() && !(arguments.heights[0] < arguments.heights[1]))
    return "--heights takes the lower height first; give FROM TO in mm";
  if (!arguments.heights.empty() && !(arguments.grid.empty() && arguments.write_grid.empty() &&
                                      arguments.turned_over.empty() && arguments.raised.empty()))
    return "--heights does not go with a grid or a second pose; leave them or it out";
  if (!arguments.angles.empty() &&
      (arguments.shape == "composite" || arguments.shape == "auto" || arguments.rims == "follow" ||
       symmetry_of(arguments.known).any() || !arguments.grid.empty() || !arguments.write_grid.empty() ||
       !arguments.turned_over.empty() || !arguments.raised.empty()))
    return "--angles is for one surface over a cylinder or a sphere with plane rims, in one pose; leave out what else "
           "was asked for";
  if (arguments.rims == "follow") {
    if (arguments.shape != "cylinder") return "--rims follow is for --shape cylinder; leave it out or change the shape";
    if (arguments.known.any() || arguments.partial || !arguments.grid.empty() || !arguments.write_grid.empty() ||
        !arguments.turned_over.empty() || !arguments.raised.empty())
      return "--rims follow does not go with a grid, a second pose, symmetry or what is held; leave them or it out";
  }
  if (!arguments.grid.empty())
    for (const char* fixed : {"--shape", "--split-above", "--split-below", "--centre-z", "--axis", "--degree",
                              "--knots", "--write-grid", "--turned-over", "--raised"})
      if (arguments.names(fixed)) return std::string(fixed) + " does not go with --grid, which fixes it; leave it out";
  if (!arguments.write_grid.empty() && !(arguments.turned_over.empty() && arguments.raised.empty()))
    return "--write-grid is for one pose of an object; leave --turned-over and --raised out";
  if (!arguments.turned_over.empty() && !arguments.raised.empty())
    return "--turned-over and --raised are each for a second file; leave one of them out";
  const bool logged_lift = !arguments.raised.empty() && !arguments.lift_mm && is_profile_log(arguments.raised);
  if ((arguments.raised.empty() == arguments.lift_mm.has_value() && !logged_lift) ||
      (arguments.lift_exact && arguments.raised.empty()))
    return "--raised and --lift go together: the file, and how far the lift had raised the object for it";
  if (arguments.centre_z_mm && !sphere) return "--centre-z is for --shape sphere; leave it out or change the shape";
  if ((split || !arguments.shoulders_mm.empty()) && arguments.shape != "composite")
    return "--split-above, --split-below and --shoulders are for --shape composite; leave them out or change the shape";
  if (!std::is_sorted(arguments.shoulders_mm.begin(), arguments.shoulders_mm.end(), std::less_equal<>()))
    return "--shoulders takes heights from below, each once; put them in order";
  if (arguments.shape == "composite" || arguments.shape == "auto") return {};
  if (arguments.model == (sphere ? "cylinder" : "sphere"))
    return "--model " + arguments.model + " does not go with --shape " + arguments.shape + "; ask for --model " +
           arguments.shape;
  return {};
}

// On a grid file: the sums of the input, or its surface.
int fit_with_grid(const FitArguments& arguments) {
  std::optional<std::string> unit;
  if (arguments.names("--unit")) unit = arguments.unit;
  const auto outputs =
      output_files(arguments.partial ? std::vector<std::string>{} : arguments.outputs, arguments.report);
  if (!outputs) return fail(2, outputs.error());
  StopWatch watch;
  auto input = open_on_grid(arguments.input, arguments.grid, unit);
  if (!input) return fail(2, input.error());
  if (arguments.partial) return write_part(*input, arguments.input, arguments.outputs.front());
  RangeFitOptions options = fit_options(arguments);
  const auto constraints = constraints_of(arguments.known);
  if (!constraints) return fail(2, constraints.error());
  options.constraints = *constraints;
  const auto fitted = fit_on_grid(*input, options);
  if (!fitted) return fail(2, "'" + arguments.input + "': " + fitted.error());
  ResultNotes notes;
  notes.name = arguments.name.empty() ? std::filesystem::path(arguments.input).stem().string() : arguments.name;
  notes.date = arguments.date;
  notes.seconds.push_back({"fit", watch.lap()});
  ResultOptions files;
  files.ap214 = arguments.ap214;
  files.chord_mm = arguments.chord_mm;
  return finish(
      std::span(&*fitted, 1), *outputs, notes, files, [&] { return report_json(*fitted, notes); }, watch,
      arguments.input, arguments.json);
}

// A grid about the axis, and the centre, that the fit has found.
int write_grid(const FitArguments& arguments, const BodyFit& fitted, const CloudOptions& cloud) {
  if (fitted.pieces().size() > 1)
    return fail(2,
                "a composite has a grid for every piece, and --write-grid writes one; name --shape cylinder or sphere");
  const BaseSurface& base = fitted.pieces().front().function.base();
  RangeFitOptions options = fit_options(arguments);
  options.base = base.kind;
  const auto grid =
      choose_sums_grid(arguments.input, frame_about(cloud.axis) * base.X_WB, cloud.millimetres_per_unit, options);
  if (!grid) return fail(2, "'" + arguments.input + "': " + grid.error());
  const auto written = write_file_atomically(arguments.write_grid, format_grid(*grid));
  if (!written) return fail(4, written.error().message);
  std::printf("%s\n  grid        %d x %d intervals over a %s\n  wrote       %s\n", arguments.input.c_str(),
              grid->cells.z_intervals, grid->cells.arcs.count() * grid->cells.intervals_per_arc,
              base.spherical() ? "sphere" : "cylinder", arguments.write_grid.c_str());
  return 0;
}

// What the log of a scan says besides its samples.
tl::expected<void, std::string> take_log(const LogHeader& header, RangeFitOptions& options, ResultNotes& notes) {
  const auto calibration = parse_calibration(header.calibration, "the calibration in it");
  if (!calibration) return tl::make_unexpected(calibration.error().message);
  options.systematic_mm = calibration->systematic_mm;
  notes.name = header.request.name;
  std::replace(notes.name.begin(), notes.name.end(), ' ', '_');
  notes.date = header.date;
  notes.machine = header.machine;
  notes.simulated = header.simulated || calibration->simulated;
  return {};
}

int fit(const FitArguments& arguments) {
  if (const std::string wrong = contradiction(arguments); !wrong.empty()) return fail(2, wrong);
  if (!arguments.grid.empty()) return fit_with_grid(arguments);
  const auto outputs = output_files(arguments.outputs, arguments.report);
  if (!outputs) return fail(2, outputs.error());
  RangeFitOptions options = fit_options(arguments);
  const auto constraints = constraints_of(arguments.known);
  if (!constraints) return fail(2, constraints.error());
  options.constraints = *constraints;

  StopWatch watch;
  ResultNotes notes;
  notes.name.clear();  // as the log of a scan names it, or the file
  CloudOptions cloud;
  cloud.axis = arguments.axis == "x" ? Axis::x : arguments.axis == "y" ? Axis::y : Axis::z;
  const auto unit = millimetres_per_unit(arguments.unit);
  if (!unit) return fail(2, unit.error());
  cloud.millimetres_per_unit = *unit;
  auto input = FitInput::open(arguments.input, cloud);
  if (!input) return fail(2, input.error());
  if (const LogFile* log = input->log()) {
    if (arguments.names("--unit"))
      return fail(2, "'" + arguments.input + "' is the log of a scan, in millimetres; leave --unit out");
    if (const auto taken = take_log(log->header(), options, notes); !taken)
      return fail(2, "'" + arguments.input + "': " + taken.error());
  }
  const bool native = input->columns() != CloudColumns::cartesian;
  if (native && cloud.axis != Axis::z)
    return fail(2, "'" + arguments.input + "' holds samples about the scanner's axis, which is z; leave --axis " +
                       arguments.axis + " out, or name auto for the shape's own");
  if (arguments.axis == "auto" && (arguments.axis_named || !native)) {
    const auto own = input->own_frame();
    if (!input->error().empty()) return fail(2, input->error());
    if (!own && arguments.axis_named) return fail(2, "'" + arguments.input + "': " + own.error());
    if (const std::string why = own ? reason_for_z(*own) : own.error(); arguments.axis_named || why.empty()) {
      notes.own_axis = *own;
      notes.warnings = own->warnings;
      if (auto placed = input->place(own->X_SL); !placed) return fail(2, placed.error());
    } else if (!own || !on_z(*own)) {
      notes.warnings.push_back("The axis is the file's z axis: " + why + ". Name another with --axis.");
    }
    notes.seconds.push_back({"axis", watch.lap()});
  }

  const auto problem = [&](const std::string& why) {
    const std::string axis = notes.warnings.empty() || notes.own_axis ? "" : " (" + notes.warnings.front() + ")";
    return fail(2, "'" + arguments.input + "': " + why + axis);
  };
  const auto lap = [&](const char* stage) { notes.seconds.push_back({stage, watch.lap()}); };
  const std::size_t warnings_before = notes.warnings.size();
  const auto fit_as_it_lies = [&]() -> tl::expected<BodyFit, std::string> {
    notes.warnings.resize(warnings_before);  // a fit that is made again says all of its own again
    // Heights along the axis that the fit is about.
    std::vector<std::unique_ptr<WindowStream>> windows;
    std::vector<ProfileStream*> parts(input->parts().begin(), input->parts().end());
    for (ProfileStream*& part : parts) {
      if (arguments.heights.empty()) continue;
      part =
          windows.emplace_back(std::make_unique<WindowStream>(*part, arguments.heights[0], arguments.heights[1])).get();
    }
    JoinedStream samples(parts);
    const bool about_origin = input->columns() == CloudColumns::spherical && !notes.own_axis;
    const auto shape = shape_of(arguments, samples, about_origin);
    if (!shape) return tl::make_unexpected(shape.error());
    notes.shape_reason = shape->reason;
    if (!shape->reason.empty()) lap("shape");
    const auto arcs = angles_of(arguments.angles, samples);
    if (!arcs) return tl::make_unexpected(arcs.error());
    options.arcs = *arcs;
    FitSetting setting{.X_WL = notes.own_axis ? notes.own_axis->X_SL : Eigen::Isometry3d::Identity(),
                       .off_centre_rule = native && !arguments.axis_named && arguments.turned_over.empty(),
                       .symmetry = symmetry_of(arguments.known),
                       .follow_rims = arguments.rims == "follow",
                       .lap = lap};
    return fit_shape(*shape, samples, parts, options, setting, notes);
  };
  // With the second set where it nearly is; its pose and the surface of both together; all of it again.
  const auto refined = [&](tl::expected<BodyFit, std::string>& fit, PoseFreedom freedom) -> std::optional<std::string> {
    if (!fit) return std::nullopt;
    if (fit->wall() == nullptr) return "a sphere shows no wall by which the pose of the second file could be refined";
    const auto joint = input->refine_second(fit->wall()->function, freedom, fit->wall()->report.noise_mm);
    if (!joint) return joint.error();
    if (notes.turned_over) {
      notes.turned_over->shift_sd_mm = joint->shift_sd_mm;
      notes.turned_over->turn_sd_rad = joint->turn_sd_rad;
    } else {
      notes.raised->lift_mm -= joint->X_12.translation().z();
      notes.raised->sd_mm = joint->shift_sd_mm;
    }
    lap("pose");
    fit = fit_as_it_lies();
    return std::nullopt;
  };
  if (!arguments.raised.empty()) {
    if (auto added = input->add_raised(arguments.raised, arguments.lift_mm.value_or(0)); !added)
      return fail(2, added.error());
    notes.raised = RaisedPose{arguments.lift_mm.value_or(0), arguments.lift_mm.value_or(0), 0};
  }
  auto fitted = fit_as_it_lies();
  if (!arguments.raised.empty() && !arguments.lift_exact)
    if (const auto why = refined(fitted, PoseFreedom::along_axis)) return fail(2, *why);
  if (fitted && !arguments.turned_over.empty()) {
    if (fitted->wall() == nullptr) return problem("a sphere shows no wall by which its other pose could be found");
    const auto pose = input->add_turned_over(arguments.turned_over, fitted->wall()->function, notes.own_axis);
    if (!pose) return fail(2, pose.error());
    notes.turned_over = *pose;
    lap("pose");
    fitted = fit_as_it_lies();
    if (const auto why = refined(fitted, PoseFreedom::all)) return fail(2, *why);
  }
  // All samples know the axis better than the few that it was found from.
  const auto better = fitted && notes.own_axis && arguments.model == "auto" ? fitted->better_axis() : std::nullopt;
  if (better) {
    const ResultNotes first = notes;
    notes.own_axis->X_SL = first.own_axis->X_SL * *better;
    if (auto placed = input->place(notes.own_axis->X_SL); !placed) return fail(2, placed.error());
    auto again = fit_as_it_lies();
    if (again && again->wall_is_round()) {
      fitted = std::move(again);
    } else {
      auto seconds = std::move(notes.seconds);
      notes = first;
      notes.seconds = std::move(seconds);
    }
  }
  if (!input->error().empty()) return fail(2, input->error());
  if (!fitted && input->skipped() > 0) {
    return problem(fitted.error() + " (" + std::to_string(input->skipped()) +
                   " points have NaN or infinite coordinates and do not count)");
  }
  if (!fitted && arguments.angles.empty() && !covered_angles(even_points(input->samples(), kAnglePoints)).closed())
    return problem(fitted.error() + ". A part of the turn alone is fitted with --angles auto");
  if (!fitted) return problem(fitted.error());
  if (!arguments.write_grid.empty()) return write_grid(arguments, *fitted, cloud);

  if (!arguments.name.empty() || notes.name.empty())
    notes.name = arguments.name.empty() ? std::filesystem::path(arguments.input).stem().string() : arguments.name;
  if (!arguments.date.empty()) notes.date = arguments.date;
  if (const LogFile* log = input->log())
    if (const std::string ending = log->ending(); !ending.empty()) notes.warnings.push_back(ending);
  if (input->skipped() > 0) {
    notes.warnings.push_back(std::to_string(input->skipped()) +
                             " points of the file have NaN or infinite coordinates and were skipped");
  }
  ResultOptions files;
  files.ap214 = arguments.ap214;
  files.chord_mm = arguments.chord_mm;
  return finish(
      fitted->pieces(), *outputs, notes, files, [&] { return fitted->report(notes); }, watch, arguments.input,
      arguments.json);
}

}  // namespace

void add_fit_command(CLI::App& program, Run& run) {
  auto arguments = std::make_shared<FitArguments>();
  auto* command = program.add_subcommand(
      "fit",
      "Fit an exact NURBS surface to a point cloud (PLY, PCD, XYZ, CSV), to native samples\n"
      "(CSV with the header r,theta,z or rho,phi,theta: mm and radians) or to the log of a scan\n"
      "(profiles.log of the daemon's store). The axis is the body's own;\n"
      "where it shows none, and if --axis names one, an axis of the file through its origin.");
  command->option_defaults()->always_capture_default();
  command->add_option("INPUT", arguments->input, "file to read")->required();
  command->add_option(
      "--turned-over", arguments->turned_over,
      "file of the same object upside down, for its other end: how it lies is found from what both show");
  command->add_option("--raised", arguments->raised,
                      "file of the same object at another height of the lift; what both show refines --lift");
  command
      ->add_option("--lift", arguments->lift_mm,
                   "how far the lift had raised the object for --raised [mm]; in logs beyond what they say themselves")
      ->check(finite());
  command->add_flag("--lift-exact", arguments->lift_exact, "take --lift as it is");
  command
      ->add_option("-o,--output", arguments->outputs,
                   "files to write, by their endings: .step, .stl, .ply, .json (surface), .svg (picture of the "
                   "errors), report.json")
      ->expected(1, -1);
  command->add_option("--report", arguments->report, "write the report as JSON to this file");
  command
      ->add_option(
          "--shape", arguments->shape,
          "base geometry; composite: a body over a cylinder, or several with plane shoulders between them, with heads "
          "over\nspheres; auto: what the samples ask for")
      ->check(CLI::IsMember({"cylinder", "sphere", "composite", "auto"}));
  command->add_option(
      "--split-above", arguments->split_above_mm,
      "height at which a composite's body ends and its upper head begins [mm]; default: where the samples "
      "ask for it");
  command->add_option("--split-below", arguments->split_below_mm, "the same of a lower head [mm]");
  command
      ->add_option("--shoulders", arguments->shoulders_mm,
                   "heights of the plane shoulders between a composite's walls, from below [mm]; default: where the "
                   "samples show them")
      ->expected(1, 15)
      ->check(finite());
  command->add_option(
      "--centre-z", arguments->centre_z_mm,
      "height of the sphere's centre on the axis [mm]; default: where the samples lie best about it, 0 of\n"
      "native samples rho,phi,theta");
  add_model_options(*command, arguments->model, arguments->tolerance_mm, arguments->form_tolerance_mm,
                    arguments->space);
  add_constraint_options(*command, arguments->known);
  command
      ->add_option(
          "--angles", arguments->angles,
          "part of the turn to fit, counter-clockwise: FROM TO [degrees], or auto: what the samples cover; the "
          "surface\nis open around then, a shell in CAD files")
      ->expected(1, 2);
  command
      ->add_option(
          "--heights", arguments->heights,
          "fit what lies between two heights along the axis alone: FROM TO [mm]; 0 is where the report's frame "
          "has its origin")
      ->expected(2)
      ->check(finite());
  command
      ->add_option("--rims", arguments->rims,
                   "ends of a body over a cylinder: plane, across the axis where the samples end first; or follow, as "
                   "the\nsamples end all around")
      ->check(CLI::IsMember({"plane", "follow"}));
  command
      ->add_option(
          "--axis", arguments->axis,
          "axis of the file that is the rotary axis; auto: the shape's own, wherever it is (of native samples the\n"
          "scanner's, unless the part is round about another; named, its own in any case)")
      ->check(CLI::IsMember({"x", "y", "z", "auto"}));
  command->add_option("--unit", arguments->unit, "unit of length of the file: um, mm, cm, m, in");
  command
      ->add_option("--fair", arguments->fair_mm,
                   "fair the surface as far as 95 % of it stays within this distance of the fit [mm]; 0: not at all")
      ->check(not_negative());
  command->add_option("--degree", arguments->degree, "degrees of the range function along z and theta, 1 to 5")
      ->expected(2)
      ->check(CLI::Range(1, 5));
  command
      ->add_option("--knots", arguments->knots,
                   "fixed numbers of intervals along z and per quarter turn, powers of two")
      ->expected(2)
      ->check(CLI::Range(1, 1024));
  command->add_option("--grid", arguments->grid,
                      "fit on this grid file, which fixes frame, shape, unit and knots; see daemon/PARTIAL_SUMS.md");
  command->add_flag("--partial", arguments->partial,
                    "with --grid: write the input's sums alone (-o FILE.part), for celadon merge");
  command->add_option("--write-grid", arguments->write_grid,
                      "choose a grid for this and other inputs of the same object, write it and stop");
  command->add_option("--chord", arguments->chord_mm, "chord tolerance of meshes [mm]; 0: 1e-4 of the size")
      ->check(not_negative());
  command->add_option("--name", arguments->name, "name of the part in the files; default: that of the input");
  command->add_option("--date", arguments->date, "date in the files, ISO 8601 UTC; default: none");
  command->add_flag("--ap214", arguments->ap214, "STEP AP214 instead of AP242");
  command->add_flag("--json", arguments->json, "print the report as one line of JSON instead of text");
  command->callback([arguments, command, &run] {
    for (const CLI::Option* option : command->get_options())
      if (option->count() > 0) arguments->named.push_back(option->get_name());
    arguments->axis_named = arguments->names("--axis");
    run = [arguments] { return fit(*arguments); };
  });
}

}  // namespace celadon::cli
