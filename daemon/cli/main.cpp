// celadon: client of the daemon and offline tools.

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <exception>
#include <new>
#include <string>

#include "daemon/cli/commands.h"
#include "daemon/usage_error.h"

namespace celadon::cli {

int fail(int exit_code, const std::string& message) {
  std::fprintf(stderr, "celadon: %s\n", message.c_str());
  return exit_code;
}

}  // namespace celadon::cli

int main(int argc, char** argv) {
  using namespace celadon::cli;
  std::signal(SIGPIPE, SIG_IGN);
  CLI::App program{
      "Celadon: from a turntable laser-line scanner to a CAD solid.\n"
      "Lengths are millimetres and angles degrees unless an option says otherwise."};
  program.name("celadon");
  program.require_subcommand(1);
  program.set_version_flag("--version", "celadon " CELADON_VERSION);
  program.option_defaults()->always_capture_default();
  Run run;
  add_scan_command(program, run);
  add_watch_command(program, run);
  add_status_command(program, run);
  add_cancel_command(program, run);
  add_check_command(program, run);
  add_accept_command(program, run);
  add_fit_command(program, run);
  add_merge_command(program, run);
  add_line_command(program, run);
  add_evaluate_command(program, run);
  add_calibrate_command(program, run);
  add_cameras_command(program, run);
  add_device_command(program, run);
  add_setup_command(program, run);
  add_board_command(program, run);
  try {
    program.parse(argc, argv);
    return run();
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return program.exit(error);  // help and version
    return fail(2, celadon::usage_sentence(program, error));
  } catch (const std::bad_alloc&) {
    return fail(4, "out of memory; close other programs or fit fewer control points");
  } catch (const std::exception& error) {
    return fail(4, std::string("an error that should not happen: ") + error.what());
  }
}
