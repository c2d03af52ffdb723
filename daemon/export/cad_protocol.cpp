#include "daemon/export/cad_protocol.h"

#include <bit>
#include <charconv>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <utility>

namespace celadon {
namespace {

constexpr std::string_view greeting = "CELADON-CAD 2 ";
constexpr std::size_t most_walls = 16;
static_assert(std::endian::native == std::endian::little, "payloads are little-endian doubles");

void append_doubles(std::string& bytes, const double* values, std::size_t count) {
  bytes.append(reinterpret_cast<const char*>(values), count * sizeof(double));
}

}  // namespace

std::string encode(const CadMessage& message) {
  const std::string head = message.head.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  std::string bytes(greeting);
  bytes += std::to_string(head.size()) + " " + std::to_string(message.payload.size()) + "\n";
  bytes += head;
  bytes += message.payload;
  return bytes;
}

tl::expected<CadMessageSizes, std::string> decode_first_line(std::string_view line) {
  CadMessageSizes sizes;
  if (line.starts_with(greeting)) {
    line.remove_prefix(greeting.size());
    const auto head = std::from_chars(line.data(), line.data() + line.size(), sizes.head);
    if (head.ec == std::errc() && head.ptr != line.data() + line.size() && *head.ptr == ' ') {
      const auto payload = std::from_chars(head.ptr + 1, line.data() + line.size(), sizes.payload);
      // A surface or file beyond these sizes is a mistake, and must not become an allocation.
      if (payload.ec == std::errc() && payload.ptr == line.data() + line.size() && sizes.head <= (1U << 20) &&
          sizes.payload <= (std::size_t{1} << 32)) {
        return sizes;
      }
    }
  }
  return tl::make_unexpected(std::string("the first line is not \"CELADON-CAD 2 HEAD-BYTES PAYLOAD-BYTES\""));
}

CadMessage step_request(std::span<const NurbsSurface> walls, const CadOptions& options) {
  CadMessage message;
  message.head = {{"format", options.ap214 ? "AP214" : "AP242"},
                  {"name", options.name},
                  {"simulated", options.simulated},
                  {"date", options.date},
                  {"time_limit_s", options.time_limit_s},
                  {"bottom_measured", options.bottom_measured},
                  {"top_measured", options.top_measured},
                  {"walls", nlohmann::json::array()}};
  for (const NurbsSurface& wall : walls) {
    const auto points = static_cast<std::size_t>(wall.control_points.cols());
    if (wall.count_u() < 2 || wall.count_v() < 2 ||
        points != static_cast<std::size_t>(wall.count_u()) * static_cast<std::size_t>(wall.count_v())) {
      throw std::invalid_argument("step_request: " + std::to_string(points) + " control points for " +
                                  std::to_string(wall.count_u()) + " x " + std::to_string(wall.count_v()));
    }
    message.head["walls"].push_back({{"degree", {wall.degree_u, wall.degree_v}},
                                     {"knots", {wall.knots_u.size(), wall.knots_v.size()}},
                                     {"closed_v", wall.closed_v}});
    append_doubles(message.payload, wall.knots_u.data(), wall.knots_u.size());
    append_doubles(message.payload, wall.knots_v.data(), wall.knots_v.size());
    append_doubles(message.payload, wall.control_points.data(), 4 * points);
  }
  return message;
}

namespace {

struct KnotCounts {
  std::size_t u = 0, v = 0;
};

std::optional<std::string> size_problem(const NurbsSurface& wall, const KnotCounts& knots) {
  if (wall.degree_u < 1 || wall.degree_u > 25 || wall.degree_v < 1 || wall.degree_v > 25) {
    return "degree (" + std::to_string(wall.degree_u) + ", " + std::to_string(wall.degree_v) +
           ") is not within 1 .. 25";
  }
  if (knots.u < 2 * static_cast<std::size_t>(wall.degree_u + 1) ||
      knots.v < 2 * static_cast<std::size_t>(wall.degree_v + 1) || knots.u > 1000000 || knots.v > 1000000) {
    return "knot vectors of lengths " + std::to_string(knots.u) + " and " + std::to_string(knots.v) +
           " do not fit the degrees";
  }
  return std::nullopt;
}

std::size_t points_of(const NurbsSurface& wall, const KnotCounts& knots) {
  return (knots.u - static_cast<std::size_t>(wall.degree_u + 1)) *
         (knots.v - static_cast<std::size_t>(wall.degree_v + 1));
}

}  // namespace

tl::expected<StepRequest, std::string> parse_step_request(const CadMessage& message) {
  const auto refuse = [](std::string why) { return tl::make_unexpected(std::move(why)); };
  StepRequest request;
  std::vector<KnotCounts> knots;
  try {
    const nlohmann::json& head = message.head;
    const std::string format = head.at("format");
    if (format != "AP214" && format != "AP242") {
      return refuse("format \"" + format + "\" is neither AP242 nor AP214");
    }
    request.options.ap214 = format == "AP214";
    request.options.name = head.at("name");
    request.options.simulated = head.at("simulated");
    request.options.date = head.at("date");
    request.options.time_limit_s = head.at("time_limit_s");
    request.options.bottom_measured = head.value("bottom_measured", false);
    request.options.top_measured = head.value("top_measured", false);
    for (const auto& of_wall : head.at("walls")) {
      NurbsSurface wall;
      wall.degree_u = of_wall.at("degree").at(0);
      wall.degree_v = of_wall.at("degree").at(1);
      wall.closed_v = of_wall.at("closed_v");
      knots.push_back({of_wall.at("knots").at(0), of_wall.at("knots").at(1)});
      request.walls.push_back(std::move(wall));
    }
  } catch (const nlohmann::json::exception& error) {
    return refuse(std::string("the request's head: ") + error.what());
  }
  if (request.walls.empty() || request.walls.size() > most_walls) {
    return refuse(std::to_string(request.walls.size()) + " walls are not within 1 .. " + std::to_string(most_walls));
  }
  std::size_t bytes = 0;
  for (std::size_t k = 0; k < knots.size(); ++k) {
    if (auto problem = size_problem(request.walls[k], knots[k])) {
      return refuse(std::move(*problem));
    }
    bytes += (knots[k].u + knots[k].v + 4 * points_of(request.walls[k], knots[k])) * sizeof(double);
  }
  if (message.payload.size() != bytes) {
    return refuse("the payload has " + std::to_string(message.payload.size()) + " bytes in place of " +
                  std::to_string(bytes));
  }
  const char* next = message.payload.data();
  const auto take = [&next](double* values, std::size_t count) {
    std::memcpy(values, next, count * sizeof(double));
    next += count * sizeof(double);
  };
  for (std::size_t k = 0; k < knots.size(); ++k) {
    NurbsSurface& wall = request.walls[k];
    const std::size_t points = points_of(wall, knots[k]);
    wall.knots_u.resize(knots[k].u);
    wall.knots_v.resize(knots[k].v);
    wall.control_points.resize(4, static_cast<Eigen::Index>(points));
    take(wall.knots_u.data(), knots[k].u);
    take(wall.knots_v.data(), knots[k].v);
    take(wall.control_points.data(), 4 * points);
  }
  return request;
}

}  // namespace celadon
