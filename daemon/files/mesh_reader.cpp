#include "daemon/files/mesh_reader.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <unordered_map>
#include <utility>

#include "daemon/files/file_problem.h"
#include "daemon/files/input_file.h"
#include "daemon/files/number_text.h"
#include "daemon/files/ply_header.h"

namespace celadon {
namespace {

using Read = tl::expected<TriangleMesh, std::string>;

constexpr std::uint64_t kMostTriangles = 50'000'000;
constexpr std::size_t kMostCorners = 1024;  // of one polygon
constexpr std::size_t kStlHeader = 84, kStlTriangle = 50;

/// Triangles from corners that come one by one.
class Welder {
 public:
  void add(const Eigen::Vector3d& p) {
    const Eigen::Vector3d clean = p + Eigen::Vector3d::Zero();  // -0 becomes 0
    const auto [at, is_new] = known_.try_emplace(clean, static_cast<std::uint32_t>(mesh_.vertices_mm.size()));
    if (is_new) mesh_.vertices_mm.push_back(clean);
    corner_[filled_++] = at->second;
    if (filled_ < 3) return;
    filled_ = 0;
    if (corner_[0] != corner_[1] && corner_[1] != corner_[2] && corner_[2] != corner_[0]) {
      mesh_.triangles.push_back(corner_);
    }
  }
  bool between_triangles() const { return filled_ == 0; }
  TriangleMesh take() { return std::move(mesh_); }

 private:
  struct Hash {
    std::size_t operator()(const Eigen::Vector3d& p) const {
      std::uint64_t h = 0;
      for (const double v : {p.x(), p.y(), p.z()}) {
        std::uint64_t bits = 0;
        std::memcpy(&bits, &v, sizeof bits);
        h = (h ^ bits) * 0x9e3779b97f4a7c15ULL;
        h ^= h >> 29;
      }
      return static_cast<std::size_t>(h);
    }
  };
  std::unordered_map<Eigen::Vector3d, std::uint32_t, Hash> known_;
  std::array<std::uint32_t, 3> corner_{};
  std::size_t filled_ = 0;
  TriangleMesh mesh_;
};

tl::unexpected<std::string> wrong(const InputFile& file, const std::string& what) {
  return tl::make_unexpected(file.path().string() + ": " + what + "; export it again");
}

bool finite(const Eigen::Vector3d& p) {
  return p.allFinite() && p.cwiseAbs().maxCoeff() < 1e9;
}

Read read_binary_stl(const InputFile& file, std::uint32_t count) {
  ByteCursor cursor(file, kStlHeader, file.size());
  Welder welder;
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::string_view record = cursor.peek(kStlTriangle);
    if (record.size() < kStlTriangle) return wrong(file, "it ends inside triangle " + grouped(i));
    for (std::size_t corner = 0; corner < 3; ++corner) {
      Eigen::Vector3d p;
      for (std::size_t k = 0; k < 3; ++k) {
        p[static_cast<Eigen::Index>(k)] =
            static_cast<double>(load_scalar<float>(record.data() + 12 + 12 * corner + 4 * k, false));
      }
      if (!finite(p)) return wrong(file, "triangle " + grouped(i) + " has a corner that is not finite");
      welder.add(p);
    }
    cursor.skip(kStlTriangle);
  }
  return welder.take();
}

Read read_text_stl(const InputFile& file) {
  ByteCursor cursor(file, 0, file.size());
  Welder welder;
  std::string_view line;
  bool too_long = false;
  std::uint64_t number = 0;
  while (cursor.line(line, too_long)) {
    ++number;
    if (take_field(line, Separator::blank) != "vertex") continue;
    Eigen::Vector3d p;
    for (Eigen::Index k = 0; k < 3; ++k) {
      const auto field = take_field(line, Separator::blank);
      const auto value = field ? parse_number(*field) : std::nullopt;
      if (!value) return wrong(file, "line " + grouped(number) + " has no three numbers after \"vertex\"");
      p[k] = *value;
    }
    if (!finite(p)) return wrong(file, "line " + grouped(number) + " has a corner that is not finite");
    welder.add(p);
  }
  if (!welder.between_triangles()) return wrong(file, "it ends inside a triangle");
  return welder.take();
}

/// Numbers of a PLY body one after the other, whatever the format.
class PlyNumbers {
 public:
  PlyNumbers(const InputFile& file, const PlyHeader& header)
      : cursor_(file, header.data_offset, file.size()), format_(header.format) {}

  std::optional<double> next(ScalarType type) {
    if (format_ != PlyFormat::ascii) {
      const std::string_view bytes = cursor_.peek(size_of(type));
      if (bytes.size() < size_of(type)) return std::nullopt;
      const bool swapped = format_ == PlyFormat::big_endian;
      const double value =
          with_type(type, [&]<class T>(T) { return static_cast<double>(load_scalar<T>(bytes.data(), swapped)); });
      cursor_.skip(size_of(type));
      return value;
    }
    while (true) {
      if (const auto field = take_field(line_, Separator::blank)) return parse_number(*field);
      bool too_long = false;
      if (!cursor_.line(line_, too_long)) return std::nullopt;
    }
  }

 private:
  ByteCursor cursor_;
  PlyFormat format_;
  std::string_view line_;
};

/// One record: scalars named x, y, z into p, the list of corners into `corners`. False: it is broken.
bool read_record(PlyNumbers& numbers, const PlyElement& element, Eigen::Vector3d& p, std::vector<double>& corners) {
  for (const PlyProperty& property : element.properties) {
    if (!property.list_length) {
      const auto value = numbers.next(property.type);
      if (!value) return false;
      if (property.name.size() == 1 && property.name[0] >= 'x' && property.name[0] <= 'z') {
        p[property.name[0] - 'x'] = *value;
      }
      continue;
    }
    const auto length = numbers.next(*property.list_length);
    if (!length || !(*length >= 0) || *length > static_cast<double>(kMostCorners)) return false;
    const bool wanted = property.name == "vertex_indices" || property.name == "vertex_index";
    if (wanted) corners.clear();
    for (int i = 0; i < static_cast<int>(*length); ++i) {
      const auto value = numbers.next(property.type);
      if (!value) return false;
      if (wanted) corners.push_back(*value);
    }
  }
  return true;
}

Read read_ply(const InputFile& file) {
  const auto header = read_ply_header(file);
  if (!header) return tl::make_unexpected(header.error());
  PlyNumbers numbers(file, *header);
  TriangleMesh mesh;
  std::vector<double> corners;
  for (const PlyElement& element : header->elements) {
    const std::size_t least = element.least_bytes(header->format);
    if (least == 0) continue;
    if (element.count > file.size() / least + 1) {
      return wrong(file, "its header promises " + grouped(element.count) + " of \"" + element.name +
                             "\", more than the file can hold");
    }
    for (std::uint64_t i = 0; i < element.count; ++i) {
      Eigen::Vector3d p(NAN, NAN, NAN);
      corners.clear();
      if (!read_record(numbers, element, p, corners)) {
        return wrong(file, "\"" + element.name + "\" " + grouped(i) + " is broken or the file ends there");
      }
      if (element.name == "vertex") {
        if (!finite(p)) return wrong(file, "vertex " + grouped(i) + " has no finite x, y and z");
        mesh.vertices_mm.push_back(p);
      } else if (element.name == "face") {
        for (const double corner : corners) {
          if (!(corner >= 0 && corner < static_cast<double>(mesh.vertices_mm.size()) && corner == std::floor(corner))) {
            return wrong(file, "face " + grouped(i) + " names a vertex that does not exist");
          }
        }
        for (std::size_t k = 1; k + 1 < corners.size(); ++k) {
          const std::array<std::uint32_t, 3> t{static_cast<std::uint32_t>(corners[0]),
                                               static_cast<std::uint32_t>(corners[k]),
                                               static_cast<std::uint32_t>(corners[k + 1])};
          if (t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) mesh.triangles.push_back(t);
        }
        if (mesh.triangles.size() > kMostTriangles) return wrong(file, "it has more than 50 million triangles");
      }
    }
  }
  return mesh;
}

Read read_any(const InputFile& file) {
  std::array<char, kStlHeader> head{};
  const std::size_t got = file.read_at(0, head.data(), head.size());
  const std::string_view start(head.data(), got);
  if (start.starts_with("ply\n") || start.starts_with("ply\r")) return read_ply(file);
  // Text in front of a binary STL may begin with "solid" too: the size tells.
  if (got == kStlHeader) {
    const auto count = load_scalar<std::uint32_t>(head.data() + 80, false);
    if (count <= kMostTriangles && kStlHeader + std::uint64_t{kStlTriangle} * count == file.size()) {
      return read_binary_stl(file, count);
    }
  }
  if (start.starts_with("solid")) return read_text_stl(file);
  return wrong(file, "it is neither STL nor PLY");
}

}  // namespace

tl::expected<TriangleMesh, std::string> read_mesh(const std::filesystem::path& path) {
  const auto file = InputFile::open(path);
  if (!file) return tl::make_unexpected(file.error());
  auto mesh = read_any(*file);
  if (!file->error().empty()) return tl::make_unexpected(file->error());
  if (mesh && mesh->triangles.empty()) return wrong(*file, "it holds no triangles");
  return mesh;
}

}  // namespace celadon
