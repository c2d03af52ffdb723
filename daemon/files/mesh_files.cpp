#include "daemon/files/mesh_files.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>
#include <numbers>
#include <stdexcept>

#include "daemon/files/mesh_rows.h"
#include "daemon/files/sphere_grid.h"
#include "daemon/files/wall_grid.h"
#include "fitting/range_function.h"

namespace celadon {
namespace {

constexpr int kFewestColumns = 16;

using Rows = std::vector<std::vector<Eigen::Vector3d>>;

Rows rows_of(const RangeFunction& wall, const WallGrid& grid) {
  Rows rows(grid.along.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (std::size_t j = 0; j < grid.around(); ++j) {
      const double r = grid.r(i, j), theta = grid.theta_rad[j];
      rows[i].push_back(wall.base().X_WB * Eigen::Vector3d(r * std::cos(theta), r * std::sin(theta),
                                                           wall.base().z_mm(theta, grid.along[i])));
    }
  }
  return rows;
}

// Columns of a grid with every interval cut into equal parts; without the last, which is the first again.
std::vector<double> cut(const std::vector<double>& lines, int parts) {
  std::vector<double> columns;
  columns.reserve((lines.size() - 1) * static_cast<std::size_t>(parts));
  for (std::size_t j = 0; j + 1 < lines.size(); ++j) {
    for (int k = 0; k < parts; ++k) columns.push_back(lines[j] + (lines[j + 1] - lines[j]) * k / parts);
  }
  return columns;
}

// The lines of two sets over one range; those that differ by rounding are one.
std::vector<double> together(const std::vector<double>& a, const std::vector<double>& b) {
  constexpr double kSame = 1e-9;  // radians, some nanometres
  std::vector<double> both;
  std::merge(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
  both.erase(std::unique(both.begin(), both.end(), [](double x, double y) { return y - x < kSame; }), both.end());
  // Both ends are those of the range, whichever of two neighbours was kept.
  if (!b.empty()) both.back() = b.back();
  return both;
}

// A wall's grid on more columns.
WallGrid on_columns(const RangeFunction& wall, WallGrid grid, const std::vector<double>& theta) {
  return grid.theta_rad == theta ? std::move(grid) : wall_grid(wall, theta, std::move(grid.along));
}

// Around a whole turn without its end, which is its start; of a part of it with both ends.
std::vector<double> even_columns(const BaseArcs& arcs, int count) {
  std::vector<double> columns(static_cast<std::size_t>(count + (arcs.closed() ? 0 : 1)));
  const double start = arcs.closed() ? 0 : arcs.start_rad();
  const double range = arcs.closed() ? 2 * std::numbers::pi : arcs.arc_rad() * arcs.count();
  for (std::size_t j = 0; j < columns.size(); ++j) columns[j] = start + range * static_cast<double>(j) / count;
  return columns;
}

bool has_pole(const RangeFunction& range, bool top) {
  const BaseSurface& base = range.base();
  return base.spherical() && (top ? base.band_start == 0 : base.band_end == BaseSurface::kMeridianEnd);
}

// What an end of the rows runs together in; the row of a pole goes.
Eigen::Vector3d close(Rows& rows, const RangeFunction& range, bool top) {
  const Eigen::Isometry3d& X_WB = range.base().X_WB;
  const auto& row = top ? rows.back() : rows.front();
  Eigen::Vector3d end = row.front();
  if (has_pole(range, top)) {
    top ? rows.pop_back() : static_cast<void>(rows.erase(rows.begin()));
    return end;
  }
  // On the axis: every ray from it meets the rim once, so that a fan covers the cap without overlap.
  double height = 0;
  const Eigen::Isometry3d X_BW = X_WB.inverse();
  for (const auto& p : row) height += (X_BW * p).z() / static_cast<double>(row.size());
  return X_WB * Eigen::Vector3d(0, 0, height);
}

void append(std::string& bytes, const void* value, std::size_t size) {
  bytes.append(static_cast<const char*>(value), size);
}

void append_floats(std::string& bytes, const Eigen::Vector3d& vector) {
  const Eigen::Vector3f narrow = vector.cast<float>();
  append(bytes, narrow.data(), 3 * sizeof(float));
}

std::string one_line(const std::string& text) {
  std::string line = text;
  std::replace_if(
      line.begin(), line.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
  return line;
}

}  // namespace

TriangleMesh mesh_of(std::span<const RangeFunction* const> pieces, double chord_mm) {
  const bool open = pieces.size() == 1 && !pieces.front()->base().arcs.closed();
  if (!(chord_mm > 0) || pieces.empty() ||
      !(open || std::all_of(pieces.begin(), pieces.end(), [](const auto* p) { return p->base().arcs.closed(); }))) {
    throw std::invalid_argument("mesh_of: the chord tolerance must be positive and a body of pieces closed around");
  }
  MeshRows body;
  const auto spherical = [](const RangeFunction* piece) { return piece->base().spherical(); };
  if (std::all_of(pieces.begin(), pieces.end(), spherical)) {
    const BaseArcs& arcs = pieces.front()->base().arcs;
    const auto columns = [&](int count) { return even_columns(arcs, count); };
    body.rows = sphere_grid(*pieces.front(), columns, kFewestColumns, chord_mm).rows;
  } else {
    // Pieces share the columns of all walls, cut as finely as the heads need.
    std::vector<WallGrid> grids;
    std::vector<double> theta;
    for (const RangeFunction* piece : pieces) {
      if (piece->base().spherical()) continue;
      grids.push_back(wall_grid(*piece, chord_mm));
      theta = together(theta, grids.back().theta_rad);
    }
    const auto columns = [&](int parts) { return cut(theta, parts); };
    int parts = 1;
    for (const RangeFunction* piece : pieces) {
      if (piece->base().spherical()) parts = sphere_grid(*piece, columns, parts, chord_mm).fineness;
    }
    const double end = theta.back();
    if (parts > 1) {
      theta = columns(parts);
      theta.push_back(end);
    }
    const auto same_columns = [&](int) { return cut(theta, 1); };
    std::size_t walls = 0;
    for (const RangeFunction* piece : pieces) {
      const bool head = piece->base().spherical();
      Rows rows = head ? sphere_grid(*piece, same_columns, 1, chord_mm).rows
                       : rows_of(*piece, on_columns(*piece, std::move(grids[walls]), theta));
      // The rim of a head is the row of the wall, too; between two walls lies a ring.
      const bool shared = !body.rows.empty() && (head || walls == 0);
      body.rows.insert(body.rows.end(), std::make_move_iterator(rows.begin() + (shared ? 1 : 0)),
                       std::make_move_iterator(rows.end()));
      if (!head) ++walls;
    }
  }
  body.closed = !open;
  // A sheet ends in poles alone.
  if (!open || has_pole(*pieces.front(), false)) body.bottom = close(body.rows, *pieces.front(), false);
  if (!open || has_pole(*pieces.back(), true)) body.top = close(body.rows, *pieces.back(), true);
  return mesh_of_rows(body);
}

TriangleMesh mesh_of(const RangeFunction& range, double chord_mm) {
  const RangeFunction* const piece = &range;
  return mesh_of(std::span(&piece, 1), chord_mm);
}

std::string binary_stl(const TriangleMesh& mesh, const std::string& header) {
  std::string bytes = one_line(header).substr(0, 80);
  // Readers take a file that starts with "solid" for text.
  if (bytes.starts_with("solid")) {
    bytes[0] = 'S';
  }
  bytes.resize(80, ' ');
  const auto count = static_cast<std::uint32_t>(mesh.triangles.size());
  bytes.reserve(84 + 50 * mesh.triangles.size());
  append(bytes, &count, sizeof count);
  for (const auto& triangle : mesh.triangles) {
    const Eigen::Vector3d& a = mesh.vertices_mm[triangle[0]];
    const Eigen::Vector3d& b = mesh.vertices_mm[triangle[1]];
    const Eigen::Vector3d& c = mesh.vertices_mm[triangle[2]];
    append_floats(bytes, (b - a).cross(c - a).normalized());
    append_floats(bytes, a);
    append_floats(bytes, b);
    append_floats(bytes, c);
    bytes.append(2, '\0');
  }
  return bytes;
}

std::string binary_ply(const TriangleMesh& mesh, const std::string& header) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\ncomment " + one_line(header) + "\nelement vertex " +
                      std::to_string(mesh.vertices_mm.size()) +
                      "\nproperty float x\nproperty float y\nproperty float z\nelement face " +
                      std::to_string(mesh.triangles.size()) + "\nproperty list uchar int vertex_indices\nend_header\n";
  bytes.reserve(bytes.size() + 12 * mesh.vertices_mm.size() + 13 * mesh.triangles.size());
  for (const Eigen::Vector3d& point : mesh.vertices_mm) {
    append_floats(bytes, point);
  }
  for (const auto& triangle : mesh.triangles) {
    bytes += '\3';
    append(bytes, triangle.data(), 3 * sizeof(std::uint32_t));
  }
  return bytes;
}

}  // namespace celadon
