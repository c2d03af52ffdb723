#include "daemon/checks/acceptance.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include <nlohmann/json.hpp>

namespace celadon {
namespace {

constexpr const char* kManner =
    "in the manner of ISO 10360-3 and VDI/VDE 2634-3, judged by the rule of ISO 14253-1; a test, not a certificate";

std::string pair_name(const Artefact& artefact, const CertifiedSpacing& spacing) {
  return artefact.spheres[spacing.first].name + "-" + artefact.spheres[spacing.second].name;
}

AcceptanceVerdict verdict_of(const AcceptanceItem& item) {
  if (!item.permissible) return AcceptanceVerdict::not_judged;
  const double size = std::abs(item.error());
  if (size + item.U() <= *item.permissible) return AcceptanceVerdict::conforms;
  return size - item.U() > *item.permissible ? AcceptanceVerdict::does_not_conform : AcceptanceVerdict::undecided;
}

/// Collects items and judges each.
class Items {
 public:
  explicit Items(const PermissibleErrors& permissible) : permissible_(permissible) {}

  void add(Characteristic what, const std::string& where, const std::string& missing, const MeasuredLength& measured,
           const Measured& certified) {
    AcceptanceItem item;
    item.what = what;
    item.where = where;
    item.measured = measured.mm;
    item.certified = certified.value;
    item.u_scatter = measured.u_scatter_mm;
    item.u_calibration = measured.u_calibration_mm;
    item.u_certificate = certified.u;
    item.permissible = permissible_.of(what);
    item.verdict = missing.empty() ? verdict_of(item) : AcceptanceVerdict::not_verifiable;
    item.note = missing;
    items.push_back(std::move(item));
  }
  /// Both widths of a form. The artefact's own deviation lies anywhere within what is certified.
  void add(Characteristic all, Characteristic p95, const std::string& where, const std::string& missing,
           const MeasuredForm& form, double certified_form_mm) {
    const Measured none{0, certified_form_mm / std::numbers::sqrt3};
    add(all, where, missing, {form.all_mm, form.u_all_mm, 0}, none);
    add(p95, where, missing, {form.p95_mm, form.u_p95_mm, 0}, none);
  }

  std::vector<AcceptanceItem> items;

 private:
  const PermissibleErrors& permissible_;
};

const char* title_of(Characteristic what) {
  switch (what) {
    case Characteristic::form:
      return "probing form, all points";
    case Characteristic::form95:
      return "probing form, 95 %";
    case Characteristic::size:
      return "probing size";
    case Characteristic::spacing:
      return "sphere spacing";
    case Characteristic::flatness:
      return "flatness, all points";
    case Characteristic::flatness95:
      break;
  }
  return "flatness, 95 %";
}

}  // namespace

const char* to_string(AcceptanceVerdict verdict) {
  switch (verdict) {
    case AcceptanceVerdict::not_judged:
      return "not judged";
    case AcceptanceVerdict::conforms:
      return "conforms";
    case AcceptanceVerdict::undecided:
      return "undecided";
    case AcceptanceVerdict::not_verifiable:
      return "not verifiable";
    case AcceptanceVerdict::does_not_conform:
      break;
  }
  return "does not conform";
}

double AcceptanceItem::u() const {
  return std::hypot(u_scatter, u_calibration, u_certificate);
}

AcceptanceVerdict Acceptance::verdict() const {
  AcceptanceVerdict worst = AcceptanceVerdict::not_judged;
  for (const AcceptanceItem& item : items) worst = std::max(worst, item.verdict);
  return worst;
}

Acceptance judge_acceptance(const Artefact& artefact, const ArtefactMeasurement& measurement) {
  Items items(artefact.permissible);
  for (std::size_t i = 0; i < artefact.spheres.size(); ++i) {
    const CertifiedSphere& certified = artefact.spheres[i];
    const MeasuredSphere& measured = measurement.spheres[i];
    items.add(Characteristic::form, Characteristic::form95, certified.name, measured.missing, measured.form,
              certified.form_mm);
    items.add(Characteristic::size, certified.name, measured.missing, measured.diameter, certified.diameter);
  }
  for (std::size_t k = 0; k < artefact.spacings.size(); ++k) {
    items.add(Characteristic::spacing, pair_name(artefact, artefact.spacings[k]), measurement.spacings[k].missing,
              measurement.spacings[k].distance, artefact.spacings[k].distance);
  }
  if (measurement.flat) {
    items.add(Characteristic::flatness, Characteristic::flatness95, "flat", measurement.flat->missing,
              measurement.flat->form, artefact.flat->form_mm);
  }
  Acceptance out{artefact, measurement, std::move(items.items), {}};
  out.findings = acceptance_findings(out);
  return out;
}

std::string acceptance_text(const Acceptance& acceptance) {
  char line[320];
  const std::string& certificate = acceptance.artefact.certificate;
  std::string text = "artefact    " + acceptance.artefact.name +
                     (certificate.empty() ? "" : ", certificate " + certificate) + "\n            " + kManner + "\n\n";
  std::snprintf(line, sizeof line, "%-26s %-7s %11s %11s %9s %9s %9s  %s\n", "characteristic (mm)", "where", "measured",
                "certified", "error", "U (k=2)", "limit", "verdict");
  text += line;
  std::string notes;
  for (const AcceptanceItem& item : acceptance.items) {
    char limit[16] = "-";
    if (item.permissible) std::snprintf(limit, sizeof limit, "%.4f", *item.permissible);
    if (item.verdict == AcceptanceVerdict::not_verifiable) {
      std::snprintf(line, sizeof line, "%-26s %-7s %11s %11.4f %9s %9s %9s  %s\n", title_of(item.what),
                    item.where.c_str(), "-", item.certified, "-", "-", limit, to_string(item.verdict));
      const std::string note = "note        " + item.where + ": " + item.note + "\n";
      if (notes.find(note) == std::string::npos) notes += note;
    } else {
      std::snprintf(line, sizeof line, "%-26s %-7s %11.4f %11.4f %+9.4f %9.4f %9s  %s\n", title_of(item.what),
                    item.where.c_str(), item.measured, item.certified, item.error(), item.U(), limit,
                    to_string(item.verdict));
    }
    text += line;
  }
  text += "\n" + notes;
  for (const std::string& finding : acceptance.findings) text += "finding     " + finding + "\n";
  return text + "verdict     " + to_string(acceptance.verdict()) + "\n";
}

std::string format_acceptance(const Acceptance& acceptance, const LogHeader& scan,
                              const std::string& calibration_date) {
  using Json = nlohmann::ordered_json;
  const Artefact& artefact = acceptance.artefact;
  const ArtefactMeasurement& measured = acceptance.measurement;
  const Eigen::Vector3d& shift = measured.placement.shift_mm;
  Json items = Json::array();
  for (const AcceptanceItem& item : acceptance.items) {
    const bool known = item.verdict != AcceptanceVerdict::not_verifiable;
    const auto number = [&](double value) { return known ? Json(value) : Json(nullptr); };
    items.push_back({{"characteristic", to_string(item.what)},
                     {"where", item.where},
                     {"measured_mm", number(item.measured)},
                     {"certified_mm", item.certified},
                     {"error_mm", number(item.error())},
                     {"expanded_uncertainty_mm", number(item.U())},
                     {"u_scatter_mm", number(item.u_scatter)},
                     {"u_calibration_mm", number(item.u_calibration)},
                     {"u_certificate_mm", item.u_certificate},
                     {"permissible_mm", item.permissible ? Json(*item.permissible) : Json(nullptr)},
                     {"verdict", to_string(item.verdict)},
                     {"note", item.note}});
  }
  Json seen = Json::object();
  for (std::size_t i = 0; i < artefact.spheres.size(); ++i) {
    const MeasuredSphere& sphere = measured.spheres[i];
    seen[artefact.spheres[i].name] = {
        {"share", sphere.seen}, {"least", kLeastOfSphere}, {"points", sphere.form.points}};
  }
  Json json{{"format", "celadon-acceptance"},
            {"version", 1},
            {"units", {{"length", "mm"}, {"angle", "rad"}}},
            {"manner", kManner},
            {"artefact", artefact.name},
            {"certificate", artefact.certificate},
            {"date", scan.date},
            {"machine", scan.machine},
            {"camera", scan.camera},
            {"simulated", scan.simulated},
            {"calibration_date", calibration_date},
            {"placement", {{"turn_rad", measured.placement.turn_rad}, {"shift_mm", {shift.x(), shift.y(), shift.z()}}}},
            {"seen", seen}};
  if (measured.flat) {
    json["seen_flat"] = {
        {"share", measured.flat->seen}, {"least", kLeastOfFlat}, {"points", measured.flat->form.points}};
  }
  json["items"] = std::move(items);
  json["verdict"] = to_string(acceptance.verdict());
  json["findings"] = acceptance.findings;
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace celadon
