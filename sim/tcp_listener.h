#pragma once
#include <string>

#include <tl/expected.hpp>

#include "sim/file_descriptor.h"

namespace celadon::sim {

struct TcpListener {
  FileDescriptor fd;    ///< not blocking
  std::string address;  ///< HOST:PORT as clients write it
};

/// Listens on HOST:PORT (port 0: a free one). @param what is served, for the sentence that says what failed
tl::expected<TcpListener, std::string> listen_tcp(const std::string& host_and_port, const std::string& what);

}  // namespace celadon::sim
