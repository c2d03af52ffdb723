#pragma once
// What a scan sees twice, at the beginning of its turn and beyond its end: by how far the second look is shifted along
// r, and by how far it is turned. Source: README.md, "Self-checks".

#include <cstddef>
#include <cstdint>
#include <map>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

/// Second look against the first.
struct OverlapResult {
  std::string missing;  ///< why nothing could be compared; empty: the rest holds
  std::size_t samples = 0;
  double noise_mm = 0;                  ///< of a sample, from the first look alone
  double shift_mm = 0, shift_u_mm = 0;  ///< mean difference along r, and its standard uncertainty
  /// By how much further than a full turn the object has turned. Its uncertainty is infinite where the object looks the
  /// same after a small turn.
  double turn_rad = 0, turn_u_rad = 0;
  /// What explains the second look: neither turn nor shift alone is needed beside the other where it could be either.
  enum class Cause : std::uint8_t { turn, shift, either } cause = Cause::either;
};

/// Fed profile by profile, compared image row by image row: a body that has turned by d shows in a row at angle a what
/// it showed there at a + d, whatever its shape. The first look is smoothed by a cubic in the angle for each row of
/// each laser.
class OverlapComparison {
 public:
  /// How much of the beginning of the turn is kept; a turn may be too long by about as much.
  static constexpr double kFirstLook_rad = 20 * std::numbers::pi / 180;

  /// A profile, `turned_rad` after the beginning of the turn; those beyond kFirstLook_rad are passed over.
  void first(double turned_rad, const Profile& profile);
  /// A profile that was taken `beyond_rad` after a full turn.
  void again(double beyond_rad, const Profile& profile);

  OverlapResult result() const;

 private:
  struct Look {
    std::size_t profile;
    double angle_rad, r_mm;
  };
  struct Second {
    std::uint32_t row;  ///< laser and image row
    Look look;
  };
  std::map<std::uint32_t, std::vector<Look>> first_;
  std::size_t first_profiles_ = 0, second_profiles_ = 0;
  double last_beyond_rad_ = 0;
  std::vector<Second> again_;
};

}  // namespace celadon
