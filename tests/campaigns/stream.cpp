// `celadon fit` on a cloud that no memory holds: half a billion points by default (or as many millions as given),
// written as a binary PLY into the folder given (default: the temporary one; 6 GB). Every pass of the fit against
// reading that file: its bytes alone, and as points by the program's own reader.
#include <fcntl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "daemon/files/cloud_files.h"

namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

[[noreturn]] void fail(const std::string& why) {
  std::fprintf(stderr, "stream: %s\n", why.c_str());
  std::exit(1);
}

// The closed freeform body of the benchmarks in scan order, 0.02 mm of noise from a table of 2^16 normal deviates.
void write_cloud(const fs::path& file, std::size_t points) {
  constexpr std::size_t kRows = 4096;
  std::ofstream out(file, std::ios::binary);
  out << "ply\nformat binary_little_endian 1.0\nelement vertex " << points
      << "\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
  std::mt19937_64 random(5);
  std::normal_distribution<float> normal(0, 0.02F);
  std::vector<float> noise(1 << 16);
  for (float& e : noise) e = normal(random);
  std::vector<float> profile(3 * kRows);
  const std::size_t profiles = (points + kRows - 1) / kRows;
  for (std::size_t i = 0, left = points; i < profiles; ++i) {
    const double t = 2 * std::numbers::pi * (static_cast<double>(i) + 0.5) / static_cast<double>(profiles);
    const double c = std::cos(t), s = std::sin(t), lobes = 3 * std::cos(2 * t);
    const std::size_t rows = std::min(kRows, left), shift = random();
    for (std::size_t j = 0; j < rows; ++j) {
      const double z = 120.0 * static_cast<double>(j) / (kRows - 1), turn = std::numbers::pi * z / 120;
      const double r = 30 + 6 * std::sin(2 * turn) + lobes * std::sin(turn) + 1.5 * std::cos(5 * t + 0.05 * z) +
                       static_cast<double>(noise[(j * 7 + shift) & 0xffff]);
      profile[3 * j] = static_cast<float>(r * c);
      profile[3 * j + 1] = static_cast<float>(r * s);
      profile[3 * j + 2] = static_cast<float>(z);
    }
    out.write(reinterpret_cast<const char*>(profile.data()), static_cast<std::streamsize>(12 * rows));
    left -= rows;
  }
  out.flush();
  if (!out) fail(file.string() + " cannot be written; is there room for " + std::to_string(12 * points >> 20) + " MB?");
}

double read_bytes(const fs::path& file) {
  const int descriptor = open(file.c_str(), O_RDONLY | O_CLOEXEC);
  std::vector<char> piece(1 << 20);
  const auto start = Clock::now();
  while (read(descriptor, piece.data(), piece.size()) > 0) {
  }
  const double seconds = seconds_since(start);
  close(descriptor);
  return seconds;
}

double read_points(const fs::path& file, std::size_t expected) {
  auto cloud = celadon::open_cloud(file, {});
  if (!cloud) fail(cloud.error().message);
  const auto start = Clock::now();
  (*cloud)->rewind();
  std::size_t points = 0;
  while (const celadon::Profile* profile = (*cloud)->next()) points += profile->size();
  const double seconds = seconds_since(start);
  if (points != expected) fail(std::to_string(points) + " points were read");
  return seconds;
}

}  // namespace

int main(int argc, char** argv) {
  const std::size_t points = (argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 500) * 1'000'000;
  const fs::path folder = (argc > 2 ? fs::path(argv[2]) : fs::temp_directory_path()) / "celadon-stream";
  fs::create_directories(folder);
  const fs::path cloud = folder / "cloud.ply", report = folder / "report.json";
  write_cloud(cloud, points);
  const double n = static_cast<double>(points);
  const double bytes_s = read_bytes(cloud), points_s = read_points(cloud, points);
  std::printf(
      "%zu points, %.0f MB of binary PLY\nits bytes read        %7.2f s  %6.2f ns a point\nread as points       %8.2f "
      "s  %6.2f ns\n",
      points, n * 12 / 1e6, bytes_s, bytes_s / n * 1e9, points_s, points_s / n * 1e9);
  std::fflush(stdout);

  const auto start = Clock::now();
  const fs::path program = fs::read_symlink("/proc/self/exe").parent_path() / "celadon";
  const pid_t child = fork();
  if (child == 0) {
    execl(program.c_str(), "celadon", "fit", cloud.c_str(), "--axis", "z", "-o", (folder / "surface.json").c_str(),
          "--report", report.c_str(), static_cast<char*>(nullptr));
    _exit(127);
  }
  int status = 0;
  rusage usage{};
  wait4(child, &status, 0, &usage);
  if (status != 0) fail("celadon fit ended with status " + std::to_string(status));
  const double fit_s = seconds_since(start);
  const auto result = nlohmann::json::parse(std::ifstream(report));
  for (const auto& [stage, seconds] : result["seconds"].items())
    std::printf("%-18s %10.2f s  %6.2f ns  %5.2f x as points  %5.2f x its bytes\n", stage.c_str(),
                seconds.get<double>(), seconds.get<double>() / n * 1e9, seconds.get<double>() / points_s,
                seconds.get<double>() / bytes_s);
  std::printf(
      "whole              %10.2f s, peak memory %.0f MB\n%s, %d x %d control points, noise %.4f mm, residual %.4f mm\n",
      fit_s, static_cast<double>(usage.ru_maxrss) / 1024, result["model"].get<std::string>().c_str(),
      result["control_points"][0].get<int>(), result["control_points"][1].get<int>(), result["noise_mm"].get<double>(),
      result["residual_mm"]["rms"].get<double>());
  fs::remove_all(folder);
  return 0;
}
