#pragma once
// Plane rings across the axis between the walls of a turned part: where they are, and how far their edges reach.
// Source: README.md, "Shoulders".

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

struct Shoulder {
  double height_mm = 0;
  double sd_mm = 0;       ///< standard deviation of the height; 0: it was given
  double jump_mm = 0;     ///< of the range, above minus below, median around
  double edge_mm = 0;     ///< so far above and below samples lie on neither wall: the ring, chamfers, fillets, noise
  std::size_t seen = 0;   ///< samples on the ring itself, of an even choice of all
  double scatter_mm = 0;  ///< of their heights, robust standard deviation
};

/// The shoulders that find_steps() sees in an even sample, from below; the stream is in the frame of a cylinder that is
/// closed around and is read once. Heights are medians of the samples on the ring, or where none lie there one
/// spacing of heights beyond the last samples of the outer wall, which nothing hides.
std::vector<Shoulder> find_shoulders(ProfileStream& samples);

/// Shoulders at given heights, ascending, with what the samples show of them. @pre as above
std::vector<Shoulder> shoulders_at(ProfileStream& samples, std::span<const double> heights_mm);

}  // namespace celadon
