#include "daemon/export/cad_protocol.h"

#include <bit>
#include <charconv>
#include <cstring>
#include <stdexcept>

namespace celadon {
namespace {

constexpr std::string_view greeting = "CELADON-CAD 1 ";
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
  return tl::make_unexpected(std::string("the first line is not \"CELADON-CAD 1 HEAD-BYTES PAYLOAD-BYTES\""));
}

CadMessage step_request(const NurbsSurface& wall, const CadOptions& options) {
  const auto points = static_cast<std::size_t>(wall.control_points.cols());
  if (wall.count_u() < 2 || wall.count_v() < 2 ||
      points != static_cast<std::size_t>(wall.count_u()) * static_cast<std::size_t>(wall.count_v())) {
    throw std::invalid_argument("step_request: " + std::to_string(points) + " control points for " +
                                std::to_string(wall.count_u()) + " x " + std::to_string(wall.count_v()));
  }
  CadMessage message;
  message.head = {{"format", options.ap214 ? "AP214" : "AP242"},
                  {"name", options.name},
                  {"simulated", options.simulated},
                  {"date", options.date},
                  {"time_limit_s", options.time_limit_s},
                  {"degree", {wall.degree_u, wall.degree_v}},
                  {"knots", {wall.knots_u.size(), wall.knots_v.size()}},
                  {"closed_v", wall.closed_v}};
  append_doubles(message.payload, wall.knots_u.data(), wall.knots_u.size());
  append_doubles(message.payload, wall.knots_v.data(), wall.knots_v.size());
  append_doubles(message.payload, wall.control_points.data(), 4 * points);
  return message;
}

tl::expected<StepRequest, std::string> parse_step_request(const CadMessage& message) {
  const auto refuse = [](std::string why) { return tl::make_unexpected(std::move(why)); };
  StepRequest request;
  std::size_t knots_u = 0;
  std::size_t knots_v = 0;
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
    request.wall.degree_u = head.at("degree").at(0);
    request.wall.degree_v = head.at("degree").at(1);
    knots_u = head.at("knots").at(0);
    knots_v = head.at("knots").at(1);
    request.wall.closed_v = head.at("closed_v");
  } catch (const nlohmann::json::exception& error) {
    return refuse(std::string("the request's head: ") + error.what());
  }
  const auto order_u = static_cast<std::size_t>(request.wall.degree_u + 1);
  const auto order_v = static_cast<std::size_t>(request.wall.degree_v + 1);
  if (request.wall.degree_u < 1 || request.wall.degree_u > 25 || request.wall.degree_v < 1 ||
      request.wall.degree_v > 25) {
    return refuse("degree (" + std::to_string(request.wall.degree_u) + ", " + std::to_string(request.wall.degree_v) +
                  ") is not within 1 .. 25");
  }
  if (knots_u < 2 * order_u || knots_v < 2 * order_v || knots_u > 1000000 || knots_v > 1000000) {
    return refuse("knot vectors of lengths " + std::to_string(knots_u) + " and " + std::to_string(knots_v) +
                  " do not fit the degrees");
  }
  const std::size_t points = (knots_u - order_u) * (knots_v - order_v);
  const std::size_t bytes = (knots_u + knots_v + 4 * points) * sizeof(double);
  if (message.payload.size() != bytes) {
    return refuse("the payload has " + std::to_string(message.payload.size()) + " bytes in place of " +
                  std::to_string(bytes));
  }
  const char* next = message.payload.data();
  const auto take = [&next](double* values, std::size_t count) {
    std::memcpy(values, next, count * sizeof(double));
    next += count * sizeof(double);
  };
  request.wall.knots_u.resize(knots_u);
  request.wall.knots_v.resize(knots_v);
  request.wall.control_points.resize(4, static_cast<Eigen::Index>(points));
  take(request.wall.knots_u.data(), knots_u);
  take(request.wall.knots_v.data(), knots_v);
  take(request.wall.control_points.data(), 4 * points);
  return request;
}

}  // namespace celadon
