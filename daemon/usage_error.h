#pragma once
// What is wrong with a command line, in one sentence.

#include <charconv>
#include <cmath>
#include <limits>
#include <string>

#include <CLI/CLI.hpp>

namespace celadon {

/// "--tolerance: '-1' must be a finite number, 0 or more; see celadon fit --help"
inline std::string usage_sentence(const CLI::App& program, const CLI::ParseError& error) {
  std::string what = error.what();
  what = what.substr(0, what.find('\n'));
  std::string command = program.get_name();
  for (const CLI::App* app = &program; !app->get_subcommands().empty();) {
    app = app->get_subcommands().front();
    command += " " + app->get_name();
  }
  const auto unknown = program.remaining();
  if (error.get_name() == "RequiredError" && command == program.get_name() && !unknown.empty()) {
    what = "'" + unknown.front() + "' is not a command";
  }
  return what + "; see " + command + " --help";
}

/// A finite number, at least `least`; `words` says so.
inline CLI::Validator finite_number(double least, const std::string& words) {
  return CLI::Validator(
      [least, words](std::string& text) -> std::string {
        double value = 0;
        const char* const end = text.data() + text.size();
        const auto parsed = std::from_chars(text.data(), end, value);
        const bool good = parsed.ec == std::errc{} && parsed.ptr == end && std::isfinite(value) && value >= least;
        return good ? "" : "'" + text + "' must be " + words;
      },
      "NUMBER");
}
inline CLI::Validator not_negative() {
  return finite_number(0, "a finite number, 0 or more");
}
inline CLI::Validator finite() {
  return finite_number(std::numeric_limits<double>::lowest(), "a finite number");
}

}  // namespace celadon
