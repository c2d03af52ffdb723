#pragma once
// Which place of the second normal image shows what a window of the first shows: dense matching that knows nothing of
// gain and offset. README.md, "Matching".

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "acquisition/stereo/match_counts.h"
#include "acquisition/stereo/normal_pair.h"
#include "acquisition/stereo/normal_pictures.h"
#include "acquisition/stereo/picture_noise.h"

namespace celadon {

/// A window of the first normal image about (x, y), and where the second shows it: at (x - disparity, y).
struct WindowMatch {
  int x_px = 0, y_px = 0;
  double disparity_px = 0;
  double sigma_px = 0;  ///< of the disparity, from the match's curvature and the pictures' noise
  double gain = 1, offset = 0;
  double misfit = 0;  ///< what the noise leaves unexplained: the residuals' variance over the noise's
};

/// Windows of 21 x 21 px on a grid of 15 px.
class WindowMatcher {
 public:
  static constexpr int kHalf = 10, kPitch = 15;
  static constexpr double kMostSigma_px = 0.1;

  /// @param noise  of a level, independent from pixel to pixel
  /// @pre both pictures are of one size
  WindowMatcher(const LevelPicture& first, const LevelPicture& second, const PictureNoise& noise,
                const DisparityRange& range);

  /// Rows of windows: so much can be done without looking up.
  int bands() const;
  MatchCounts match(int band, std::vector<WindowMatch>& matches) const;

 private:
  enum class Fate : std::uint8_t { found, unknown, plain, ambiguous, inconsistent, misfit };
  Fate match_window(int x, int y, WindowMatch& match) const;
  std::optional<Fate> unfit(int x, int y) const;
  struct Best {
    int disparity = 0;
    float score = -1, rival = -1;  ///< correlation there, and the best further away
  };
  Best search(const LevelPicture& from, const LevelPicture& to, int side, int x, int y) const;
  Fate refine(int x, int y, int start, WindowMatch& match) const;

  LevelPicture first_, second_;  ///< smoothed
  const PictureNoise noise_;
  const DisparityRange range_;
};

}  // namespace celadon
