#include "daemon/grid_file.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <numbers>
#include <system_error>

#include <nlohmann/json.hpp>

#include "daemon/json_field.h"

namespace celadon {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kMostCells = 65536;
constexpr std::uintmax_t kLargestGridFile = 1 << 20;

const char* to_string(BaseKind base) {
  return base == BaseKind::sphere ? "sphere" : "cylinder";
}
const char* to_string(WeightRule rule) {
  return rule == WeightRule::unit ? "unit" : "covariance";
}

double range_of(const BaseArcs& arcs) {
  return arcs.closed() ? 2 * std::numbers::pi : arcs.count() * arcs.arc_rad();
}

Json frame_json(const Eigen::Isometry3d& X) {
  const auto list = [](const Eigen::Vector3d& v) { return Json::array({v.x(), v.y(), v.z()}); };
  return {{"origin", list(X.translation())},
          {"x", list(X.linear().col(0))},
          {"y", list(X.linear().col(1))},
          {"z", list(X.linear().col(2))}};
}

BaseArcs read_arcs(const JsonField& field) {
  const double start = field.at("start_rad").number(), range = field.at("range_rad").number();
  if (field.at("closed").boolean()) return BaseArcs::full_circle();
  if (!(range > 0 && range <= 2 * std::numbers::pi * (1 + 1e-12)))
    field.at("range_rad").fail("is " + Json(range).dump() + ", outside (0, 2 pi]");
  return BaseArcs::open(start, std::min(range, 2 * std::numbers::pi));
}

int power_of_two(const JsonField& field) {
  const int n = field.whole(1, kMostCells);
  if ((n & (n - 1)) != 0) field.fail("is " + std::to_string(n) + ", no power of two");
  return n;
}

GridSpecification read_cells(const JsonField& file) {
  GridSpecification cells;
  const std::string base = file.at("base").text();
  if (base != "cylinder" && base != "sphere")
    file.at("base").fail("is \"" + base + "\"; this program reads \"cylinder\" and \"sphere\"");
  if (base == "sphere") cells.base = BaseKind::sphere;
  const auto band = file.at("band").numbers(2);
  cells.z_start_mm = band[0];
  cells.z_end_mm = band[1];
  if (!(band[0] < band[1])) file.at("band").fail("does not ascend");
  if (cells.base == BaseKind::sphere && (band[0] != 0 || band[1] != BaseSurface::kMeridianEnd))
    file.at("band").fail("of a sphere is not [0, 2]");
  const JsonField intervals = file.at("intervals"), degree = file.at("degree");
  if (intervals.size() != 2) intervals.fail("is no pair of numbers");
  if (degree.size() != 2) degree.fail("is no pair of numbers");
  cells.z_intervals = power_of_two(intervals.at(std::size_t{0}));
  cells.intervals_per_arc = power_of_two(intervals.at(std::size_t{1}));
  cells.degree_u = degree.at(std::size_t{0}).whole(1, 5);
  cells.degree_v = degree.at(std::size_t{1}).whole(1, 5);
  cells.arcs = read_arcs(file.at("arcs"));
  if (cells.z_intervals > kMostCells / (cells.intervals_per_arc * cells.arcs.count()))
    intervals.fail("make more than " + std::to_string(kMostCells) + " cells");
  return cells;
}

}  // namespace

std::string format_grid(const SumsGrid& grid) {
  const GridSpecification& cells = grid.cells;
  Json json;
  json["format"] = "celadon-grid";
  json["version"] = 1;
  json["units"] = {{"length", "mm"}, {"angle", "rad"}};
  json["base"] = to_string(cells.base);
  json["band"] = {cells.z_start_mm, cells.z_end_mm};
  json["intervals"] = {cells.z_intervals, cells.intervals_per_arc};
  json["degree"] = {cells.degree_u, cells.degree_v};
  json["arcs"] = {
      {"start_rad", cells.arcs.start_rad()}, {"range_rad", range_of(cells.arcs)}, {"closed", cells.arcs.closed()}};
  json["frame"] = frame_json(grid.X_FL);
  json["millimetres_per_unit"] = grid.millimetres_per_unit;
  json["weights"] = to_string(grid.weights);
  return json.dump(2) + "\n";
}

tl::expected<SumsGrid, std::string> parse_grid(const std::string& text, const std::string& source) {
  const auto problem = [&](const std::string& what) {
    return tl::make_unexpected(source + ": " + what + "; give a grid that celadon fit --write-grid wrote.");
  };
  nlohmann::json root;
  try {
    root = nlohmann::json::parse(text);
  } catch (const nlohmann::json::exception&) {
    return problem("it is not JSON");
  }
  try {
    const JsonField file(root, "");
    if (file.at("format").text() != "celadon-grid") file.at("format").fail("is not \"celadon-grid\"");
    if (file.at("version").whole(0, 1'000'000) != 1)
      file.at("version").fail("is " + root["version"].dump() + "; this program reads version 1");
    SumsGrid grid;
    grid.cells = read_cells(file);
    grid.X_FL = file.at("frame").frame();
    grid.millimetres_per_unit = file.at("millimetres_per_unit").number();
    if (!(grid.millimetres_per_unit > 0)) file.at("millimetres_per_unit").fail("is not above 0");
    const std::string weights = file.at("weights").text();
    if (weights != "unit") file.at("weights").fail("are \"" + weights + "\"; this program sums with \"unit\"");
    return grid;
  } catch (const JsonProblem& p) {
    return problem(p.text);
  }
}

tl::expected<SumsGrid, std::string> read_grid(const std::filesystem::path& file) {
  std::error_code code;
  const auto size = std::filesystem::file_size(file, code);
  if (code) return tl::make_unexpected(file.string() + " cannot be read: " + code.message() + "; give a grid file.");
  if (size > kLargestGridFile)
    return tl::make_unexpected(file.string() + " has " + std::to_string(size) + " bytes; grid files have at most " +
                               std::to_string(kLargestGridFile) + ".");
  std::ifstream in(file, std::ios::binary);
  std::string text(static_cast<std::size_t>(size), '\0');
  if (!in.read(text.data(), static_cast<std::streamsize>(size)))
    return tl::make_unexpected(file.string() + " cannot be read: " + std::strerror(errno) + "; check its permissions.");
  return parse_grid(text, file.string());
}

std::optional<std::string> difference(const SumsGrid& a, const std::string& name_a, const SumsGrid& b,
                                      const std::string& name_b) {
  const auto both = [&](const char* what, const auto& of_a, const auto& of_b) {
    return name_a + " has the " + what + " " + Json(of_a).dump() + ", " + name_b + " has " + Json(of_b).dump();
  };
  const auto pair = [](double x, double y) { return Json::array({x, y}); };
  const GridSpecification &x = a.cells, &y = b.cells;
  if (x.base != y.base) return both("base", to_string(x.base), to_string(y.base));
  if (x.z_start_mm != y.z_start_mm || x.z_end_mm != y.z_end_mm)
    return both("band", pair(x.z_start_mm, x.z_end_mm), pair(y.z_start_mm, y.z_end_mm));
  if (x.z_intervals != y.z_intervals || x.intervals_per_arc != y.intervals_per_arc)
    return both("intervals", Json::array({x.z_intervals, x.intervals_per_arc}),
                Json::array({y.z_intervals, y.intervals_per_arc}));
  if (x.degree_u != y.degree_u || x.degree_v != y.degree_v)
    return both("degrees", Json::array({x.degree_u, x.degree_v}), Json::array({y.degree_u, y.degree_v}));
  if (x.arcs != y.arcs)
    return both("angular range", pair(x.arcs.start_rad(), range_of(x.arcs)),
                pair(y.arcs.start_rad(), range_of(y.arcs)));
  if (a.X_FL.matrix() != b.X_FL.matrix()) return both("frame", frame_json(a.X_FL), frame_json(b.X_FL));
  if (a.millimetres_per_unit != b.millimetres_per_unit)
    return both("unit (in mm)", a.millimetres_per_unit, b.millimetres_per_unit);
  if (a.weights != b.weights) return both("weights", to_string(a.weights), to_string(b.weights));
  return std::nullopt;
}

}  // namespace celadon
