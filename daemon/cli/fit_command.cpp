// celadon fit: a cloud or native samples to an exact surface and its files.

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <variant>

#include <CLI/CLI.hpp>

#include "daemon/cli/commands.h"
#include "daemon/cli/summary.h"
#include "daemon/files/atomic_file.h"
#include "daemon/files/cloud_files.h"
#include "daemon/report.h"
#include "daemon/results.h"
#include "daemon/usage_error.h"
#include "fitting/composite_fit.h"
#include "fitting/even_points.h"
#include "fitting/local_frame.h"
#include "fitting/own_frame.h"
#include "fitting/range_fit.h"
#include "fitting/shape_choice.h"
#include "fitting/spherical_stream.h"

namespace celadon::cli {
namespace {

struct FitArguments {
  std::string input, axis = "auto", unit = "mm", shape = "cylinder", model = "auto", space = "curvature", name, date,
                     report;
  std::vector<std::string> outputs;
  double tolerance_mm = 0, form_tolerance_mm = -1, chord_mm = 0;
  std::optional<double> centre_z_mm, split_above_mm, split_below_mm;
  std::vector<int> degree = {3, 3}, knots;
  bool axis_named = false, ap214 = false, json = false;
};

class StopWatch {
 public:
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - began_).count();
    began_ = now;
    return seconds;
  }

 private:
  std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
};

SurfaceModel model_from(const std::string& text) {
  for (const auto model :
       {SurfaceModel::cylinder, SurfaceModel::revolution, SurfaceModel::translational, SurfaceModel::general}) {
    if (text == to_string(model) || text == to_string(model, BaseKind::sphere)) return model;
  }
  return SurfaceModel::automatic;
}

RangeFitOptions fit_options(const FitArguments& arguments) {
  RangeFitOptions options;
  options.model = model_from(arguments.model);
  options.tolerance_mm = arguments.tolerance_mm;
  if (arguments.form_tolerance_mm >= 0) options.form_tolerance_mm = arguments.form_tolerance_mm;
  options.degree_u = arguments.degree[0];
  options.degree_v = arguments.degree[1];
  if (!arguments.knots.empty()) {
    options.z_intervals = arguments.knots[0];
    options.intervals_per_arc = arguments.knots[1];
  }
  options.continuity = arguments.space == "thesis" ? JointContinuity::thesis : JointContinuity::curvature;
  return options;
}

// From an even sample of the file, in the file's frame.
tl::expected<LocalFrame, std::string> own_frame(ProfileStream& samples) {
  auto frame = local_frame(even_points(samples, 12000));
  if (!frame) return tl::make_unexpected(frame.error().message);
  return *frame;
}

// The file's z axis, as far as the samples can tell.
bool on_z(const LocalFrame& own) {
  constexpr double kSigmas = 3, kRounding = 1e-6;
  const Eigen::Vector3d k = own.X_SL.linear().col(2), o = own.X_SL.translation();
  const double tilt = k.head<2>().norm(), beside = (o - k * (o.z() / std::max(k.z(), 0.5))).head<2>().norm();
  return k.z() > 0 && (own.shape == FrameShape::sphere || tilt <= std::max(kRounding, kSigmas * own.axis_sd_rad)) &&
         beside <= std::max(kRounding * std::max(1.0, o.norm()), kSigmas * own.origin_sd_mm);
}

// Why an axis that nobody asked for is not taken; empty: it is.
std::string reason_for_z(const LocalFrame& own) {
  constexpr double kInliers = 0.8, kAxisRad = 0.02;
  char text[200] = "";
  if (on_z(own)) return "the body's own axis is the same within its uncertainty";
  const bool any_axis = own.shape == FrameShape::sphere;  // it has a centre
  if (own.inliers < kInliers || own.shape == FrameShape::elliptic || (!any_axis && !(own.axis_sd_rad <= kAxisRad))) {
    std::snprintf(text, sizeof text, "the body shows no axis of its own well enough (%s, %.0f %% of the points on it)",
                  to_string(own.shape), 100 * own.inliers);
  }
  return text;
}

// A fit of samples in a local frame as a surface in the frame outside.
void place(RangeFit& fitted, const Eigen::Isometry3d& X_WL) {
  const RangeFunction& f = fitted.function;
  BaseSurface base = f.base();
  base.X_WB = X_WL * base.X_WB;
  fitted.function = RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
  fitted.surface = symbolic_product(fitted.function);
}

// A fit of one piece or of several.
struct BodyFit {
  std::variant<RangeFit, CompositeFit> fit;
  std::span<const RangeFit> pieces() const {
    if (const auto* one = std::get_if<RangeFit>(&fit)) return {one, 1};
    return std::get<CompositeFit>(fit).pieces;
  }
  nlohmann::ordered_json report(const ResultNotes& notes) const {
    return std::visit([&](const auto& of) { return report_json(of, notes); }, fit);
  }
};

// The shape as it was named, or as the samples want it; what was not named of it comes from the samples.
tl::expected<ShapeChoice, std::string> shape_of(const FitArguments& arguments, CloudFile& samples,
                                                bool in_frame_of_file) {
  ShapeChoice named;
  const auto choose = [&](std::optional<BodyShape> wanted) -> tl::expected<ShapeChoice, std::string> {
    auto choice = choose_shape(samples, wanted);
    if (!choice) return tl::make_unexpected(choice.error().message);
    return *choice;
  };
  if (arguments.shape == "auto") return choose(std::nullopt);
  if (arguments.shape == "composite") {
    named.shape = BodyShape::composite;
    named.split = {.below_mm = arguments.split_below_mm, .above_mm = arguments.split_above_mm};
    return named.split.below_mm || named.split.above_mm ? named : choose(BodyShape::composite);
  }
  if (arguments.shape == "sphere") {
    named.shape = BodyShape::sphere;
    const bool about_origin = samples.columns() == CloudColumns::spherical && in_frame_of_file;
    named.centre_z_mm = arguments.centre_z_mm.value_or(about_origin ? 0 : centre_on_axis_mm(samples));
    if (!std::isfinite(named.centre_z_mm))
      return tl::make_unexpected("the samples lie at one height and show no centre; name one with --centre-z");
  }
  return named;
}

// In the frame outside; `lap` ends a stage.
tl::expected<BodyFit, std::string> fit_shape(const ShapeChoice& shape, ProfileStream& samples, RangeFitOptions options,
                                             const Eigen::Isometry3d& X_WL, bool off_centre_rule, ResultNotes& notes,
                                             const std::function<void(const char* stage)>& lap) {
  if (shape.shape == BodyShape::composite) {
    auto composite = fit_composite(samples, shape.split, options);
    if (!composite) return tl::make_unexpected(composite.error().message);
    for (RangeFit& piece : composite->pieces) place(piece, X_WL);
    lap("fit");
    return BodyFit{std::move(*composite)};
  }
  SphericalStream spherical(samples, shape.centre_z_mm);
  const bool sphere = shape.shape == BodyShape::sphere;
  ProfileStream& stream = sphere ? static_cast<ProfileStream&>(spherical) : samples;
  options.base = sphere ? BaseKind::sphere : BaseKind::cylinder;
  const auto grid = choose_grid(stream, options);
  if (!grid) return tl::make_unexpected(grid.error().message);
  lap("read");
  const GatheredSamples gathered = gather(stream, *grid);
  lap("accumulate");
  ProfileStream* const whole[] = {&stream};
  auto surface = fit_surface(gathered.sums, gathered.look, whole, options);
  if (!surface) return tl::make_unexpected(surface.error().message);
  if (auto own = off_centre_rule ? fit_in_own_frame(*surface, gathered.look, whole, options) : std::nullopt) {
    notes.about_scanner_axis = surface->fit.report;
    notes.own_axis = own->frame;
    notes.warnings.insert(notes.warnings.end(), own->frame.warnings.begin(), own->frame.warnings.end());
    lap("axis");
    return BodyFit{measure_errors(std::move(own->surface), own->samples.streams())};
  }
  RangeFit fitted = measure_errors(std::move(*surface), whole);
  Eigen::Isometry3d X_WB = X_WL;
  if (sphere) X_WB.translate(Eigen::Vector3d(0, 0, shape.centre_z_mm));
  if (!X_WB.matrix().isIdentity(0)) place(fitted, X_WB);
  lap("fit");
  return BodyFit{std::move(fitted)};
}

// What the options say together; empty: nothing is wrong.
std::string contradiction(const FitArguments& arguments) {
  const bool sphere = arguments.shape == "sphere";
  const bool split = arguments.split_above_mm || arguments.split_below_mm;
  if (arguments.centre_z_mm && !sphere) return "--centre-z is for --shape sphere; leave it out or change the shape";
  if (split && arguments.shape != "composite")
    return "--split-above and --split-below are for --shape composite; leave them out or change the shape";
  if (arguments.shape == "composite" || arguments.shape == "auto") return {};
  if (arguments.model == (sphere ? "cylinder" : "sphere"))
    return "--model " + arguments.model + " does not go with --shape " + arguments.shape + "; ask for --model " +
           arguments.shape;
  return {};
}

int fit(const FitArguments& arguments) {
  if (const std::string wrong = contradiction(arguments); !wrong.empty()) return fail(2, wrong);
  // Outputs are checked before hours of work, not after.
  std::vector<std::pair<ResultFormat, std::filesystem::path>> outputs;
  for (const auto& output : arguments.outputs) {
    const auto format = result_format_of(output);
    if (!format) {
      return fail(2, "'" + output + "' has no known ending; use .step, .stl, .ply, surface.json or report.json");
    }
    const auto folder = std::filesystem::absolute(output).parent_path();
    if (!std::filesystem::is_directory(folder)) {
      return fail(2,
                  "'" + output + "' cannot be written: there is no folder '" + folder.string() + "'; create it first");
    }
    outputs.emplace_back(*format, output);
  }
  if (!arguments.report.empty()) outputs.emplace_back(ResultFormat::report_json, arguments.report);
  // The report comes last: it holds what the others found.
  std::stable_sort(outputs.begin(), outputs.end(), [](const auto& a, const auto& b) {
    return (a.first == ResultFormat::report_json) < (b.first == ResultFormat::report_json);
  });

  StopWatch watch;
  ResultNotes notes;
  CloudOptions cloud;
  cloud.axis = arguments.axis == "x" ? Axis::x : arguments.axis == "y" ? Axis::y : Axis::z;
  const auto unit = millimetres_per_unit(arguments.unit);
  if (!unit) return fail(2, unit.error());
  cloud.millimetres_per_unit = *unit;
  auto samples = open_cloud(arguments.input, cloud);
  if (!samples) return fail(2, samples.error().message);
  const bool native = (*samples)->columns() != CloudColumns::cartesian;
  if (arguments.axis == "auto" && (arguments.axis_named || !native)) {
    const auto own = own_frame(**samples);
    if (!(*samples)->error().empty()) return fail(2, (*samples)->error());
    if (!own && arguments.axis_named) return fail(2, "'" + arguments.input + "': " + own.error());
    if (const std::string why = own ? reason_for_z(*own) : own.error(); arguments.axis_named || why.empty()) {
      notes.own_axis = *own;
      notes.warnings = own->warnings;
      cloud.X_SF = own->X_SL.inverse();
      samples = open_cloud(arguments.input, cloud);
      if (!samples) return fail(2, samples.error().message);
    } else if (!own || !on_z(*own)) {
      notes.warnings.push_back("The axis is the file's z axis: " + why + ". Name another with --axis.");
    }
    notes.seconds.push_back({"axis", watch.lap()});
  }

  const auto problem = [&](const std::string& why) { return fail(2, "'" + arguments.input + "': " + why); };
  const auto shape = shape_of(arguments, **samples, !notes.own_axis);
  if (!(*samples)->error().empty()) return fail(2, (*samples)->error());
  if (!shape) return problem(shape.error());
  notes.shape_reason = shape->reason;
  const auto lap = [&](const char* stage) { notes.seconds.push_back({stage, watch.lap()}); };
  if (!shape->reason.empty()) lap("shape");
  const Eigen::Isometry3d X_WL = notes.own_axis ? notes.own_axis->X_SL : Eigen::Isometry3d::Identity();
  auto fitted = fit_shape(*shape, **samples, fit_options(arguments), X_WL, native && !arguments.axis_named, notes, lap);
  if (!(*samples)->error().empty()) return fail(2, (*samples)->error());
  if (!fitted && (*samples)->skipped() > 0) {
    return problem(fitted.error() + " (" + std::to_string((*samples)->skipped()) +
                   " points have NaN or infinite coordinates and do not count)");
  }
  if (!fitted) return problem(fitted.error());

  notes.name = arguments.name.empty() ? std::filesystem::path(arguments.input).stem().string() : arguments.name;
  notes.date = arguments.date;
  if ((*samples)->skipped() > 0) {
    notes.warnings.push_back(std::to_string((*samples)->skipped()) +
                             " points of the file have NaN or infinite coordinates and were skipped");
  }
  ResultOptions files;
  files.ap214 = arguments.ap214;
  files.chord_mm = arguments.chord_mm;
  std::vector<FittedSurface> pieces;
  for (const RangeFit& piece : fitted->pieces())
    pieces.push_back({piece.function, piece.surface, piece.deviation ? &*piece.deviation : nullptr});
  for (const auto& [format, file] : outputs) {
    const auto written = format == ResultFormat::report_json ? write_report(fitted->report(notes), file)
                                                             : write_surface(pieces, format, file, notes, files);
    if (!written) return fail(written.error().exit_code, written.error().message);
    notes.seconds.push_back({to_string(format), watch.lap()});
  }
  const auto report = fitted->report(notes);
  if (arguments.json) {
    std::printf("%s\n", report.dump().c_str());
  } else {
    std::printf("%s\n%s", arguments.input.c_str(), summary_of(nlohmann::json(report)).c_str());
    for (const auto& [format, file] : outputs) std::printf("  wrote       %s\n", file.c_str());
  }
  return 0;
}

}  // namespace

void add_fit_command(CLI::App& program, Run& run) {
  auto arguments = std::make_shared<FitArguments>();
  auto* command =
      program.add_subcommand("fit",
                             "Fit an exact NURBS surface to a point cloud (PLY, PCD, XYZ, CSV) or to native samples\n"
                             "(CSV with the header r,theta,z or rho,phi,theta: mm and radians). The axis is the body's "
                             "own;\n"
                             "where it shows none, and if --axis names one, an axis of the file through its origin.");
  command->option_defaults()->always_capture_default();
  command->add_option("INPUT", arguments->input, "file to read")->required();
  command
      ->add_option("-o,--output", arguments->outputs,
                   "files to write, by their endings: .step, .stl, .ply, .json (surface), report.json")
      ->expected(1, -1);
  command->add_option("--report", arguments->report, "write the report as JSON to this file");
  command
      ->add_option(
          "--shape", arguments->shape,
          "base geometry; composite: a body over a cylinder with heads over spheres; auto: what the samples ask "
          "for")
      ->check(CLI::IsMember({"cylinder", "sphere", "composite", "auto"}));
  command->add_option(
      "--split-above", arguments->split_above_mm,
      "height at which a composite's body ends and its upper head begins [mm]; default: where the samples "
      "ask for it");
  command->add_option("--split-below", arguments->split_below_mm, "the same of a lower head [mm]");
  command->add_option(
      "--centre-z", arguments->centre_z_mm,
      "height of the sphere's centre on the axis [mm]; default: where the samples lie best about it, 0 of\n"
      "native samples rho,phi,theta");
  command->add_option("--model", arguments->model, "how general the surface is")
      ->check(CLI::IsMember({"auto", "cylinder", "sphere", "revolution", "translational", "general"}));
  command
      ->add_option(
          "--axis", arguments->axis,
          "axis of the file that is the rotary axis; auto: the shape's own, wherever it is (of native samples the\n"
          "scanner's, unless the part is round about another; named, its own in any case)")
      ->check(CLI::IsMember({"x", "y", "z", "auto"}));
  command->add_option("--unit", arguments->unit, "unit of length of the file: um, mm, cm, m, in");
  command
      ->add_option("--tolerance", arguments->tolerance_mm,
                   "refine until 95 % of the errors are below it [mm]; 0: what the data carry")
      ->check(not_negative());
  command
      ->add_option("--form-tolerance", arguments->form_tolerance_mm,
                   "deviation from a simpler form that is accepted [mm]; negative: 1e-9 of the size")
      ->check(finite());
  command->add_option("--degree", arguments->degree, "degrees of the range function along z and theta, 1 to 5")
      ->expected(2)
      ->check(CLI::Range(1, 5));
  command
      ->add_option("--knots", arguments->knots,
                   "fixed numbers of intervals along z and per quarter turn, powers of two")
      ->expected(2)
      ->check(CLI::Range(1, 1024));
  command
      ->add_option("--space", arguments->space,
                   "continuity at the meridians 0, 90, 180, 270 degrees: curvature, or as in the thesis")
      ->check(CLI::IsMember({"curvature", "thesis"}));
  command->add_option("--chord", arguments->chord_mm, "chord tolerance of meshes [mm]; 0: 1e-4 of the size")
      ->check(not_negative());
  command->add_option("--name", arguments->name, "name of the part in the files; default: that of the input");
  command->add_option("--date", arguments->date, "date in the files, ISO 8601 UTC; default: none");
  command->add_flag("--ap214", arguments->ap214, "STEP AP214 instead of AP242");
  command->add_flag("--json", arguments->json, "print the report as one line of JSON instead of text");
  command->callback([arguments, command, &run] {
    arguments->axis_named = command->get_option("--axis")->count() > 0;
    run = [arguments] { return fit(*arguments); };
  });
}

}  // namespace celadon::cli
