#include "acquisition/calibrate/step_judge.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace celadon::calibrate {
namespace {

void append(std::string& text, const std::string& more) {
  if (more.empty() || text.find(more) != std::string::npos) return;
  if (!text.empty()) text += "; ";
  text += more;
}

}  // namespace

std::string figure(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

void StepJudge::at_most(const std::string& what, double value, const std::string& unit, double good, double usable,
                        const std::string& remedy) {
  const Verdict verdict = value <= good ? Verdict::good : value <= usable ? Verdict::usable : Verdict::refused;
  compare(what + " " + figure(value) + unit + " (good to " + figure(good) + ", usable to " + figure(usable) + ")",
          verdict, remedy);
}

void StepJudge::at_least(const std::string& what, double value, const std::string& unit, double good, double usable,
                         const std::string& remedy) {
  const Verdict verdict = value >= good ? Verdict::good : value >= usable ? Verdict::usable : Verdict::refused;
  compare(what + " " + figure(value) + unit + " (good from " + figure(good) + ", usable from " + figure(usable) + ")",
          verdict, remedy);
}

void StepJudge::say(Verdict verdict, const std::string& finding, const std::string& remedy) {
  compare(finding, verdict, remedy);
}

void StepJudge::compare(const std::string& text, Verdict verdict, const std::string& remedy) {
  append(step_.finding, text);
  if (verdict != Verdict::good) append(step_.remedy, remedy);
  step_.verdict = std::max(step_.verdict, verdict);
}

CalibrationStep StepJudge::step() const {
  CalibrationStep out = step_;
  if (!out.finding.empty()) out.finding += ".";
  if (!out.remedy.empty()) out.remedy += ".";
  return out;
}

}  // namespace celadon::calibrate
