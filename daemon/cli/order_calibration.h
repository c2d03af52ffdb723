#pragma once
// A calibration by the daemon that owns the machine: the operator is at this terminal.

#include <filesystem>
#include <string>
#include <vector>

#include "daemon/calibration/calibration_record.h"

namespace celadon::cli {

/// Asks the daemon for a calibration, shows what it asks for and sees, and tells it what is done. The daemon uses the
/// calibration from then on. A first Ctrl-C cancels it and waits for that.
/// @param output  file for a copy; empty: none
/// @returns the exit code: 1 where the calibration is refused or was cancelled
int order_calibration(const std::string& server, const CalibrationRequest& request,
                      const std::filesystem::path& output);

/// What has to be done by hand, as every way of calibrating says it.
void tell_instruction(const std::string& instruction);
void tell_operator(const std::string& text);
/// A line for each step of a calibration, with its verdict.
void tell_steps(const std::vector<StepVerdict>& steps);

}  // namespace celadon::cli
