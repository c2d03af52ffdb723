#include "daemon/files/cloud_files.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "daemon/files/cloud_kinds.h"
#include "daemon/files/file_problem.h"
#include "daemon/files/polar.h"

namespace celadon {
namespace {

/// One batch of records at a time becomes a profile.
class PointCloud : public CloudFile {
 public:
  PointCloud(InputFile file, const CloudOptions& options) : file_(std::move(file)), options_(options) {}

  /// @pre called once, before anything else; the sources refer to file() and live in this object
  void take(std::unique_ptr<PointSource> source, CloudColumns columns) {
    source_ = std::move(source);
    columns_ = columns;
    for (auto& column : column_) {
      column.resize(options_.samples_per_profile);
    }
  }
  const InputFile& file() const { return file_; }
  bool restrict_to(std::uint64_t first, std::uint64_t count) { return source_->restrict_to(first, count); }

  void rewind() override {
    source_->rewind();
    total_ = std::max(total_, records_);
    records_ = skipped_ = 0;
    index_ = 0;
  }

  const Profile* next() override {
    for (;;) {
      const std::size_t count =
          source_->read(options_.samples_per_profile, column_[0].data(), column_[1].data(), column_[2].data());
      if (count == 0) {
        return nullptr;
      }
      records_ += count;
      const std::size_t kept = keep_finite(count);
      skipped_ += count - kept;
      if (kept == 0) {
        continue;
      }
      fill(kept);
      profile_.index = index_++;
      return &profile_;
    }
  }

  std::uint64_t points() const override { return source_->promised().value_or(std::max(total_, records_)); }
  std::uint64_t skipped() const override { return skipped_; }
  const std::string& error() const override { return source_->error(); }
  CloudColumns columns() const override { return columns_; }

 private:
  /// Scales lengths and closes the gaps that NaN and infinite numbers leave.
  std::size_t keep_finite(std::size_t count) {
    const double scale = options_.millimetres_per_unit;
    const double middle_scale = native() ? 1 : scale, last_scale = columns_ == CloudColumns::spherical ? 1 : scale;
    double* const a = column_[0].data();
    double* const b = column_[1].data();
    double* const c = column_[2].data();
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i) {
      a[i] *= scale;
      b[i] *= middle_scale;
      c[i] *= last_scale;
      sum += 0 * a[i] + 0 * b[i] + 0 * c[i];
    }
    // 0 x inf is NaN: a sum of 0 says that all are finite.
    if (sum == 0) {
      return count;
    }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < count; ++i) {
      if (std::isfinite(a[i]) && std::isfinite(b[i]) && std::isfinite(c[i])) {
        a[kept] = a[i];
        b[kept] = b[i];
        c[kept] = c[i];
        ++kept;
      }
    }
    return kept;
  }

  bool native() const { return columns_ != CloudColumns::cartesian; }

  void to_cylindrical(std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      const double rho = column_[0][i], phi = column_[1][i];
      column_[0][i] = rho * std::sin(phi);
      column_[1][i] = column_[2][i];
      column_[2][i] = rho * std::cos(phi);
    }
  }

  void fill(std::size_t count) {
    if (columns_ == CloudColumns::spherical) to_cylindrical(count);
    profile_.order = ProfileOrder::scattered;
    profile_.r_mm.resize(count);
    profile_.theta_rad.resize(count);
    if (options_.X_SF) {
      move_to_frame(*options_.X_SF, count);
      to_polar(column_[0].data(), column_[1].data(), count, profile_.r_mm.data(), profile_.theta_rad.data());
      profile_.z_mm.assign(column_[2].begin(), column_[2].begin() + static_cast<std::ptrdiff_t>(count));
      return;
    }
    if (native()) {
      std::copy_n(column_[0].begin(), count, profile_.r_mm.begin());
      std::copy_n(column_[1].begin(), count, profile_.theta_rad.begin());
      profile_.z_mm.assign(column_[2].begin(), column_[2].begin() + static_cast<std::ptrdiff_t>(count));
      return;
    }
    // The cyclic permutation that makes the chosen axis the third keeps the frame right-handed.
    const std::size_t third = options_.axis == Axis::x ? 0 : options_.axis == Axis::y ? 1 : 2;
    const auto& x = column_[(third + 1) % 3];
    const auto& y = column_[(third + 2) % 3];
    to_polar(x.data(), y.data(), count, profile_.r_mm.data(), profile_.theta_rad.data());
    profile_.z_mm.assign(column_[third].begin(), column_[third].begin() + static_cast<std::ptrdiff_t>(count));
  }

  void move_to_frame(const Eigen::Isometry3d& X_SF, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      const double a = column_[0][i], b = column_[1][i], c = column_[2][i];
      const Eigen::Vector3d p_F =
          native() ? Eigen::Vector3d(a * std::cos(b), a * std::sin(b), c) : Eigen::Vector3d(a, b, c);
      const Eigen::Vector3d p_S = X_SF * p_F;
      for (std::size_t j = 0; j < 3; ++j) column_[j][i] = p_S[static_cast<Eigen::Index>(j)];
    }
  }

  InputFile file_;
  CloudOptions options_;
  std::unique_ptr<PointSource> source_;
  CloudColumns columns_ = CloudColumns::cartesian;
  std::array<std::vector<double>, 3> column_;
  Profile profile_;
  std::uint64_t records_ = 0, total_ = 0, skipped_ = 0;
  std::uint32_t index_ = 0;
};

enum class CloudKind { ply, pcd, text };

/// From the first bytes. Well-known files of other kinds are named, so that nobody wonders about line 1.
tl::expected<CloudKind, std::string> kind_of(const InputFile& file) {
  std::array<char, 512> bytes{};
  const std::string_view start(bytes.data(), file.read_at(0, bytes.data(), bytes.size()));
  if (start.starts_with("ply\n") || start.starts_with("ply\r") || start.starts_with("ply ")) {
    return CloudKind::ply;
  }
  using namespace std::string_view_literals;
  static constexpr struct {
    std::string_view start;
    const char* sentence;
  } others[] = {{"\x1f\x8b"sv, "a gzip file; unpack it first (gunzip)"},
                {"PK\x03\x04"sv, "a zip archive; unpack it first (unzip)"},
                {"\xff\xfe"sv, "text in UTF-16; save it as UTF-8"},
                {"\xfe\xff"sv, "text in UTF-16; save it as UTF-8"},
                {"LASF"sv, "a LAS file; export the cloud as PLY, PCD or XYZ"},
                {"ASTM-E57"sv, "an E57 file; export the cloud as PLY, PCD or XYZ"},
                {"solid "sv, "an STL mesh; export the points as PLY, PCD or XYZ"},
                {"ISO-10303-21;"sv, "a STEP file, which holds no points"},
                {"\x89PNG"sv, "an image; a frame is read by celadon line"},
                {"\x7f"
                 "ELF"sv,
                 "a program"}};
  for (const auto& other : others) {
    if (start.starts_with(other.start)) {
      return tl::make_unexpected(file.path().string() + " is " + other.sentence);
    }
  }
  if (start.starts_with("# .PCD")) {
    return CloudKind::pcd;
  }
  // Without the usual first comment, a PCD starts with one of its keywords.
  ByteCursor cursor(file, 0, file.size(), 4096);
  std::string_view line;
  bool too_long = false;
  while (cursor.line(line, too_long) && !too_long) {
    if (line.empty() || line.front() == '#') {
      continue;
    }
    const bool pcd = line.starts_with("VERSION") || line.starts_with("FIELDS ") || line.starts_with("COLUMNS ");
    return pcd ? CloudKind::pcd : CloudKind::text;
  }
  return CloudKind::text;
}

Opened source_of(const InputFile& file, CloudColumns& columns) {
  const auto kind = kind_of(file);
  if (!kind) {
    return tl::make_unexpected(kind.error());
  }
  switch (*kind) {
    case CloudKind::ply:
      return open_ply(file);
    case CloudKind::pcd:
      return open_pcd(file);
    default:
      return open_text(file, columns);
  }
}

}  // namespace

std::string broken_promise(const InputFile& file, std::uint64_t count, std::uint64_t bytes, std::uint64_t begin) {
  const std::uint64_t room = begin < file.size() ? (file.size() - begin) / bytes : 0;
  if (count <= room) {
    return "";
  }
  return file.path().string() + " promises " + grouped(count) + " records of at least " + grouped(bytes) +
         " bytes from byte " + grouped(begin) + " on, but ends at byte " + grouped(file.size()) + ", inside record " +
         grouped(room) + "; copy or export it again";
}

tl::expected<double, std::string> millimetres_per_unit(const std::string& unit) {
  static constexpr std::pair<const char*, double> units[] = {
      {"mm", 1}, {"cm", 10}, {"m", 1000}, {"in", 25.4}, {"um", 0.001}};
  for (const auto& [name, millimetres] : units) {
    if (unit == name) {
      return millimetres;
    }
  }
  return tl::make_unexpected("\"" + unit + "\" is not a unit of length known here; give mm, cm, m, in or um");
}

namespace {

tl::expected<std::unique_ptr<PointCloud>, FileError> open_points(const std::filesystem::path& file,
                                                                 const CloudOptions& options) {
  if (options.samples_per_profile == 0 || !(options.millimetres_per_unit > 0)) {
    throw std::invalid_argument("open_cloud: samples_per_profile and millimetres_per_unit must be positive");
  }
  auto input = InputFile::open(file);
  if (!input) {
    return tl::make_unexpected(FileError{input.error()});
  }
  auto cloud = std::make_unique<PointCloud>(std::move(*input), options);
  CloudColumns columns = CloudColumns::cartesian;
  auto source = source_of(cloud->file(), columns);
  if (!cloud->file().error().empty()) {
    return tl::make_unexpected(FileError{cloud->file().error()});
  }
  if (!source) {
    return tl::make_unexpected(FileError{source.error()});
  }
  cloud->take(std::move(*source), columns);
  return cloud;
}

}  // namespace

tl::expected<std::unique_ptr<CloudFile>, FileError> open_cloud(const std::filesystem::path& file,
                                                               const CloudOptions& options) {
  return open_points(file, options);
}

tl::expected<std::vector<std::unique_ptr<CloudFile>>, FileError> open_cloud_parts(const std::filesystem::path& file,
                                                                                  const CloudOptions& options) {
  std::vector<std::unique_ptr<CloudFile>> parts;
  for (std::uint64_t k = 0; k < kCloudParts; ++k) {
    auto part = open_points(file, options);
    if (!part) return tl::make_unexpected(part.error());
    const std::uint64_t all = (*part)->points(), first = all * k / kCloudParts, end = all * (k + 1) / kCloudParts;
    const bool whole = all < kPointsToShare || !(*part)->restrict_to(first, end - first);
    parts.push_back(std::move(*part));
    if (whole) break;
  }
  return parts;
}

}  // namespace celadon
