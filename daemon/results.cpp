#include "daemon/results.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "daemon/files/atomic_file.h"
#include "daemon/files/error_picture.h"
#include "daemon/files/mesh_files.h"
#include "daemon/files/sample_cloud.h"
#include "daemon/surface_json.h"

namespace celadon {
namespace {

// A face that is less out of square than this is the disc across the axis.
constexpr double kSquare_rad = 1e-3;

constexpr ResultFormat kFormats[] = {ResultFormat::step,         ResultFormat::stl,        ResultFormat::ply,
                                     ResultFormat::surface_json, ResultFormat::errors_svg, ResultFormat::report_json};

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

std::string file_name(ResultFormat format, const std::string& name) {
  switch (format) {
    case ResultFormat::step:
      return name + ".step";
    case ResultFormat::stl:
      return name + ".stl";
    case ResultFormat::ply:
      return name + ".ply";
    case ResultFormat::surface_json:
      return "surface.json";
    case ResultFormat::errors_svg:
      return "errors.svg";
    case ResultFormat::report_json:
      break;
  }
  return "report.json";
}

// The wall ends on a face that was measured, and the disc that closes it there lies on the face.
bool is_face(const std::optional<FlatEnd>& face, const BaseSurface& base, bool upper) {
  if (!face || base.spherical() || base.heights) return false;
  const double end = upper ? base.band_end : base.band_start;
  return std::abs(end - face->height_mm) < 1e-9 && face->tilt_rad() < kSquare_rad;
}

std::string mesh_header(const ResultNotes& notes, double chord_mm, std::span<const RangeFunction* const> pieces) {
  char chord[32];
  std::snprintf(chord, sizeof chord, "%.4g", chord_mm);
  const BaseSurface &lowest = pieces.front()->base(), &highest = pieces.back()->base();
  const bool whole = lowest.spherical() && lowest.band_end == BaseSurface::kMeridianEnd && highest.spherical() &&
                     highest.band_start == 0;
  const bool measured = is_face(notes.flat_ends.lower, lowest, false) && is_face(notes.flat_ends.upper, highest, true);
  return std::string(notes.simulated ? "SIMULATED " : "") + "celadon " + notes.name + ", mm, chord tolerance " + chord +
         " mm" + (whole || measured ? "" : ", end discs assumed");
}

tl::unexpected<ResultError> not_written(const WriteError& error) {
  return tl::make_unexpected(ResultError{error.errno_value == ENOENT ? 2 : 4, error.message});
}

tl::expected<void, ResultError> put(const std::filesystem::path& file, std::string_view bytes) {
  if (auto written = write_file_atomically(file, bytes); !written) return not_written(written.error());
  return {};
}

/// The cloud of coloured samples, if there is one: its name goes to `names`.
tl::expected<void, ResultError> put_coloured(ProfileStream* samples, const std::filesystem::path& folder,
                                             ResultNotes& notes, std::vector<std::string>& names) {
  if (samples == nullptr) return {};
  const std::string name = notes.name + "-samples.ply";
  const std::string header = std::string(notes.simulated ? "SIMULATED " : "") + "celadon " + notes.name +
                             ", samples, mm, colours of the camera, black: not known";
  auto cloud = write_coloured_samples(*samples, header, folder / name);
  if (!cloud) return not_written(cloud.error());
  notes.coloured = cloud->coloured;
  if (cloud->coloured > 0) names.push_back(name);
  return {};
}

tl::unexpected<ResultError> system_error(const std::string& what, const std::filesystem::path& path, int code) {
  return tl::make_unexpected(
      ResultError{code == ENOENT ? 2 : 4, what + " " + path.string() + " failed: " + std::strerror(code) +
                                              (code == ENOSPC ? "; free space on that disk and fit the log again."
                                                              : "; check the path and its permissions.")});
}

int sync_folder(const std::filesystem::path& folder) {
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return errno;
  const int code = ::fsync(fd) == 0 ? 0 : errno;
  ::close(fd);
  return code;
}

/// A folder that appears whole under its name or not at all: made beside, and removed on every way out that does not
/// publish it.
class StagedFolder {
 public:
  static tl::expected<StagedFolder, ResultError> begin(const std::filesystem::path& folder) {
    std::error_code code;
    if (std::filesystem::exists(folder, code)) {
      return tl::make_unexpected(
          ResultError{2, "The result folder " + folder.string() + " exists already; name another one or remove it."});
    }
    StagedFolder staged(folder);
    std::filesystem::remove_all(staged.path_, code);  // of a run that was killed
    if (!std::filesystem::create_directories(staged.path_, code) && code) {
      return system_error("Creating", staged.path_, code.value());
    }
    return staged;
  }
  StagedFolder(StagedFolder&& other) noexcept
      : folder_(std::move(other.folder_)), path_(std::move(other.path_)), kept_(std::exchange(other.kept_, true)) {}
  StagedFolder& operator=(StagedFolder&&) = delete;
  ~StagedFolder() {
    std::error_code ignored;
    if (!kept_) std::filesystem::remove_all(path_, ignored);
  }

  const std::filesystem::path& path() const { return path_; }
  tl::expected<void, ResultError> publish() {
    if (const int failed = sync_folder(path_); failed != 0) return system_error("Syncing", path_, failed);
    if (::rename(path_.c_str(), folder_.c_str()) != 0) return system_error("Naming the result folder", folder_, errno);
    kept_ = true;
    std::error_code code;
    const auto parent = std::filesystem::absolute(folder_, code).parent_path();
    if (const int failed = sync_folder(parent); failed != 0) return system_error("Syncing", parent, failed);
    return {};
  }

 private:
  explicit StagedFolder(const std::filesystem::path& folder) : folder_(folder), path_(folder.string() + ".part") {}
  std::filesystem::path folder_, path_;
  bool kept_ = false;
};

}  // namespace

const char* to_string(ResultFormat format) {
  switch (format) {
    case ResultFormat::step:
      return "step";
    case ResultFormat::stl:
      return "stl";
    case ResultFormat::ply:
      return "ply";
    case ResultFormat::surface_json:
      return "surface.json";
    case ResultFormat::errors_svg:
      return "errors.svg";
    case ResultFormat::report_json:
      break;
  }
  return "report.json";
}

std::optional<ResultFormat> result_format_from(std::string_view text) {
  for (const ResultFormat format : kFormats) {
    if (text == to_string(format)) return format;
  }
  return std::nullopt;
}

std::optional<ResultFormat> result_format_of(const std::filesystem::path& file) {
  const std::string name = file.filename().string(), extension = file.extension().string();
  if (extension == ".step" || extension == ".stp") return ResultFormat::step;
  if (extension == ".stl") return ResultFormat::stl;
  if (extension == ".ply") return ResultFormat::ply;
  if (extension == ".svg") return ResultFormat::errors_svg;
  if (name == "report.json" || name.ends_with(".report.json")) return ResultFormat::report_json;
  if (extension == ".json") return ResultFormat::surface_json;
  return std::nullopt;
}

tl::expected<void, ResultError> write_surface(std::span<const FittedSurface> pieces, ResultFormat format,
                                              const std::filesystem::path& file, ResultNotes& notes,
                                              const ResultOptions& options) {
  switch (format) {
    case ResultFormat::step: {
      CadOptions cad;
      cad.bottom_measured = is_face(notes.flat_ends.lower, pieces.front().function.base(), false);
      cad.top_measured = is_face(notes.flat_ends.upper, pieces.back().function.base(), true);
      cad.ap214 = options.ap214;
      cad.name = notes.name;
      cad.simulated = notes.simulated;
      cad.date = notes.date;
      std::vector<NurbsSurface> walls;
      for (const FittedSurface& piece : pieces) walls.push_back(piece.surface);
      auto solid = options.cad != nullptr ? options.cad->write_step(walls, file, cad) : write_step(walls, file, cad);
      if (!solid) return tl::make_unexpected(ResultError{4, solid.error()});
      notes.solid = *solid;
      return {};
    }
    case ResultFormat::stl:
    case ResultFormat::ply: {
      std::vector<const RangeFunction*> ranges;
      for (const FittedSurface& piece : pieces) ranges.push_back(&piece.function);
      const double chord = options.chord_mm > 0 ? options.chord_mm : 1e-4 * size_of(ranges).maxCoeff();
      const TriangleMesh mesh = mesh_of(ranges, chord);
      const std::string header = mesh_header(notes, chord, ranges);
      return put(file, format == ResultFormat::stl ? binary_stl(mesh, header) : binary_ply(mesh, header));
    }
    case ResultFormat::surface_json: {
      SurfaceFile surface{{}, notes.name, notes.date, notes.simulated};
      for (const FittedSurface& piece : pieces)
        surface.pieces.push_back(
            {piece.function, piece.surface, piece.deviation ? std::optional(*piece.deviation) : std::nullopt});
      return put(file, format_surface_json(surface));
    }
    case ResultFormat::errors_svg:
    case ResultFormat::report_json:
      break;
  }
  throw std::invalid_argument("write_surface: errors and reports are no surfaces; see write_errors, write_report");
}

tl::expected<void, ResultError> write_errors(std::span<const RangeFit> pieces, const nlohmann::ordered_json& report,
                                             const std::filesystem::path& file) {
  std::vector<PieceErrors> errors;
  for (const RangeFit& piece : pieces) errors.push_back({piece.function.base(), piece.geometric_errors});
  const auto& e = report["geometric_mm"];
  char caption[240];
  std::snprintf(
      caption, sizeof caption,
      "mean distance of the samples from the surface, outward positive; samples: rms %.3g mm, 95 %% below %.3g mm",
      e["rms"].get<double>(), e["p95"].get<double>());
  const std::string title = (report["simulated"].get<bool>() ? "SIMULATED: " : "") + report["name"].get<std::string>() +
                            ", " + report["model"].get<std::string>();
  return put(file, error_picture(errors, title, caption));
}

tl::expected<void, ResultError> write_report(const nlohmann::ordered_json& report, const std::filesystem::path& file) {
  return put(file, format_report(report));
}

tl::expected<std::vector<std::string>, ResultError> write_results(
    std::span<const FittedSurface> pieces, const std::function<tl::expected<BodyFit, ResultError>()>& measured,
    const std::vector<ResultFormat>& formats, const std::filesystem::path& folder, ResultNotes& notes,
    const ResultOptions& options) {
  auto staged = StagedFolder::begin(folder);
  if (!staged) return tl::make_unexpected(staged.error());
  const std::filesystem::path& staging = staged->path();

  std::vector<std::string> names;
  auto start = std::chrono::steady_clock::now();
  const auto asked = [&](ResultFormat format) {
    return std::find(formats.begin(), formats.end(), format) != formats.end();
  };
  for (const ResultFormat format : {ResultFormat::step, ResultFormat::stl, ResultFormat::ply}) {
    if (!asked(format)) continue;  // the CAD file first: it is what is waited for
    names.push_back(file_name(format, notes.name));
    if (auto written = write_surface(pieces, format, staging / names.back(), notes, options); !written) {
      return tl::make_unexpected(written.error());
    }
    if (format == ResultFormat::step) {
      notes.seconds.push_back({"step", seconds_since(start)});
      start = std::chrono::steady_clock::now();
    }
  }
  if (auto coloured = put_coloured(options.coloured, staging, notes, names); !coloured)
    return tl::make_unexpected(coloured.error());
  notes.seconds.push_back({"files", seconds_since(start)});
  start = std::chrono::steady_clock::now();
  auto fit = measured();
  if (!fit) return tl::make_unexpected(fit.error());
  notes.seconds.push_back({"errors", seconds_since(start)});
  if (asked(ResultFormat::surface_json)) {
    names.push_back(file_name(ResultFormat::surface_json, notes.name));
    std::vector<FittedSurface> whole;
    for (const RangeFit& piece : fit->pieces())
      whole.push_back({piece.function, piece.surface, piece.deviation ? &*piece.deviation : nullptr});
    if (auto written = write_surface(whole, ResultFormat::surface_json, staging / names.back(), notes, options);
        !written) {
      return tl::make_unexpected(written.error());
    }
  }
  const auto report = fit->report(notes);
  names.push_back(file_name(ResultFormat::errors_svg, notes.name));
  if (auto written = write_errors(fit->pieces(), report, staging / names.back()); !written) {
    return tl::make_unexpected(written.error());
  }
  names.push_back(file_name(ResultFormat::report_json, notes.name));
  if (auto written = write_report(report, staging / names.back()); !written) {
    return tl::make_unexpected(written.error());
  }
  if (auto published = staged->publish(); !published) return tl::make_unexpected(published.error());
  return names;
}

tl::expected<std::vector<std::string>, ResultError> write_samples(const std::filesystem::path& log_file,
                                                                  std::uint64_t points,
                                                                  const std::filesystem::path& folder,
                                                                  ResultNotes& notes, ProfileStream* coloured) {
  auto staged = StagedFolder::begin(folder);
  if (!staged) return tl::make_unexpected(staged.error());
  const std::filesystem::path samples = staged->path() / "profiles.log";
  std::error_code code;
  std::filesystem::create_hard_link(log_file, samples, code);
  if (code) std::filesystem::copy_file(log_file, samples, code);
  if (code) return system_error("Copying the log to", samples, code.value());
  std::vector<std::string> names{samples.filename().string()};
  if (auto cloud = put_coloured(coloured, staged->path(), notes, names); !cloud)
    return tl::make_unexpected(cloud.error());
  names.push_back(file_name(ResultFormat::report_json, notes.name));
  if (auto written = write_report(report_json(points, notes), staged->path() / names.back()); !written) {
    return tl::make_unexpected(written.error());
  }
  if (auto published = staged->publish(); !published) return tl::make_unexpected(published.error());
  return names;
}

}  // namespace celadon
