#pragma once
// What scan and watch share: follow a scan of a daemon to its end, fetch its files, say what came out.

#include <filesystem>
#include <string>

#include "daemon/http/http_client.h"

namespace celadon::cli {

struct FollowOptions {
  std::filesystem::path folder;  ///< for the files; empty: they stay in the daemon's store
  bool json = false;
};

/// Installs a SIGINT and SIGTERM handler; interrupted() tells whether one came.
void catch_interrupts();
bool interrupted();

/// Follows a scan until it is finished, downloads its files and prints the summary of its report. A first Ctrl-C
/// cancels the scan (laser off, motor stopped) and waits for that. @returns the exit code; 1 too for a scan that is
/// done and whose self-checks did not all pass or stay open
int follow_scan(HttpClient& client, std::uint64_t id, const FollowOptions& options);

/// Creates the folder if needed; 0 or the exit code after saying why not.
int prepare_folder(const std::filesystem::path& folder);

}  // namespace celadon::cli
