#pragma once
// An artefact's measurement against its certificate and the scanner's maximum permissible errors, in the manner of ISO
// 10360-3 and VDI/VDE 2634-3. Source: README.md, "Acceptance"; file: RESULTS.md, "acceptance.json".

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "daemon/checks/artefact.h"
#include "daemon/checks/artefact_measurement.h"
#include "daemon/profile_log.h"

namespace celadon {

/// By the rule of ISO 14253-1: an error conforms, or does not, where its expanded uncertainty leaves no doubt.
enum class AcceptanceVerdict : std::uint8_t {
  not_judged,  ///< no maximum permissible error is stated
  conforms,
  undecided,
  not_verifiable,  ///< the samples cannot show it; never to be taken for conforming
  does_not_conform
};
/// "not judged", "conforms", "undecided", "not verifiable", "does not conform"
const char* to_string(AcceptanceVerdict verdict);

/// One characteristic of one ball, pair of balls or flat; lengths in mm.
struct AcceptanceItem {
  Characteristic what = Characteristic::size;
  std::string where;  ///< "A", "A-B", "flat"
  double measured = 0, certified = 0;
  double u_scatter = 0, u_calibration = 0, u_certificate = 0;  ///< standard uncertainties of the error
  std::optional<double> permissible;
  AcceptanceVerdict verdict = AcceptanceVerdict::not_judged;
  std::string note;  ///< of not verifiable: why

  double error() const { return measured - certified; }
  double u() const;
  double U() const { return 2 * u(); }  ///< expanded, k = 2
};

struct Acceptance {
  Artefact artefact;
  ArtefactMeasurement measurement;
  std::vector<AcceptanceItem> items;
  std::vector<std::string> findings;  ///< what errors have in common, or which stands apart, each with its remedy

  /// The worst of its items'.
  AcceptanceVerdict verdict() const;
  /// Nothing that is judged is in doubt or beyond its limit, and nothing is hidden.
  bool passed() const { return verdict() <= AcceptanceVerdict::conforms; }
};

Acceptance judge_acceptance(const Artefact& artefact, const ArtefactMeasurement& measurement);

/// Errors beyond three standard uncertainties: a scale that all spacings share, what all diameters share, and what
/// stands apart from the others (acceptance_findings.cpp).
std::vector<std::string> acceptance_findings(const Acceptance& acceptance);

/// A table for a terminal.
std::string acceptance_text(const Acceptance& acceptance);
/// Text of acceptance.json. @param scan  of the samples; `calibration_date` of the calibration they were taken with
std::string format_acceptance(const Acceptance& acceptance, const LogHeader& scan, const std::string& calibration_date);

}  // namespace celadon
