#pragma once
// The commands of `celadon`: each adds its options to the program and leaves its work in `run`.

#include <CLI/App.hpp>
#include <functional>

namespace celadon::cli {

/// What was chosen on the command line; its result is the exit code (architecture: 0 good, 1 no, 2 input, 3 device,
/// 4 system, 130 interrupted).
using Run = std::function<int()>;

void add_scan_command(CLI::App& program, Run& run);
void add_watch_command(CLI::App& program, Run& run);
void add_status_command(CLI::App& program, Run& run);
void add_cancel_command(CLI::App& program, Run& run);
void add_check_command(CLI::App& program, Run& run);
void add_accept_command(CLI::App& program, Run& run);
void add_fit_command(CLI::App& program, Run& run);
void add_merge_command(CLI::App& program, Run& run);
void add_line_command(CLI::App& program, Run& run);
void add_evaluate_command(CLI::App& program, Run& run);
void add_calibrate_command(CLI::App& program, Run& run);
void add_cameras_command(CLI::App& program, Run& run);
void add_device_command(CLI::App& program, Run& run);
void add_device_axes_commands(CLI::App& device, Run& run);  ///< of `celadon device`
void add_setup_command(CLI::App& program, Run& run);
void add_board_command(CLI::App& program, Run& run);

/// Prints "celadon: MESSAGE" on standard error and returns the code.
int fail(int exit_code, const std::string& message);

}  // namespace celadon::cli
