#pragma once
// Private to laser_line.cpp and laser_line_simd.cpp: one frame's work, and the SIMD functions it is dispatched to.

#include <cstddef>
#include <cstdint>
#include <span>

#include "acquisition/laser_line.h"

namespace celadon::line_kernels {

/// How the signal of a pixel is formed from the bytes of the buffer.
enum class Signal : std::uint8_t { grey, yuyv_luma, yuyv_red, yuyv_green };

inline constexpr int kMaximumWidthPx = 4096;
inline constexpr int kMinimumWidthPx = 64;
inline constexpr int kPaddingCells = 80;  ///< before and after a decimated row: longest vector and the score's reach
inline constexpr int kWindowPx = 64;      ///< pixels a row hands to the refinement
inline constexpr int kBatchRows = 16;     ///< rows refined together, one per SIMD lane

/// Decimated rows and a batch of windows; [pixel][row], so that every lane works on a row of its own.
struct Scratch {
  alignas(64) std::uint8_t cells[kMaximumWidthPx / 4 + 2 * kPaddingCells];
  alignas(64) std::uint8_t scores[kMaximumWidthPx / 4 + 2 * kPaddingCells];
  alignas(64) std::int16_t rows[kBatchRows][kWindowPx];               ///< signal by row
  alignas(64) std::int16_t signal[kWindowPx][kBatchRows];             ///< the same, transposed
  alignas(64) std::int16_t usable[kWindowPx][kBatchRows];             ///< 0: saturated or outside the frame; else -1
  alignas(64) float ambient_variance[kBatchRows];                     ///< shot noise of what is not the laser
  alignas(64) float left_limit[kBatchRows], right_limit[kBatchRows];  ///< frame's first and last pixel in the window
  alignas(64) float x[kBatchRows], sigma[kBatchRows], amplitude[kBatchRows], width[kBatchRows], good[kBatchRows];
  int frame_row[kBatchRows];
  int center_px[kBatchRows];
  bool saturated[kBatchRows];
  bool masked = false;  ///< some pixel of the batch is not usable
  int count = 0;
};

struct Job {
  Signal signal = Signal::grey;
  const std::uint8_t* on = nullptr;
  const std::uint8_t* off = nullptr;  ///< nullptr: no subtraction
  std::size_t stride_bytes = 0;
  int width_px = 0, height_px = 0;
  LaserLineOptions options;
  std::span<LineRow> rows;
  Scratch* scratch = nullptr;
};

void extract(const Job& job);
const char* simd_target();

}  // namespace celadon::line_kernels
