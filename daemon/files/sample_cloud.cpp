#include "daemon/files/sample_cloud.h"

#include <array>
#include <cmath>
#include <cstring>

namespace celadon {
namespace {

constexpr std::size_t kCoordinateBytes = 3 * sizeof(float), kPointBytes = kCoordinateBytes + 3, kWriteBytes = 1 << 18;

SampleCloud counted(ProfileStream& samples) {
  SampleCloud out;
  samples.rewind();
  while (const Profile* profile = samples.next()) {
    out.points += profile->size();
    for (const SampleColour& colour : profile->colour) out.coloured += colour.known() ? 1 : 0;
  }
  return out;
}

}  // namespace

tl::expected<SampleCloud, WriteError> write_coloured_samples(ProfileStream& samples, const std::string& header,
                                                             const std::filesystem::path& file) {
  const SampleCloud cloud = counted(samples);
  if (cloud.coloured == 0) return cloud;
  auto out = AtomicFile::create(file);
  if (!out) return tl::make_unexpected(out.error());
  std::string bytes = "ply\nformat binary_little_endian 1.0\ncomment " + header + "\nelement vertex " +
                      std::to_string(cloud.points) +
                      "\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n"
                      "property uchar green\nproperty uchar blue\nend_header\n";
  samples.rewind();
  while (const Profile* profile = samples.next()) {
    std::size_t at = bytes.size();
    bytes.resize(at + kPointBytes * profile->size());
    for (std::size_t k = 0; k < profile->size(); ++k, at += kPointBytes) {
      const std::array<float, 3> p{static_cast<float>(profile->r_mm[k] * std::cos(profile->theta_rad[k])),
                                   static_cast<float>(profile->r_mm[k] * std::sin(profile->theta_rad[k])),
                                   static_cast<float>(profile->z_mm[k])};
      const SampleColour colour = profile->colour.empty() ? SampleColour() : profile->colour[k];
      const std::array<std::uint8_t, 3> rgb{colour.red, colour.green, colour.blue};
      std::memcpy(bytes.data() + at, p.data(), kCoordinateBytes);
      std::memcpy(bytes.data() + at + kCoordinateBytes, rgb.data(), rgb.size());
    }
    if (bytes.size() < kWriteBytes) continue;
    if (auto written = out->append(bytes); !written) return tl::make_unexpected(written.error());
    bytes.clear();
  }
  if (auto written = out->append(bytes); !written) return tl::make_unexpected(written.error());
  if (auto named = out->commit(); !named) return tl::make_unexpected(named.error());
  return cloud;
}

}  // namespace celadon
