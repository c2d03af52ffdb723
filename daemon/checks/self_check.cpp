#include "daemon/checks/self_check.h"

#include <cstdio>
#include <stdexcept>

#include <nlohmann/json.hpp>

namespace celadon {
namespace {

std::string amount(double value, const std::string& unit) {
  char text[48];
  std::snprintf(text, sizeof text, "%.3g ", value);
  return text + unit;
}

CheckVerdict check_verdict_from(const std::string& text) {
  for (const CheckVerdict verdict : {CheckVerdict::passed, CheckVerdict::failed, CheckVerdict::not_verifiable}) {
    if (text == to_string(verdict)) return verdict;
  }
  throw std::invalid_argument("the verdict '" + text + "' is neither passed, failed nor not verifiable");
}

}  // namespace

const char* to_string(CheckVerdict verdict) {
  switch (verdict) {
    case CheckVerdict::passed:
      return "passed";
    case CheckVerdict::failed:
      return "failed";
    case CheckVerdict::not_verifiable:
      break;
  }
  return "not verifiable";
}

std::string sentence_of(const SelfCheck& check) {
  std::string text = check.name;
  if (check.value) {
    text += ": " + amount(*check.value, check.unit);
    std::string beside;
    if (check.standard_uncertainty) beside = "standard uncertainty " + amount(*check.standard_uncertainty, check.unit);
    if (check.limit) beside += (beside.empty() ? "limit " : ", limit ") + amount(*check.limit, check.unit);
    if (!beside.empty()) text += " (" + beside + ")";
  }
  if (check.verdict == CheckVerdict::failed) return text + ": " + check.cause + "; " + check.remedy + ".";
  return text + ": " + check.note;
}

nlohmann::ordered_json to_json(const std::vector<SelfCheck>& checks) {
  using Json = nlohmann::ordered_json;
  const auto number = [](const std::optional<double>& x) { return x ? Json(*x) : Json(nullptr); };
  Json list = Json::array();
  for (const SelfCheck& check : checks) {
    Json entry{{"name", check.name},
               {"verdict", to_string(check.verdict)},
               {"unit", check.unit},
               {"value", number(check.value)},
               {"standard_uncertainty", number(check.standard_uncertainty)},
               {"limit", number(check.limit)},
               {"note", check.note}};
    if (check.verdict == CheckVerdict::failed) {
      entry["cause"] = check.cause;
      entry["remedy"] = check.remedy;
    }
    list.push_back(std::move(entry));
  }
  return list;
}

std::vector<SelfCheck> self_checks_from_json(const nlohmann::json& list) {
  const auto number = [](const nlohmann::json& x) {
    return x.is_null() ? std::nullopt : std::optional(x.get<double>());
  };
  std::vector<SelfCheck> checks;
  for (const auto& entry : list) {
    SelfCheck check;
    check.name = entry.at("name").get<std::string>();
    check.verdict = check_verdict_from(entry.at("verdict").get<std::string>());
    check.unit = entry.at("unit").get<std::string>();
    check.value = number(entry.at("value"));
    check.standard_uncertainty = number(entry.at("standard_uncertainty"));
    check.limit = number(entry.at("limit"));
    check.note = entry.at("note").get<std::string>();
    check.cause = entry.value("cause", "");
    check.remedy = entry.value("remedy", "");
    checks.push_back(std::move(check));
  }
  return checks;
}

}  // namespace celadon
