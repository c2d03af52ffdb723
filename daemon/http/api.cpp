#include "daemon/http/api.h"

#include <algorithm>
#include <charconv>
#include <functional>
#include <nlohmann/json.hpp>

namespace celadon {
namespace {

using nlohmann::json;

// Host names that a browser can only reach on this machine; a port may follow.
bool is_this_machine(std::string host) {
  const auto port = host.rfind(':');
  if (port != std::string::npos && host.find(']', port) == std::string::npos) host.resize(port);
  return host.empty() || host == "localhost" || host == "127.0.0.1" || host == "[::1]";
}

bool origin_is_this_machine(const std::string& origin) {
  if (origin.empty()) return true;
  for (const char* scheme : {"http://", "https://"}) {
    const std::string prefix(scheme);
    if (origin.rfind(prefix, 0) == 0)
      return origin.size() > prefix.size() && is_this_machine(origin.substr(prefix.size()));
  }
  return false;
}

std::vector<std::string> segments(const std::string& target) {
  std::vector<std::string> parts;
  const std::string path = target.substr(0, target.find('?'));
  for (std::size_t at = 0; at < path.size();) {
    const std::size_t next = std::min(path.find('/', at + 1), path.size());
    parts.push_back(path.substr(at + 1, next - at - 1));
    at = next;
  }
  return parts;
}

std::optional<std::uint64_t> number(const std::string& text) {
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || text.empty()) return std::nullopt;
  return value;
}

const char* media_type(const std::string& name) {
  const auto ends = [&](const char* suffix) {
    const std::string s(suffix);
    return name.size() >= s.size() && name.compare(name.size() - s.size(), s.size(), s) == 0;
  };
  if (ends(".json")) return "application/json";
  if (ends(".svg")) return "image/svg+xml";
  if (ends(".step")) return "model/step";
  if (ends(".stl")) return "model/stl";
  return "application/octet-stream";
}

ApiReply json_reply(int status, const json& body) {
  ApiReply reply;
  reply.status = status;
  reply.body = body.dump() + "\n";
  return reply;
}

ApiReply refused(const ServiceError& error) {
  return problem(error.status, error.title, error.detail);
}

ApiReply method_not_allowed(const std::string& allow) {
  ApiReply reply = problem(405, "method not allowed", "this path takes " + allow + " only");
  reply.allow = allow;
  return reply;
}

/// The body of a POST, {} if there is none.
tl::expected<json, ApiReply> body_of(const ApiRequest& request) {
  if (request.content_type.rfind("application/json", 0) != 0) {
    return tl::make_unexpected(
        problem(415, "unsupported media type", "the body is application/json, not '" + request.content_type + "'"));
  }
  json body = request.body.empty() ? json::object() : json::parse(request.body, nullptr, false);
  if (body.is_discarded()) {
    return tl::make_unexpected(
        problem(400, "not JSON", "the body is not valid JSON; send an object, {} for the defaults"));
  }
  return body;
}

ApiReply created(const JobRecord& job, const json& body, const std::string& kind) {
  ApiReply reply = json_reply(201, body);
  reply.location = "/api/v1/" + kind + "/" + std::to_string(job.id);
  return reply;
}

ApiReply post_scan(ScanService& service, const ApiRequest& request) {
  const auto body = body_of(request);
  if (!body) return body.error();
  auto parsed = scan_request_from_json(*body);
  if (!parsed) return refused(parsed.error());
  const auto record = service.submit(*parsed, "api");
  if (!record) return refused(record.error());
  return created(*record, to_json(*record), "scans");
}

ApiReply post_calibration(ScanService& service, const ApiRequest& request) {
  const auto body = body_of(request);
  if (!body) return body.error();
  auto parsed = calibration_request_from_json(*body);
  if (!parsed) return refused(parsed.error());
  const auto record = service.calibrate(*parsed, "api");
  if (!record) return refused(record.error());
  return created(*record, to_json(*record), "calibrations");
}

ApiReply get_calibrations(ScanService& service) {
  json list = json::array();
  for (const auto& record : service.calibrations()) list.push_back(to_json(record));
  return json_reply(200, json{{"calibrations", list}});
}

ApiReply get_scans(ScanService& service) {
  json list = json::array();
  for (const auto& record : service.scans()) list.push_back(to_json(record));
  return json_reply(200, json{{"scans", list}});
}

ApiReply get_file(const JobRecord& job, const std::string& name) {
  // Only names the record lists: nothing else of the disk can be asked for.
  if (std::find(job.files.begin(), job.files.end(), name) == job.files.end()) {
    return problem(404, "no such file",
                   "job " + std::to_string(job.id) + " (" + to_string(job.state) + ") has no file '" + name + "'");
  }
  ApiReply reply;
  reply.content_type = media_type(name);
  reply.file = job.folder / name;
  return reply;
}

ApiReply no_such_path(const ApiRequest& request) {
  return problem(404, "no such path",
                 "'" + request.target.substr(0, 200) + "' is not part of the API; openapi.yaml lists it");
}

/// What scans and calibrations have in common. @param present  the record as it is now
ApiReply job_paths(ScanService& service, const ApiRequest& request, const std::vector<std::string>& path,
                   const JobRecord& job, const std::function<json()>& present) {
  if (path.size() == 4) {
    if (request.method != "GET") return method_not_allowed("GET");
    return json_reply(200, present());
  }
  if (path.size() == 5 && path[4] == "cancel") {
    if (request.method != "POST") return method_not_allowed("POST");
    if (auto cancelled = service.cancel(job.id); !cancelled) return refused(cancelled.error());
    return json_reply(200, present());
  }
  if (path.size() == 5 && path[4] == "events") {
    if (request.method != "GET") return method_not_allowed("GET");
    ApiReply reply;
    reply.events = true;
    reply.events_of = job.id;
    return reply;
  }
  if (path.size() == 6 && path[4] == "files") {
    if (request.method != "GET") return method_not_allowed("GET");
    return get_file(job, path[5]);
  }
  return no_such_path(request);
}

ApiReply scan_paths(ScanService& service, const ApiRequest& request, const std::vector<std::string>& path) {
  const auto id = number(path[3]);
  const auto record = id ? service.scan(*id) : std::nullopt;
  if (!record) return problem(404, "no such scan", "there is no scan '" + path[3] + "'; GET /api/v1/scans lists them");
  return job_paths(service, request, path, *record, [&] { return to_json(*service.scan(*id)); });
}

ApiReply post_confirm(ScanService& service, const ApiRequest& request, std::uint64_t id) {
  const auto body = body_of(request);
  if (!body) return body.error();
  const auto step = confirmed_step_from_json(*body);
  if (!step) return refused(step.error());
  if (auto confirmed = service.confirm(id, *step); !confirmed) return refused(confirmed.error());
  return json_reply(200, to_json(*service.calibration(id)));
}

ApiReply calibration_paths(ScanService& service, const ApiRequest& request, const std::vector<std::string>& path) {
  const auto id = number(path[3]);
  const auto record = id ? service.calibration(*id) : std::nullopt;
  if (!record) {
    return problem(404, "no such calibration",
                   "there is no calibration '" + path[3] + "'; GET /api/v1/calibrations lists them");
  }
  if (path.size() == 5 && path[4] == "confirm") {
    if (request.method != "POST") return method_not_allowed("POST");
    return post_confirm(service, request, *id);
  }
  return job_paths(service, request, path, *record, [&] { return to_json(*service.calibration(*id)); });
}

}  // namespace

std::vector<std::string> api_routes() {
  return {"GET /api/v1/device",
          "GET /api/v1/events",
          "GET /api/v1/calibrations",
          "POST /api/v1/calibrations",
          "GET /api/v1/calibrations/{id}",
          "POST /api/v1/calibrations/{id}/confirm",
          "POST /api/v1/calibrations/{id}/cancel",
          "GET /api/v1/calibrations/{id}/events",
          "GET /api/v1/calibrations/{id}/files/{name}",
          "GET /api/v1/scans",
          "POST /api/v1/scans",
          "GET /api/v1/scans/{id}",
          "POST /api/v1/scans/{id}/cancel",
          "GET /api/v1/scans/{id}/events",
          "GET /api/v1/scans/{id}/files/{name}"};
}

ApiReply problem(int status, const std::string& title, const std::string& detail) {
  ApiReply reply =
      json_reply(status, json{{"type", "about:blank"}, {"title", title}, {"status", status}, {"detail", detail}});
  reply.content_type = "application/problem+json";
  return reply;
}

ApiReply answer(ScanService& service, const ApiRequest& request) {
  if (!is_this_machine(request.host) || !origin_is_this_machine(request.origin)) {
    return problem(403, "not from here",
                   "host '" + request.host + "', origin '" + request.origin + "': only this machine may use the API");
  }
  const auto path = segments(request.target);
  if (path.size() >= 3 && path[0] == "api" && path[1] == "v1") {
    if (path[2] == "device" && path.size() == 3) {
      return request.method == "GET" ? json_reply(200, to_json(service.machine())) : method_not_allowed("GET");
    }
    if (path[2] == "events" && path.size() == 3) {
      if (request.method != "GET") return method_not_allowed("GET");
      ApiReply reply;
      reply.events = true;
      return reply;
    }
    if (path[2] == "scans" && path.size() == 3) {
      if (request.method == "GET") return get_scans(service);
      if (request.method == "POST") return post_scan(service, request);
      return method_not_allowed("GET, POST");
    }
    if (path[2] == "scans") return scan_paths(service, request, path);
    if (path[2] == "calibrations" && path.size() == 3) {
      if (request.method == "GET") return get_calibrations(service);
      if (request.method == "POST") return post_calibration(service, request);
      return method_not_allowed("GET, POST");
    }
    if (path[2] == "calibrations") return calibration_paths(service, request, path);
  }
  return no_such_path(request);
}

std::optional<ByteRange> parse_range(const std::string& header, std::uint64_t size) {
  const std::string unit = "bytes=";
  if (header.rfind(unit, 0) != 0 || header.find(',') != std::string::npos) return std::nullopt;
  const std::string range = header.substr(unit.size());
  const auto dash = range.find('-');
  if (dash == std::string::npos) return std::nullopt;
  const auto first = number(range.substr(0, dash));
  const auto last = number(range.substr(dash + 1));
  if (dash == 0) {  // the last n bytes
    if (!last) return std::nullopt;
    return ByteRange{size - std::min(*last, size), size};
  }
  if (!first || (!last && dash + 1 != range.size()) || (last && *last < *first)) return std::nullopt;
  if (*first >= size) return ByteRange{size, size};
  return ByteRange{*first, last ? std::min(*last, size - 1) + 1 : size};
}

}  // namespace celadon
