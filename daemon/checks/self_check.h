#pragma once
// What a scan finds of its own trustworthiness: one check, its verdict, and its JSON. Grammar: RESULTS.md, "checks".

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

namespace celadon {

enum class CheckVerdict : std::uint8_t {
  passed,
  failed,
  not_verifiable  ///< this object, or this scan, cannot show it; never to be taken for passed
};
/// "passed", "failed", "not verifiable"
const char* to_string(CheckVerdict verdict);

struct SelfCheck {
  std::string name;  ///< e.g. "closure"
  std::string unit;  ///< of value, uncertainty and limit: "mm" or "deg/turn"
  std::optional<double> value, standard_uncertainty;
  std::optional<double> limit;  ///< the largest |value| that passes
  CheckVerdict verdict = CheckVerdict::not_verifiable;
  std::string note;    ///< what was compared; of `not verifiable`: why nothing can be said
  std::string cause;   ///< of `failed`: what is suspected
  std::string remedy;  ///< of `failed`: what to do
};

/// "closure: 0.312 mm (standard uncertainty 0.002 mm, limit 0.012 mm): CAUSE; REMEDY" of a failed check; of others the
/// note.
std::string sentence_of(const SelfCheck& check);

nlohmann::ordered_json to_json(const std::vector<SelfCheck>& checks);
/// The inverse. @throws nlohmann::json::exception, or std::invalid_argument for a verdict that does not exist
std::vector<SelfCheck> self_checks_from_json(const nlohmann::json& list);

}  // namespace celadon
