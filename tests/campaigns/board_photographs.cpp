// A camera from photographs of a chessboard whose size nobody told: which board it is, and how far corners of views
// that had no part in it lie from where it puts them.
//   board_photographs FILE.jpg...

#include <turbojpeg.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <vector>

#include "acquisition/calibrate/adjustment.h"
#include "acquisition/calibrate/board_finder.h"
#include "acquisition/calibrate/held_out.h"
#include "acquisition/calibrate/initial_camera.h"

namespace {

using namespace celadon;

struct Photograph {
  std::string name;
  int width_px = 0, height_px = 0;
  std::vector<std::uint8_t> grey;
};

bool read_jpeg(const std::string& file, Photograph& out) {
  std::ifstream in(file, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(in), {});
  const auto* data = reinterpret_cast<const unsigned char*>(bytes.data());
  out.name = file.substr(file.find_last_of('/') + 1);
  tjhandle decoder = tjInitDecompress();
  int subsampling = 0, space = 0;
  const bool ok =
      tjDecompressHeader3(decoder, data, bytes.size(), &out.width_px, &out.height_px, &subsampling, &space) == 0;
  if (ok) out.grey.resize(static_cast<std::size_t>(out.width_px) * static_cast<std::size_t>(out.height_px));
  const bool whole = ok && tjDecompress2(decoder, data, bytes.size(), out.grey.data(), out.width_px, 0, out.height_px,
                                         TJPF_GRAY, 0) == 0;
  tjDestroy(decoder);
  return whole;
}

/// The board that most of the first photographs show; sides of 1 mm: no length is known.
TargetBoard inferred(const std::vector<Photograph>& photographs) {
  constexpr std::size_t kLooks = 4;
  std::size_t most = 0;
  TargetBoard best(8, 6, 1, false);
  for (int columns = 4; columns <= 14; ++columns) {
    for (int rows = 4; rows <= 14; ++rows) {
      if ((columns + rows) % 2 == 0) continue;  // such a board looks alike from both sides
      const TargetBoard board(columns, rows, 1, false);
      BoardFinder finder(board);
      std::size_t found = 0;
      for (std::size_t k = 0; k < std::min(kLooks, photographs.size()); ++k) {
        const Photograph& p = photographs[k];
        found += finder.find(p.grey, p.width_px, p.height_px).has_value() ? 1 : 0;
      }
      if (found == 0 || (found == most && columns * rows < best.columns() * best.rows())) continue;
      if (found < most) continue;
      most = found;
      best = board;
    }
  }
  return best;
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<Photograph> photographs;
  for (int i = 1; i < argc; ++i) {
    Photograph p;
    if (read_jpeg(argv[i], p))
      photographs.push_back(std::move(p));
    else
      std::printf("%s is no JPEG that can be read\n", argv[i]);
  }
  if (photographs.empty()) {
    std::fprintf(stderr, "board_photographs: name the photographs, JPEG files of one camera\n");
    return 2;
  }
  const TargetBoard board = inferred(photographs);
  BoardFinder finder(board);
  CalibrationInput input{.board = board, .views = {}, .platter = {}, .rim = {}};
  input.width_px = photographs.front().width_px;
  input.height_px = photographs.front().height_px;
  for (const Photograph& p : photographs) {
    auto corners = finder.find(p.grey, p.width_px, p.height_px);
    if (!corners) {
      std::printf("%-22s %s\n", p.name.c_str(), corners.error().c_str());
      continue;
    }
    double sigma = 0;
    for (const SeenCorner& corner : *corners) sigma += corner.sigma_px / static_cast<double>(corners->size());
    std::printf("%-22s %zu corners, stated %.3f px\n", p.name.c_str(), corners->size(), sigma);
    BoardView view;
    view.corners = std::move(*corners);
    input.views.push_back(std::move(view));
  }
  std::printf("board %d x %d squares, seen in %zu of %zu photographs\n", board.columns(), board.rows(),
              input.views.size(), photographs.size());
  auto observations = calibrate::arrange(input);
  if (!observations) return std::fprintf(stderr, "board_photographs: %s\n", observations.error().c_str()), 1;
  auto estimate = calibrate::initial_camera(*observations, input.width_px, input.height_px);
  if (estimate) estimate = calibrate::adjusted(*observations, *estimate);
  if (!estimate) return std::fprintf(stderr, "board_photographs: %s\n", estimate.error().c_str()), 1;
  double squares = 0;
  int corners = 0, left_out = 0;
  for (const auto& view : observations->views) {
    for (const auto& corner : view.corners) {
      if (!view.used || !(corner.weight > 0)) {
        ++left_out;
        continue;
      }
      squares += (corner.residual * corner.sigma_px).squaredNorm();
      ++corners;
    }
  }
  const auto held_out = calibrate::held_out_errors(*observations, *estimate);
  std::printf("f %.1f %.1f px, centre %.1f %.1f px, distortion", estimate->camera[0], estimate->camera[1],
              estimate->camera[2], estimate->camera[3]);
  for (std::size_t i = 4; i < 9; ++i) std::printf(" %.4g", estimate->camera[i]);
  std::printf("\ncorners %.3f px rms, of views held out %.3f px; %d of %d left out\n", std::sqrt(squares / corners),
              held_out.corner_px, left_out, left_out + corners);
  return 0;
}
