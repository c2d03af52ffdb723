#pragma once
// Readers of point clouds as profile streams, and of native samples. Depends on fitting/profile.h only.

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include <tl/expected.hpp>

#include "fitting/profile.h"

namespace celadon {

enum class Axis : std::uint8_t { x, y, z };
/// Millimetres a unit of length: mm, cm, m, in, um.
tl::expected<double, std::string> millimetres_per_unit(const std::string& unit);

struct CloudOptions {
  Axis axis = Axis::z;  ///< becomes z, by the cyclic permutation of the axes that keeps the frame right-handed
  /// The file's frame (mm; of native samples their own) in the frame samples are given in, instead of `axis`.
  std::optional<Eigen::Isometry3d> X_SF;
  double millimetres_per_unit = 1;
  std::size_t samples_per_profile = 4096;
};

struct FileError {
  std::string message;
};  ///< names file, line or offset, value and remedy

/// What the columns of a cloud are; angles in radians.
enum class CloudColumns : std::uint8_t {
  cartesian,    ///< x, y, z
  cylindrical,  ///< r, theta, z
  spherical     ///< rho, phi, theta about the origin
};

/// Points from which on a file is read in parts, and these parts.
inline constexpr std::uint64_t kPointsToShare = 1U << 20;
inline constexpr int kCloudParts = 4;

/// Streams a file in pieces, any number of times, in memory that does not grow with it.
class CloudFile : public ProfileStream {
 public:
  virtual std::uint64_t points() const = 0;      ///< promised by the header or counted
  virtual std::uint64_t skipped() const = 0;     ///< NaN or infinite coordinates seen in the last pass
  virtual const std::string& error() const = 0;  ///< not empty after a pass that met a broken record: the sentence
  virtual CloudColumns columns() const = 0;
};

/// PLY and PCD (ASCII, binary, binary_compressed PCD), XYZ and CSV (comma, semicolon, blank, tab), CSV with the header
/// r,theta,z or rho,phi,theta (radians). The kind is found from the content, not the name. Headers that promise more
/// than the file holds are refused at once.
tl::expected<std::unique_ptr<CloudFile>, FileError> open_cloud(const std::filesystem::path& file,
                                                               const CloudOptions& options);

/// The same, as parts that can be read side by side, one after the other in the file: kCloudParts of a file with at
/// least kPointsToShare points in records of one size, else one. The same parts on every machine.
tl::expected<std::vector<std::unique_ptr<CloudFile>>, FileError> open_cloud_parts(const std::filesystem::path& file,
                                                                                  const CloudOptions& options);

}  // namespace celadon
