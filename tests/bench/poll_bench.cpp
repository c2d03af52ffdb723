// What polling the controller costs the host: share of one core of the polling thread, 200 Hz over Modbus TCP and 50 Hz
// over Modbus RTU (a pseudo terminal), against the limit of 5 %. Real time, the virtual scanner in another thread.
#include <sys/resource.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <thread>
#include <tuple>

#include "firmware_bridge/scanner_device.h"
#include "sim/server.h"

namespace {

using namespace celadon;

constexpr double kLimit = 0.05;
constexpr int kSeconds = 5;

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_THREAD, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

/// @returns share of a core, negative on failure
double measure(const std::string& url, int hertz) {
  MonotonicClock clock;
  auto transport = open_transport(url);
  if (!transport) return -1;
  auto device = ScannerDevice::open(std::move(*transport), clock);
  if (!device) return -1;
  const std::int64_t start_ns = clock.now_ns();
  const double before_s = cpu_seconds();
  for (int k = 1; k <= hertz * kSeconds; ++k) {
    if (!(*device)->poll()) return -1;
    clock.sleep_until(start_ns + std::int64_t{k} * 1'000'000'000 / hertz);
  }
  const double share = (cpu_seconds() - before_s) / (1e-9 * static_cast<double>(clock.now_ns() - start_ns));
  const LinkQuality& link = (*device)->link_quality();
  std::printf("round trip of the last poll %.2f ms, longest %.2f ms; ", static_cast<double>(link.round_trip_ns) * 1e-6,
              static_cast<double>(link.longest_round_trip_ns) * 1e-6);
  return share;
}

}  // namespace

int main() {
  sim::ServerOptions options;
  sim::CameraConfig camera;
  camera.width_px = camera.height_px = 64;
  options.device = sim::default_device(camera);
  options.modbus_rtu = true;
  auto server = sim::Server::open(options);
  if (!server) return 4;
  std::thread thread([&] { (*server)->run(); });
  bool good = true;
  for (const auto& [url, hertz, name] :
       {std::tuple{(*server)->modbus_url(), 200, "TCP"}, std::tuple{(*server)->modbus_rtu_url(), 50, "RTU"}}) {
    const double share = measure(url, hertz);
    std::printf("%s at %d Hz: %.2f %% of a core, %.2f of the limit of 5 %%\n", name, hertz, 100 * share,
                share / kLimit);
    good = good && share >= 0 && share < kLimit;
  }
  (*server)->stop();
  thread.join();
  return good ? 0 : 1;
}
