#include "daemon/calibration/calibration_file.h"

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <iterator>
#include <optional>
#include <string>
#include <system_error>

#include "daemon/files/file_problem.h"

namespace celadon {
namespace {

namespace fs = std::filesystem;

std::optional<std::string> whole_text(const fs::path& file) {
  std::error_code ignored;
  if (fs::is_directory(file, ignored)) {  // a stream of one throws
    errno = EISDIR;
    return std::nullopt;
  }
  std::ifstream in(file, std::ios::binary);
  if (!in) return std::nullopt;
  return std::string(std::istreambuf_iterator<char>(in), {});
}

/// A name beside the file that no other text has.
fs::path kept_name(const fs::path& file, std::string date, const std::string& text) {
  // A date is a part of a name: nothing of it may lead elsewhere.
  const auto harmless = [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '.' || c == '-';
  };
  std::replace_if(
      date.begin(), date.end(), [&](char c) { return !harmless(c); }, '-');
  const std::string stem = file.stem().string() + "-" + date.substr(0, 40);
  fs::path kept = file.parent_path() / (stem + file.extension().string());
  std::error_code ignored;
  for (int again = 2; fs::exists(kept, ignored) && whole_text(kept) != text; ++again) {
    kept = file.parent_path() / (stem + "-" + std::to_string(again) + file.extension().string());
  }
  return kept;
}

}  // namespace

tl::expected<fs::path, WriteError> replace_calibration(const fs::path& file, std::string_view text,
                                                       const std::string& previous_date) {
  fs::path kept;
  std::error_code missing;
  if (fs::exists(file, missing)) {
    errno = 0;
    const auto before = whole_text(file);
    if (!before) return tl::make_unexpected(WriteError{errno, file_problem("cannot read", file, errno)});
    kept = kept_name(file, previous_date, *before);
    if (auto written = write_file_atomically(kept, *before); !written) return tl::make_unexpected(written.error());
  }
  if (auto written = write_file_atomically(file, text); !written) return tl::make_unexpected(written.error());
  return kept;
}

}  // namespace celadon
