#pragma once
// Asks the helper process celadon-cad for a CAD file of a surface; a crash or hang there cannot hurt the daemon.

#include <sys/types.h>

#include <filesystem>
#include <span>
#include <string>

#include <tl/expected.hpp>

#include "fitting/nurbs_surface.h"

namespace celadon {

/// One wall as the list of them. @pre the wall outlives what takes the list
inline std::span<const NurbsSurface> single(const NurbsSurface& wall) {
  return {&wall, 1};
}

struct CadOptions {
  bool ap214 = false;                                  ///< AP242 otherwise
  std::string name = "object";                         ///< product name in the file, UTF-8
  bool simulated = false;                              ///< said in the file's header and in the product's description
  std::string date;                                    ///< ISO 8601 UTC; in the header in place of the present time
  int time_limit_s = 60;                               ///< > 0; the helper is ended after it
  bool bottom_measured = false, top_measured = false;  ///< the disc there is a face that was measured
};

struct CadResult {
  double volume_mm3 = 0;
  bool valid = false;
  int faces = 0;
  bool closed = true;  ///< a solid; else a shell of no volume
};

/// Writes a closed solid of positive volume: the exact walls, bottom to top, and what closes the ends, named and
/// coloured as assumed unless it was measured. A single wall that is open around is a shell of one face.
/// Written beside `file`, synced and renamed. Errors: one sentence with the remedy.
tl::expected<CadResult, std::string> write_step(std::span<const NurbsSurface> walls, const std::filesystem::path& file,
                                                const CadOptions& options);

/// A celadon-cad started ahead of need: process start and library initialisation pass while the table still turns.
/// Movable; its destructor ends the process. Not thread-safe.
class CadWorker {
 public:
  /// celadon-cad is looked for beside the running program, then on the PATH.
  static tl::expected<CadWorker, std::string> start();
  CadWorker(CadWorker&& other) noexcept;
  CadWorker& operator=(CadWorker&& other) noexcept;
  CadWorker(const CadWorker&) = delete;
  CadWorker& operator=(const CadWorker&) = delete;
  ~CadWorker();

  /// As the function above. A worker serves one file and its process ends with it; asked again, or when the waiting
  /// process has been ended by somebody meanwhile, it starts another one.
  tl::expected<CadResult, std::string> write_step(std::span<const NurbsSurface> walls,
                                                  const std::filesystem::path& file, const CadOptions& options);
  /// Process id of the helper that waits, or -1.
  pid_t pid() const { return pid_; }

 private:
  CadWorker(pid_t pid, int socket) : pid_(pid), socket_(socket) {}
  bool alive();
  void stop();
  /// What the helper's end says, after its connection closed; collects the process.
  std::string cause_of_end();

  pid_t pid_ = -1;
  int socket_ = -1;
};

}  // namespace celadon
