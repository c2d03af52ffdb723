#pragma once
// Private to laser_line.cpp and laser_line_simd.cpp: one frame's work, and the SIMD functions it is dispatched to.

#include <cstddef>
#include <cstdint>
#include <span>

#include "acquisition/laser_line.h"
#include "acquisition/line_continuity.h"

namespace celadon::line_kernels {

/// How the signal of a pixel is formed from the bytes of the buffer.
enum class Signal : std::uint8_t { grey, yuyv_luma, yuyv_red, yuyv_green };

inline constexpr int kMaximumWidthPx = 4096;
inline constexpr int kMinimumWidthPx = 64;
inline constexpr int kPaddingCells = 128;  ///< before and after a decimated row: longest vector and the score's reach
inline constexpr int kRowCells = kMaximumWidthPx / 4 + 2 * kPaddingCells;
inline constexpr int kWindowPx = 64;   ///< pixels cut out about the coarse peak
inline constexpr int kBlockRows = 16;  ///< rows of the image worked on together, one per SIMD lane

inline constexpr int kStripPx = 128;  ///< columns that are turned into rows together: two lines of the cache
inline constexpr int kTilePx = 16;    ///< columns and rows that are turned in registers

inline constexpr int kRowsInWork = 5;  ///< rows that the coarse search works on at once, each at another step

/// What a row's window holds: no line; a line of which every pixel can be used; one with saturated pixels or at the
/// border.
enum class WindowKind : std::uint8_t { none, whole, partial };

/// A window as it was cut.
struct Window {
  WindowKind kind = WindowKind::none;
  bool saturated = false;
  int center_px = 0;           ///< pixel of the frame at its middle
  float ambient_variance = 0;  ///< noise of a pixel without laser light
};

/// A block of rows on its way from bytes to positions.
struct Scratch {
  alignas(64) std::uint8_t cells[kRowsInWork][kRowCells];
  alignas(64) std::uint8_t highest[kRowsInWork][64];  ///< largest score by lane of a vector
  alignas(64) std::uint8_t scores[kRowsInWork][kRowCells];
  alignas(64) std::int16_t cut[kBlockRows][kWindowPx];     ///< signal about the coarse peak
  alignas(64) std::int16_t usable[kBlockRows][kWindowPx];  ///< 0: saturated or outside the frame; else -1
  Window window[kBlockRows];
  int frame_row[kBlockRows];  ///< row of the frame that each row of the block is
  /// Row of each lane: rows with whole windows from lane 0 up, those with partial ones up to the last lane, so that
  /// each kind fills as few vectors as it can.
  int row[kBlockRows];
  WindowKind kind[kBlockRows];
  alignas(64) std::int16_t signal[kWindowPx][kBlockRows];         ///< cut, [pixel][lane]
  alignas(64) std::int16_t usable_signal[kWindowPx][kBlockRows];  ///< usable, [pixel][lane]; only of partial windows
  alignas(64) float ambient_variance[kBlockRows];                 ///< noise of a pixel without laser light
  alignas(64) float light[kWindowPx][kBlockRows];                 ///< signal over background, [pixel][lane]
  std::int16_t saturated_level;                                   ///< from here a sample says no more than "at least"
  int light_reach[kBlockRows];  ///< by vector of lanes: how far from the middle `light` is known
  // The model of each row; positions count from the middle of the window.
  alignas(64) float level[kBlockRows], slope[kBlockRows], slope_information[kBlockRows];
  alignas(64) float x_start[kBlockRows], width_start[kBlockRows];
  alignas(64) float x[kBlockRows], amplitude[kBlockRows], width[kBlockRows], variance_x[kBlockRows];
  alignas(64) float sigma_x[kBlockRows];
  alignas(64) float speckle_excess[kBlockRows], speckle_weight[kBlockRows];
  alignas(64) float good[kBlockRows];  ///< 1 if the row has a line
};

/// Rows of a frame, or columns that were turned into rows.
struct Job {
  Signal signal = Signal::grey;
  const std::uint8_t* on = nullptr;
  const std::uint8_t* off = nullptr;  ///< nullptr: no subtraction
  std::size_t stride_bytes = 0;
  int width_px = 0, height_px = 0;
  LaserLineOptions options;
  std::span<LineRow> rows;
  std::span<PeakPair> peaks;           ///< extract() fills them, one per row
  std::span<const PeakChoice> chosen;  ///< what refine_chosen() refines
  Scratch* scratch = nullptr;
};

/// Columns of a frame, to be turned into rows of a grey picture.
struct Strip {
  Signal signal = Signal::grey;  ///< limited to 0..255
  const std::uint8_t* frame = nullptr;
  std::size_t stride_bytes = 0;
  int height_px = 0;               ///< of the frame, at least kTilePx
  int first_px = 0, width_px = 0;  ///< columns; at least kTilePx, both even for YUYV
  std::uint8_t* out = nullptr;     ///< column first_px + i begins at out + i * out_stride_bytes
  std::size_t out_stride_bytes = 0;
};

/// Rows and their peaks, from bytes to positions.
void extract(const Job& job);
/// The chosen rows anew, each about the peak that was chosen; ambiguous where that is no line.
void refine_chosen(const Job& job);
void turn_strip(const Strip& strip);
const char* simd_target();

}  // namespace celadon::line_kernels
