// celadon-cad: reads one request from standard input, answers on standard output, ends. See README.md, "Protocol".

#include <unistd.h>

#include <Standard_Failure.hxx>
#include <Standard_Version.hxx>
#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <exception>
#include <string>

#include "daemon/export/cad_protocol.h"
#include "daemon/export/step_text.h"
#include "daemon/export/wall_solid.h"

namespace celadon {
namespace {

constexpr const char* usage =
    "celadon-cad writes CAD files for celadon and celadond, which start it themselves.\n"
    "It reads one request from standard input and answers on standard output; daemon/export/README.md has the "
    "grammar.\n"
    "  --help     this text\n"
    "  --version  the versions of the protocol and of OpenCASCADE\n";

bool read_fully(int fd, char* bytes, std::size_t count) {
  while (count > 0) {
    const ssize_t got = ::read(fd, bytes, count);
    if (got == 0 || (got < 0 && errno != EINTR)) {
      return false;
    }
    if (got > 0) {
      bytes += got;
      count -= static_cast<std::size_t>(got);
    }
  }
  return true;
}

bool write_fully(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno != EINTR) {
      return false;
    }
    bytes.remove_prefix(static_cast<std::size_t>(written > 0 ? written : 0));
  }
  return true;
}

tl::expected<CadMessage, std::string> read_request(int fd) {
  std::string line;
  for (char byte = 0; line.size() < cad_first_line_limit; line += byte) {
    if (!read_fully(fd, &byte, 1)) {
      return tl::make_unexpected(std::string("standard input ended within the first line"));
    }
    if (byte == '\n') {
      break;
    }
  }
  const auto sizes = decode_first_line(line);
  if (!sizes) {
    return tl::make_unexpected(sizes.error());
  }
  CadMessage message;
  std::string head(sizes->head, '\0');
  message.payload.resize(sizes->payload);
  if (!read_fully(fd, head.data(), head.size()) || !read_fully(fd, message.payload.data(), message.payload.size())) {
    return tl::make_unexpected(std::string("standard input ended within the request"));
  }
  message.head = nlohmann::json::parse(head, nullptr, false);
  return message;
}

CadMessage failure(const std::string& why) {
  return {{{"error", why}}, {}};
}

CadMessage answer(const tl::expected<CadMessage, std::string>& message) {
  if (!message) {
    return failure(message.error());
  }
  const auto request = parse_step_request(*message);
  if (!request) {
    return failure(request.error());
  }
  // If daemon and limit are gone, nobody ends a computation that does not end.
  ::alarm(static_cast<unsigned>(std::max(1, request->options.time_limit_s)) + 1);
  try {
    const bool open = request->walls.size() == 1 && !request->walls.front().closed_v;
    const auto body = open ? shell_of_wall(request->walls.front()) : solid_of_walls(request->walls);
    if (!body) {
      return failure(body.error());
    }
    auto text = step_text(*body, request->options);
    if (!text) {
      return failure(text.error());
    }
    return {{{"volume_mm3", body->volume_mm3},
             {"valid", true},
             {"faces", body->walls.size() + body->caps.size()},
             {"closed", body->closed}},
            std::move(*text)};
  } catch (const Standard_Failure& error) {
    return failure(std::string("OpenCASCADE: ") + error.DynamicType()->Name() + ": " + error.GetMessageString());
  }
}

}  // namespace
}  // namespace celadon

int main(int count, char** arguments) {
  using namespace celadon;
  if (count > 1) {
    if (std::strcmp(arguments[1], "--help") == 0) {
      std::fputs(usage, stdout);
      return 0;
    }
    if (std::strcmp(arguments[1], "--version") == 0) {
      std::puts("celadon-cad protocol 2, Open CASCADE " OCC_VERSION_COMPLETE);
      return 0;
    }
    std::fprintf(stderr, "celadon-cad takes no argument \"%s\"; see celadon-cad --help\n", arguments[1]);
    return 2;
  }
  if (::isatty(STDIN_FILENO) == 1) {
    std::fputs(usage, stderr);
    return 2;
  }
  try {
    // Anything a library prints must not mix with the answer.
    const int answers = ::dup(STDOUT_FILENO);
    if (answers < 0 || ::dup2(STDERR_FILENO, STDOUT_FILENO) < 0) {
      std::perror("celadon-cad: cannot keep standard output for the answer");
      return 4;
    }
    prepare_step();
    const auto request = read_request(STDIN_FILENO);
    const CadMessage reply = answer(request);
    if (!write_fully(answers, encode(reply))) {
      return 4;
    }
    return reply.head.contains("error") ? 2 : 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "celadon-cad: %s\n", error.what());
    return 4;
  }
}
