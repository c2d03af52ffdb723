#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>

#include "daemon/checks/acceptance.h"

namespace celadon {
namespace {

constexpr double kSigmas = 3;

template <class... Values>
std::string text_of(const char* format, Values... values) {
  char text[400];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

std::vector<const AcceptanceItem*> measured_items(const Acceptance& acceptance, Characteristic what) {
  std::vector<const AcceptanceItem*> out;
  for (const AcceptanceItem& item : acceptance.items) {
    if (item.what == what && item.verdict != AcceptanceVerdict::not_verifiable) out.push_back(&item);
  }
  return out;
}

double median_of(const std::vector<const AcceptanceItem*>& items,
                 const std::function<double(const AcceptanceItem&)>& value_of) {
  std::vector<double> values;
  for (const AcceptanceItem* item : items) values.push_back(value_of(*item));
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return (values[(n - 1) / 2] + values[n / 2]) / 2;
}

/// Of three and more the median is what most of them share; of fewer nothing tells which errs.
constexpr std::size_t kTellsApart = 3;

/// The ball whose certified diameter this one has, if it is not its own.
std::string looks_exchanged(const Acceptance& acceptance, const AcceptanceItem& item) {
  for (const CertifiedSphere& other : acceptance.artefact.spheres) {
    const double left = std::abs(item.measured - other.diameter.value);
    if (other.name != item.where && left < 0.1 * std::abs(item.error())) {
      return text_of("; that is the diameter of %s: if the two are exchanged, correct the file", other.name.c_str());
    }
  }
  return "; clean the ball and compare the file with its certificate";
}

}  // namespace

std::vector<std::string> acceptance_findings(const Acceptance& acceptance) {
  std::vector<std::string> out;
  const auto spacings = measured_items(acceptance, Characteristic::spacing);
  double scale = 0;  // relative, that the spacings share
  if (!spacings.empty()) {
    const double shared = median_of(spacings, [](const auto& i) { return i.error() / i.certified; });
    const double u = median_of(spacings, [](const auto& i) { return i.u() / i.certified; });
    if (spacings.size() >= kTellsApart && std::abs(shared) > kSigmas * u) {
      scale = shared;
      out.push_back(
          text_of("most spacings are measured %.3f %% too %s, %.1f times their standard uncertainty: the "
                  "calibration's scale is wrong, or the artefact's temperature; run celadon calibrate with a "
                  "board of known pitch",
                  100 * std::abs(scale), scale > 0 ? "long" : "short", std::abs(shared) / u));
    }
    for (const AcceptanceItem* item : spacings) {
      const double apart = item->error() - scale * item->certified;
      if (std::abs(apart) <= kSigmas * item->u()) continue;
      out.push_back(
          text_of("the spacing %s stands apart%s by %+.4f mm, %.1f times its standard uncertainty; compare the "
                  "file with the certificate, and look whether a ball is loose",
                  item->where.c_str(), spacings.size() >= kTellsApart ? " from the others" : "", apart,
                  std::abs(apart) / item->u()));
    }
  }
  const auto sizes = measured_items(acceptance, Characteristic::size);
  if (sizes.empty()) return out;
  const auto left_of = [&](const AcceptanceItem& i) { return i.error() - scale * i.certified; };
  double shared = median_of(sizes, left_of);
  const double u = median_of(sizes, [](const auto& i) { return i.u(); });
  if (sizes.size() < kTellsApart || std::abs(shared) <= kSigmas * u) {
    shared = 0;
  } else {
    out.push_back(
        text_of("most balls are measured %.4f mm too %s, %.1f times the standard uncertainty, beside what the "
                "spacings show: a thick line on a small ball, light from below the surface or a wrong exposure "
                "does that",
                std::abs(shared), shared > 0 ? "large" : "small", std::abs(shared) / u));
  }
  for (const AcceptanceItem* item : sizes) {
    const double apart = left_of(*item) - shared;
    // What all share is more for a small ball than for a large one.
    if (std::abs(apart) <= std::max(kSigmas * item->u(), std::abs(shared) / 2)) continue;
    out.push_back(text_of("ball %s stands apart%s by %+.4f mm of diameter, %.1f times its standard uncertainty",
                          item->where.c_str(), sizes.size() >= kTellsApart ? " from the others" : "", apart,
                          std::abs(apart) / item->u()) +
                  looks_exchanged(acceptance, *item));
  }
  return out;
}

}  // namespace celadon
