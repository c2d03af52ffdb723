#pragma once
// Sub-pixel position of the laser line in each row, or each column, of a frame. Source: README.md, "Line extraction".

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "acquisition/frame.h"

namespace celadon {

enum class LineChannel : std::uint8_t { luma, red, green };  ///< of YUYV; grey frames use luma
enum class LineRefinement : std::uint8_t { zero_crossing, quasi_maximum_likelihood };
/// What is searched for the line: each row (it stands upright in the picture), or each column (it lies; the camera is
/// mounted on its side). In this file a row is a row or a column accordingly.
enum class LineAlong : std::uint8_t { rows, columns };
enum class RowStatus : std::uint8_t {
  found = 0,
  no_line = 1,
  ambiguous = 2,
  saturated = 3
};  ///< saturated rows have a position

struct LaserLineOptions {
  LineChannel channel = LineChannel::luma;
  LineAlong along = LineAlong::rows;
  LineRefinement refinement = LineRefinement::quasi_maximum_likelihood;
  int minimum_contrast = 7;    ///< grey levels of the decimated score
  int ambiguous_percent = 70;  ///< second peak over this share of the first: ambiguous, unless continuity tells
  bool continuity = true;      ///< of two peaks in a row take the one that goes on beyond the stretch that has two
  float read_noise = 1.5f;     ///< grey levels
  float electrons_per_level = 40.f;
  float speckle_contrast = 0.25f;  ///< standard deviation over mean of one pixel, of this laser and camera
  float speckle_extent_px = 2.f;   ///< pixels a grain spans along the row: sum of the speckle's autocorrelation
};

/// One row of a line.
struct LineRow {
  float x_px = -1;      ///< along the row (column), pixel centres at whole numbers; -1 without a line
  float sigma_px = 0;   ///< standard deviation of x_px, from amplitude, width, noise and speckle
  float amplitude = 0;  ///< grey levels over background
  float width_px = 0;   ///< Gaussian standard deviation of the line's cross section
  RowStatus status = RowStatus::no_line;
};

/// Extracts lines with scratch memory of its own; one per thread. SIMD by run-time dispatch.
class LaserLineExtractor {
 public:
  explicit LaserLineExtractor(const LaserLineOptions& options = {});
  ~LaserLineExtractor();
  LaserLineExtractor(LaserLineExtractor&&) noexcept;
  LaserLineExtractor& operator=(LaserLineExtractor&&) noexcept;

  /// One LineRow per image row (column) of `on`, read in place. `off` (laser off, same mode) is subtracted in registers
  /// if given. `previous`, the rows of the frame before, decides between two peaks where this frame alone cannot; none
  /// of it is taken for a position.
  /// @pre sizes as in mode; stride_bytes >= width * bytes per pixel; rows.size() == height, width 64 to 4096; along
  ///      columns rows.size() == width >= 16, height 64 to 4096; previous empty or of rows' size, apart from rows
  void extract(const CameraMode& mode, std::span<const std::uint8_t> on, std::span<const std::uint8_t> off,
               std::span<LineRow> rows, std::span<const LineRow> previous = {});

 private:
  struct Impl;
  Impl* impl_ = nullptr;
};

/// Amplitude-weighted local quadratics over +-8 rows, never across a jump: for gating, outlier rejection and preview
/// only, never for the fit. -1 where there is none.
void smooth_line(std::span<const LineRow> rows, std::span<float> smoothed_px);

/// Name of the SIMD target in use ("AVX2", ...).
const char* laser_line_simd_target();

}  // namespace celadon
