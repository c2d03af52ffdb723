#pragma once
// What became of the windows that were to be matched.

namespace celadon {

struct MatchCounts {
  int windows = 0;
  int found = 0;
  int outside = 0;       ///< of those found: not within the scanner's volume (the platter, the room)
  int standing = 0;      ///< of those found: nothing turns with the table there (the room, an object's outline)
  int unknown = 0;       ///< saturated, or at the border of a picture
  int plain = 0;         ///< too little texture to place them
  int ambiguous = 0;     ///< the texture repeats
  int inconsistent = 0;  ///< from the second picture back, another place fits best
  int misfit = 0;        ///< the pictures do not show the same there: an edge lies within, or something moved

  int samples() const { return found - outside - standing; }
  MatchCounts& operator+=(const MatchCounts& other) {
    windows += other.windows;
    found += other.found;
    outside += other.outside;
    standing += other.standing;
    unknown += other.unknown;
    plain += other.plain;
    ambiguous += other.ambiguous;
    inconsistent += other.inconsistent;
    misfit += other.misfit;
    return *this;
  }
};

}  // namespace celadon
