#pragma once
// celadon-sim and celadond started as two processes for one command, and ended with it.

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace celadon::cli {

/// A child process that ends with this object: SIGTERM, then SIGKILL after two seconds; the kernel ends it if this
/// process dies.
class ChildProcess {
 public:
  ChildProcess() = default;
  ChildProcess(ChildProcess&& other) noexcept;
  ChildProcess& operator=(ChildProcess&& other) noexcept;
  ~ChildProcess();
  /// Starts a program and waits for the first line of its standard output. Its errors go to `log`.
  /// @returns the line, or one sentence with the end of the log
  tl::expected<std::string, std::string> start(const std::vector<std::string>& command,
                                               const std::filesystem::path& log);
  void end() noexcept;

 private:
  pid_t pid_ = -1;
  int output_fd_ = -1;
};

struct VirtualScannerOptions {
  std::string scene = "vase";
  std::uint64_t seed = 1;
  int lasers = 1;                        ///< 1 or 2
  bool elevation = false, lift = false;  ///< axes beside the table
  bool textured = false;                 ///< the object has a texture, under a good lamp
};

/// A virtual scanner with a daemon that drives it, in lock-step as fast as it goes; the daemon takes the simulator's
/// true calibration.
class VirtualScanner {
 public:
  static tl::expected<VirtualScanner, std::string> start(const VirtualScannerOptions& options);
  VirtualScanner(VirtualScanner&& other) noexcept = default;
  VirtualScanner& operator=(VirtualScanner&&) = delete;
  ~VirtualScanner();
  const std::string& server() const { return server_; }  ///< for HttpClient

 private:
  VirtualScanner() = default;
  std::filesystem::path folder_;
  ChildProcess simulator_, daemon_;
  std::string server_;
};

/// Path of a program beside the running one, else its bare name for the search path.
std::string program_beside(const std::string& name);

/// What a program that ends by itself writes on its standard output. Errors: one sentence.
tl::expected<std::string, std::string> output_of(const std::vector<std::string>& command);

}  // namespace celadon::cli
