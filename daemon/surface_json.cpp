#include "daemon/surface_json.h"

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <system_error>

#include <nlohmann/json.hpp>

#include "daemon/json_field.h"

namespace celadon {
namespace {

using nlohmann::json;

constexpr const char *kSurface = "celadon-surface", *kComposite = "celadon-composite";
constexpr std::size_t kMostPieces = 16;
constexpr int kMostArcs = 1024;

// --- writing: own, because arrays of numbers want one row a line and exactly shortest decimals ---

void put(std::string& out, double value) {
  char buffer[32];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, value).ptr;
  out.append(buffer, end);
}

template <class Range>
void put_array(std::string& out, const Range& values) {
  out += '[';
  bool first = true;
  for (const double value : values) {
    if (!std::exchange(first, false)) out += ", ";
    put(out, value);
  }
  out += ']';
}

template <class Row>
void put_rows(std::string& out, Eigen::Index count, const char* indent, Row&& row) {
  out += '[';
  for (Eigen::Index i = 0; i < count; ++i) {
    out += i == 0 ? "\n" : ",\n";
    out += indent;
    row(i);
  }
  out += ']';
}

std::string quoted(const std::string& text) {
  return json(text).dump(-1, ' ', false, json::error_handler_t::replace);
}

// --- reading: every access says where it is ---

using Reader = JsonField;

/// A clamped ascending knot vector over [low, high].
std::vector<double> read_knots(const Reader& field, int degree, std::optional<double> low, std::optional<double> high) {
  auto knots = field.numbers();
  const auto p = static_cast<std::size_t>(degree);
  if (knots.size() < 2 * (p + 1)) {
    field.fail("has " + std::to_string(knots.size()) + " knots, fewer than degree " + std::to_string(degree) +
               " needs");
  }
  for (std::size_t i = 1; i < knots.size(); ++i) {
    if (knots[i] < knots[i - 1]) field.fail("descends at index " + std::to_string(i));
  }
  if (knots[p] != knots.front() || knots[knots.size() - 1 - p] != knots.back() || knots.front() == knots.back()) {
    field.fail("is not clamped for degree " + std::to_string(degree));
  }
  for (std::size_t i = p + 1; i + p + 2 < knots.size(); ++i) {
    if (knots[i] == knots[i + p + 1]) field.fail("repeats a knot more than degree + 1 times");
  }
  if ((low && knots.front() != *low) || (high && knots.back() != *high))
    field.fail("does not span its parameter range");
  return knots;
}

std::shared_ptr<const RangeFunction> read_heights(const Reader& field, const BaseSurface& base) {
  if (base.spherical()) field.fail("is for a cylinder");
  BaseSurface over;
  over.arcs = base.arcs;
  const auto band = field.at("along").numbers(2);
  over.band_start = band[0], over.band_end = band[1];
  if (!(over.band_start <= base.band_start && base.band_end <= over.band_end))
    field.at("along").fail("does not hold the band z_start_mm .. z_end_mm");
  const int q = field.at("degree_v").whole(0, 9);
  auto knots = read_knots(field.at("knots_v"), q, 0., double(base.arcs.count()));
  const auto columns = knots.size() - static_cast<std::size_t>(q) - 1;
  Eigen::MatrixXd rims(2, static_cast<Eigen::Index>(columns));
  for (const char* name : {"lower_mm", "upper_mm"}) {
    const auto row = field.at(name).numbers(columns);
    rims.row(name[0] == 'u') = Eigen::Map<const Eigen::RowVectorXd>(row.data(), rims.cols());
  }
  if (!((rims.row(1) - rims.row(0)).minCoeff() > 0)) field.at("upper_mm").fail("is not above lower_mm");
  return std::make_shared<const RangeFunction>(over, 1, q, std::vector<double>{0, 0, 1, 1}, std::move(knots),
                                               std::move(rims));
}

BaseSurface read_base(const Reader& field) {
  const std::string kind = field.at("kind").text();
  if (kind != "cylinder" && kind != "sphere") {
    field.at("kind").fail("is \"" + kind + "\"; this program reads \"cylinder\" and \"sphere\"");
  }
  BaseSurface base;
  if (kind == "sphere") base.kind = BaseKind::sphere;
  const char *start_name = base.spherical() ? "w_start" : "z_start_mm",
             *end_name = base.spherical() ? "w_end" : "z_end_mm";
  base.band_start = field.at(start_name).number();
  base.band_end = field.at(end_name).number();
  if (!(base.band_start < base.band_end)) field.at(end_name).fail(std::string("is not above ") + start_name);
  if (base.spherical() && !(base.band_start >= 0 && base.band_end <= BaseSurface::kMeridianEnd)) {
    field.at(end_name).fail("or w_start is outside 0 .. 2, the meridian's parameters");
  }
  const int arcs = field.at("arcs").whole(1, kMostArcs);
  const double arc = field.at("arc_rad").number(), start = field.at("start_rad").number();
  if (field.at("closed").boolean()) {
    if (arcs < 3) field.at("arcs").fail("is below 3, which no circle has");
    base.arcs = BaseArcs::circle(arcs, start);
  } else {
    if (!(arc > 0) || arc * arcs > 2 * M_PI * (1 + 1e-12)) field.at("arc_rad").fail("is outside (0, 2 pi / arcs]");
    base.arcs = BaseArcs::open(start, std::min(arc * arcs, 2 * M_PI));
  }
  if (base.arcs.count() != arcs || std::abs(base.arcs.arc_rad() - arc) > 1e-9) {
    field.at("arcs").fail("and arc_rad do not describe equal arcs of at most 90 degrees");
  }
  base.X_WB = field.at("frame").frame();
  if (field.has("heights")) base.heights = read_heights(field.at("heights"), base);
  return base;
}

RangeFunction read_function(const Reader& field, const BaseSurface& base) {
  const int p = field.at("degree_u").whole(0, 9), q = field.at("degree_v").whole(0, 9);
  auto knots_u = base.spherical() ? read_knots(field.at("knots_u"), p, base.band_start, base.band_end)
                                  : read_knots(field.at("knots_u"), p, 0., 1.);
  auto knots_v = read_knots(field.at("knots_v"), q, 0., double(base.arcs.count()));
  const auto rows = knots_u.size() - static_cast<std::size_t>(p) - 1,
             columns = knots_v.size() - static_cast<std::size_t>(q) - 1;
  const Reader coefficients = field.at("coefficients");
  if (coefficients.size() != rows) {
    coefficients.fail("has " + std::to_string(coefficients.size()) + " rows; its knots ask for " +
                      std::to_string(rows));
  }
  Eigen::MatrixXd f(static_cast<Eigen::Index>(rows), static_cast<Eigen::Index>(columns));
  for (std::size_t i = 0; i < rows; ++i) {
    const auto row = coefficients.at(i).numbers(columns);
    f.row(static_cast<Eigen::Index>(i)) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), f.cols());
  }
  return {base, p, q, std::move(knots_u), std::move(knots_v), std::move(f)};
}

DeviationMap read_deviation(const Reader& field, const BaseSurface& base) {
  const auto nodes = [&](const char* name, double low, double high) {
    const Reader list = field.at(name);
    auto values = list.numbers();
    if (values.size() < 2 || values.front() != low || values.back() != high) list.fail("does not span the surface");
    for (std::size_t i = 1; i < values.size(); ++i) {
      if (!(values[i] > values[i - 1])) list.fail("does not ascend at index " + std::to_string(i));
    }
    return values;
  };
  auto along = nodes("along", base.band_start, base.band_end), v = nodes("v", 0, base.arcs.count());
  const Reader rows = field.at("sd_mm");
  if (rows.size() != along.size()) {
    rows.fail("has " + std::to_string(rows.size()) + " rows instead of " + std::to_string(along.size()));
  }
  Eigen::MatrixXd sd(static_cast<Eigen::Index>(along.size()), static_cast<Eigen::Index>(v.size()));
  for (std::size_t i = 0; i < along.size(); ++i) {
    const auto row = rows.at(i).numbers(v.size());
    sd.row(static_cast<Eigen::Index>(i)) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), sd.cols());
    if (sd.row(static_cast<Eigen::Index>(i)).minCoeff() < 0) rows.at(i).fail("has a negative number");
  }
  return {std::move(along), std::move(v), std::move(sd)};
}

NurbsSurface read_surface(const Reader& field) {
  NurbsSurface s;
  s.degree_u = field.at("degree_u").whole(1, 12);
  s.degree_v = field.at("degree_v").whole(1, 12);
  s.closed_v = field.at("closed_v").boolean();
  s.knots_u = read_knots(field.at("knots_u"), s.degree_u, {}, {});
  s.knots_v = read_knots(field.at("knots_v"), s.degree_v, {}, {});
  const Reader points = field.at("control_points");
  const auto rows = static_cast<std::size_t>(s.count_u()), columns = static_cast<std::size_t>(s.count_v());
  if (points.size() != rows) {
    points.fail("has " + std::to_string(points.size()) + " rows; its knots ask for " + std::to_string(rows));
  }
  s.control_points.resize(4, static_cast<Eigen::Index>(rows * columns));
  for (std::size_t i = 0; i < rows; ++i) {
    const Reader row = points.at(i);
    if (row.size() != columns) {
      row.fail("has " + std::to_string(row.size()) + " points; its knots ask for " + std::to_string(columns));
    }
    for (std::size_t j = 0; j < columns; ++j) {
      const auto c = row.at(j).numbers(4);
      if (!(c[3] > 0)) row.at(j).fail("has a weight that is not positive");
      s.control_points.col(static_cast<Eigen::Index>(i * columns + j)) << c[0], c[1], c[2], c[3];
    }
  }
  return s;
}

// The three members of a piece, without the brackets around them.
void put_piece(std::string& out, const SurfacePiece& piece) {
  const NurbsSurface& s = piece.surface;
  const RangeFunction& f = piece.function;
  const BaseSurface& base = f.base();
  out += "  \"surface\": {\n    \"degree_u\": " + std::to_string(s.degree_u) +
         ",\n    \"degree_v\": " + std::to_string(s.degree_v) +
         ",\n    \"closed_v\": " + (s.closed_v ? "true" : "false") + ",\n    \"knots_u\": ";
  put_array(out, s.knots_u);
  out += ",\n    \"knots_v\": ";
  put_array(out, s.knots_v);
  out += ",\n    \"control_points\": ";
  put_rows(out, s.count_u(), "      ", [&](Eigen::Index i) {
    put_rows(out, s.count_v(), "       ", [&](Eigen::Index j) {
      put_array(out, Eigen::Vector4d(s.control_point(static_cast<int>(i), static_cast<int>(j))));
    });
  });

  out += "\n  },\n  \"range_function\": {\n    \"degree_u\": " + std::to_string(f.degree_u()) +
         ",\n    \"degree_v\": " + std::to_string(f.degree_v()) + ",\n    \"knots_u\": ";
  put_array(out, f.knots_u());
  out += ",\n    \"knots_v\": ";
  put_array(out, f.knots_v());
  out += ",\n    \"coefficients\": ";
  put_rows(out, f.coefficients().rows(), "      ",
           [&](Eigen::Index i) { put_array(out, Eigen::VectorXd(f.coefficients().row(i))); });

  out += std::string("\n  },\n  \"base\": {\n    \"kind\": ") +
         (base.spherical() ? "\"sphere\",\n    \"w_start\": " : "\"cylinder\",\n    \"z_start_mm\": ");
  put(out, base.band_start);
  out += base.spherical() ? ",\n    \"w_end\": " : ",\n    \"z_end_mm\": ";
  put(out, base.band_end);
  out += ",\n    \"arcs\": " + std::to_string(base.arcs.count()) + ",\n    \"arc_rad\": ";
  put(out, base.arcs.arc_rad());
  out += ",\n    \"start_rad\": ";
  put(out, base.arcs.start_rad());
  out += std::string(",\n    \"closed\": ") + (base.arcs.closed() ? "true" : "false") + ",\n    \"knots\": ";
  put_array(out, base.arcs.knots());
  out += ",\n    \"control_points\": ";
  const Eigen::MatrixX3d arcs = base.arcs.control_points();
  put_rows(out, arcs.rows(), "      ", [&](Eigen::Index i) { put_array(out, Eigen::Vector3d(arcs.row(i))); });
  out += ",\n    \"frame\": {\"origin\": ";
  put_array(out, Eigen::Vector3d(base.X_WB.translation()));
  const char* axes[] = {"x", "y", "z"};
  for (int k = 0; k < 3; ++k) {
    out += std::string(", \"") + axes[k] + "\": ";
    put_array(out, Eigen::Vector3d(base.X_WB.linear().col(k)));
  }
  out += "}";
  if (base.heights) {
    const RangeFunction& heights = *base.heights;
    out += ",\n    \"heights\": {\n      \"along\": ";
    put_array(out, std::vector<double>{heights.base().band_start, heights.base().band_end});
    out += ",\n      \"degree_v\": " + std::to_string(heights.degree_v()) + ",\n      \"knots_v\": ";
    put_array(out, heights.knots_v());
    out += ",\n      \"lower_mm\": ";
    put_array(out, Eigen::VectorXd(heights.coefficients().row(0)));
    out += ",\n      \"upper_mm\": ";
    put_array(out, Eigen::VectorXd(heights.coefficients().row(1)));
    out += "\n    }";
  }
  out += "\n  }";
  if (piece.deviation) {
    const DeviationMap& map = *piece.deviation;
    out += ",\n  \"standard_deviation\": {\n    \"along\": ";
    put_array(out, map.along());
    out += ",\n    \"v\": ";
    put_array(out, map.v());
    out += ",\n    \"sd_mm\": ";
    put_rows(out, map.sd_mm().rows(), "      ",
             [&](Eigen::Index i) { put_array(out, Eigen::VectorXd(map.sd_mm().row(i))); });
    out += "\n  }";
  }
  out += '\n';
}

SurfacePiece read_piece(const Reader& field) {
  const BaseSurface base = read_base(field.at("base"));
  SurfacePiece piece{read_function(field.at("range_function"), base), read_surface(field.at("surface"))};
  if (field.has("standard_deviation")) piece.deviation = read_deviation(field.at("standard_deviation"), base);
  return piece;
}

}  // namespace

std::string format_surface_json(const SurfaceFile& file) {
  const bool one = file.pieces.size() == 1;
  std::string out;
  Eigen::Index points = 0;
  for (const SurfacePiece& piece : file.pieces) points += piece.surface.control_points.cols();
  out.reserve(static_cast<std::size_t>(points) * 90 + 4096);
  out += std::string("{\n  \"format\": \"") + (one ? kSurface : kComposite) +
         "\",\n  \"version\": 1,\n  \"units\": {\"length\": \"mm\", \"angle\": \"rad\"},\n";
  out += "  \"name\": " + quoted(file.name) + ",\n  \"date\": " + quoted(file.date) +
         ",\n  \"simulated\": " + (file.simulated ? "true" : "false") + ",\n";
  if (one) {
    put_piece(out, file.pieces.front());
  } else {
    out += "  \"pieces\": [";
    for (std::size_t k = 0; k < file.pieces.size(); ++k) {
      out += k == 0 ? "{\n" : "}, {\n";
      put_piece(out, file.pieces[k]);
    }
    out += "}]\n";
  }
  out += "}\n";
  return out;
}

tl::expected<SurfaceFile, std::string> parse_surface_json(const std::string& text, const std::string& source) {
  const auto problem = [&](const std::string& what) {
    return tl::make_unexpected(source + ": " + what + "; give a surface.json that celadon wrote.");
  };
  json root;
  try {
    root = json::parse(text);
  } catch (const json::parse_error& e) {
    return problem("it is not JSON from its byte " + std::to_string(e.byte) + " on");
  } catch (const json::exception&) {
    return problem("it has a number beyond those of double precision");
  }
  try {
    const Reader reader(root, "");
    const std::string format = reader.at("format").text();
    if (format != kSurface && format != kComposite) {
      reader.at("format").fail("is neither \"celadon-surface\" nor \"celadon-composite\"");
    }
    if (reader.at("version").whole(0, 1'000'000) != 1) {
      reader.at("version").fail("is " + root["version"].dump() + "; this program reads version 1");
    }
    SurfaceFile file{{}, reader.at("name").text(), reader.at("date").text(), reader.at("simulated").boolean()};
    if (format == kSurface) {
      file.pieces.push_back(read_piece(reader));
      return file;
    }
    const Reader pieces = reader.at("pieces");
    if (pieces.size() < 2 || pieces.size() > kMostPieces) {
      pieces.fail("has " + std::to_string(pieces.size()) + " pieces, outside 2 .. " + std::to_string(kMostPieces));
    }
    for (std::size_t k = 0; k < pieces.size(); ++k) file.pieces.push_back(read_piece(pieces.at(k)));
    return file;
  } catch (const JsonProblem& p) {
    return problem(p.text);
  }
}

tl::expected<SurfaceFile, std::string> read_surface_json(const std::filesystem::path& file) {
  constexpr std::uintmax_t kLargest = 256u << 20;
  std::error_code code;
  const auto size = std::filesystem::file_size(file, code);
  if (code) {
    return tl::make_unexpected(file.string() + " cannot be read: " + code.message() +
                               "; give an existing surface.json.");
  }
  if (size > kLargest) {
    return tl::make_unexpected(file.string() + " has " + std::to_string(size) +
                               " bytes; surface.json files have at most " + std::to_string(kLargest) + ".");
  }
  std::ifstream in(file, std::ios::binary);
  std::string text(static_cast<std::size_t>(size), '\0');
  if (!in.read(text.data(), static_cast<std::streamsize>(size))) {
    return tl::make_unexpected(file.string() + " cannot be read: " + std::strerror(errno) +
                               "; check its permissions and the disk.");
  }
  return parse_surface_json(text, file.string());
}

}  // namespace celadon
