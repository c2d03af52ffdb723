#pragma once
// A report as an operator reads it.

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace celadon::cli {

/// Lines about the object, the fit, the truth if simulated, and warnings; from the fields of report.json.
std::string summary_of(const nlohmann::json& report);

}  // namespace celadon::cli
