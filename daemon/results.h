#pragma once
// The files of a finished fit under their final names. Folder and files: RESULTS.md.

#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <tl/expected.hpp>

#include "daemon/body_fit.h"
#include "daemon/export/cad_client.h"
#include "daemon/report.h"
#include "fitting/range_fit.h"

namespace celadon {

enum class ResultFormat { step, stl, ply, surface_json, errors_svg, report_json };

/// "step", "stl", "ply", "surface.json", "errors.svg", "report.json".
const char* to_string(ResultFormat format);
std::optional<ResultFormat> result_format_from(std::string_view text);
/// By the end of a file name: .step .stp .stl .ply .svg; report.json and *.report.json; any other .json is a surface.
std::optional<ResultFormat> result_format_of(const std::filesystem::path& file);

struct ResultOptions {
  bool ap214 = false;                 ///< STEP AP242 otherwise
  double chord_mm = 0;                ///< of the meshes; 0: 1e-4 of the largest extent
  CadWorker* cad = nullptr;           ///< started ahead; nullptr: one is started for the file
  ProfileStream* coloured = nullptr;  ///< of write_results: samples with colours, for a cloud of them; nullptr: none
};

/// One sentence with file, cause and remedy; exit code 2 for a name that cannot be used, 4 otherwise.
struct ResultError {
  int exit_code = 4;
  std::string message;
};

/// A fit as it is put into files; its errors may still be measured while the first of them are written.
struct FittedSurface {
  const RangeFunction& function;
  const NurbsSurface& surface;
  const DeviationMap* deviation = nullptr;  ///< for surface.json, if it is known
};

/// Writes one file of a body of pieces, bottom to top: beside, synced, renamed. A STEP file sets notes.solid.
/// @pre format is neither errors_svg nor report_json; at least one piece
tl::expected<void, ResultError> write_surface(std::span<const FittedSurface> pieces, ResultFormat format,
                                              const std::filesystem::path& file, ResultNotes& notes,
                                              const ResultOptions& options = {});
/// The picture of measured errors, pieces bottom to top. `report` as report_json() makes it: of the whole body.
tl::expected<void, ResultError> write_errors(std::span<const RangeFit> pieces, const nlohmann::ordered_json& report,
                                             const std::filesystem::path& file);
/// `report` as report_json() makes it.
tl::expected<void, ResultError> write_report(const nlohmann::ordered_json& report, const std::filesystem::path& file);

/// Writes the files of `formats` (STEP first) and report.json into `folder`, which must not exist and appears whole or
/// not at all; where samples have colours, their cloud too (notes.coloured is set). `measured` gives the whole fit of
/// the same pieces; it is asked for when all files are there that do without. Stages "step", "files" and "errors"
/// (waited for them) are added to notes.seconds. @returns the names in `folder`
tl::expected<std::vector<std::string>, ResultError> write_results(
    std::span<const FittedSurface> pieces, const std::function<tl::expected<BodyFit, ResultError>()>& measured,
    const std::vector<ResultFormat>& formats, const std::filesystem::path& folder, ResultNotes& notes,
    const ResultOptions& options = {});

/// Of a scan to which no surface was fitted: its profiles.log (a link to the file where the disk can), the cloud of
/// `coloured` samples as above and report.json, into a folder as above.
/// @pre the log is finished  @returns the names in `folder`
tl::expected<std::vector<std::string>, ResultError> write_samples(const std::filesystem::path& log_file,
                                                                  std::uint64_t points,
                                                                  const std::filesystem::path& folder,
                                                                  ResultNotes& notes,
                                                                  ProfileStream* coloured = nullptr);

}  // namespace celadon
