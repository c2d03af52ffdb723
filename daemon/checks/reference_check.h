#pragma once
// The scan of a known object judged against its certificate. Source: README.md, "Known objects"; file: RESULTS.md,
// "check.json".

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>
#include <tl/expected.hpp>

#include "daemon/checks/reference.h"
#include "daemon/surface_json.h"

namespace celadon {

/// What was measured of a round object.
struct RoundMeasurement {
  double diameter_mm = 0;  ///< of the least-squares cylinder or sphere of the fitted surface
  double form_mm = 0;      ///< peak to valley of the fitted surface about that
  double fit_u_mm = 0;     ///< standard uncertainty of the surface's radius that the samples leave, its mean
};

/// The fitted surface as that shape: of a surface that is one, exactly it. Of a sphere the zone within 45 degrees of
/// its equator counts. Errors: one sentence.
tl::expected<RoundMeasurement, std::string> measure_round(const SurfaceFile& file, ReferenceShape shape);

enum class ReferenceVerdict : std::uint8_t { good, usable, refused };
/// "good", "usable", "refused"
const char* to_string(ReferenceVerdict verdict);

/// Largest values of each verdict; beyond `usable` the check is refused.
struct ReferenceLimits {
  double error_good = 1, error_usable = 1.5;        ///< normalised error En
  double form_good = 1, form_usable = 2;            ///< form in excess of the reference's, by what is expected of it
  double coarse_good = 1e-3, coarse_usable = 5e-3;  ///< expanded uncertainty of the diameter, relative
};

/// The judgement and all it is made of; lengths in mm, of diameters.
struct ReferenceCheck {
  Reference reference;
  RoundMeasurement measured;
  double calibration_u_mm = 0;             ///< standard uncertainty of a radius, as the calibration states it
  double U_mm = 0, U_reference_mm = 0;     ///< expanded, k = 2
  double difference_mm = 0;                ///< measured minus certified at the object's temperature
  double normalised_error = 0;             ///< |difference| / sqrt(U^2 + U_reference^2); at most 1: they agree
  double form_expected_mm = 0;             ///< of a perfect object, from noise and calibration
  std::vector<std::string> failed_checks;  ///< names, of the scan's own
  ReferenceLimits limits;
  ReferenceVerdict verdict = ReferenceVerdict::refused;
  std::vector<std::string> findings;  ///< why it is not good, each with its remedy
};

/// @param report  report.json of the scan; its fields `calibration` and `checks` are needed
tl::expected<ReferenceCheck, std::string> check_reference(const Reference& reference, const SurfaceFile& surface,
                                                          const nlohmann::json& report);

/// Text of check.json.
std::string format_check(const ReferenceCheck& check, const nlohmann::json& report);

}  // namespace celadon
