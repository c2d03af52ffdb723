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
inline constexpr int kPaddingCells = 128;  ///< before and after a decimated row: longest vector and the score's reach
inline constexpr int kCutPx = 80;          ///< pixels cut out about the coarse peak
inline constexpr int kWindowPx = 64;       ///< pixels left when the cut is centred on the zero crossing
inline constexpr int kBatchRows = 16;      ///< rows refined together, one per SIMD lane

/// Decimated rows, and a batch of rows to be refined together.
struct Scratch {
  alignas(64) std::uint8_t cells[kMaximumWidthPx / 4 + 2 * kPaddingCells];
  alignas(64) std::uint8_t scores[kMaximumWidthPx / 4 + 2 * kPaddingCells];
  alignas(64) std::int16_t cut[kBatchRows][kCutPx];         ///< signal about the coarse peak
  alignas(64) std::int16_t cut_usable[kBatchRows][kCutPx];  ///< 0: saturated or outside the frame; else -1
  alignas(64) std::int16_t signal[kWindowPx][kBatchRows];   ///< [pixel][row], pixel 32 nearest the zero crossing
  alignas(64) std::int16_t usable[kWindowPx][kBatchRows];   ///< the same of cut_usable; only valid if masked
  alignas(64) float ambient_variance[kBatchRows];           ///< noise of a pixel without laser light
  alignas(64) float x[kBatchRows];                          ///< in: from the zero crossing; relative to pixel 32
  alignas(64) float sigma[kBatchRows], amplitude[kBatchRows], width[kBatchRows];
  alignas(64) float good[kBatchRows];  ///< 1 if the row has a line
  int center_px[kBatchRows];           ///< pixel of the frame at the middle of cut, then window
  int frame_row[kBatchRows];
  bool saturated[kBatchRows], row_masked[kBatchRows];
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
