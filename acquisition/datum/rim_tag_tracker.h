#pragma once
// Where the fiducials on the platter are in a picture, against where calibration and encoder say: every frame of a
// scan.

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "acquisition/calibration.h"
#include "acquisition/datum/tag_picture.h"
#include "acquisition/frame.h"
#include "acquisition/lens.h"

namespace celadon {

/// One tag in one frame.
struct TagSighting {
  std::size_t tag = 0;   ///< index in Calibration::rim_tags
  double angle_rad = 0;  ///< of the table at the instant of the tag's rows, by the encoder; true, counter-clockwise
  Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();     ///< seen minus expected, of the tag's middle
  Eigen::Matrix2d information = Eigen::Matrix2d::Zero();  ///< inverse of the shift's covariance, 1/px^2
};

/// The tag's middle at a table angle, in the camera's frame (of the model's millimetres).
Eigen::Vector3d tag_middle_C(const Calibration& calibration, const RimTag& tag, double angle_rad);

/// Compares what each tag should look like with the picture: level = black + contrast * white(x - shift), least squares
/// by Gauss and Newton over the tag's pixels. Room light has to be seen: contrast over noise decides what is found. A
/// tag that is hidden, in part too, is none: each of its quarters needs the contrast of the whole, and the whole that
/// of others: shifted by a cell a print still resembles itself, but less.
class RimTagTracker {
 public:
  explicit RimTagTracker(const Calibration& calibration);
  /// @param angle_at  true angle of the table at the instant of a row of this frame, rad
  /// @pre the picture has the size of the calibration's
  const std::vector<TagSighting>& track(const CameraMode& mode, std::span<const std::uint8_t> bytes,
                                        const std::function<double(double row)>& angle_at);
  /// Tags that the last picture should have shown unhidden.
  int expected() const { return expected_; }

 private:
  struct Patch {
    std::vector<double> white;
    int width = 0, height = 0;
  };
  struct Place {
    double angle_rad = 0;         ///< by the encoder
    Eigen::Vector2d expected_px;  ///< of the tag's middle there
    Eigen::Vector2d middle_px;    ///< with the table as far ahead as it seems to be
    Eigen::Matrix3d to_tag;       ///< from pixels about the middle to the tag's coordinates
    int half_width_px = 0, half_height_px = 0;
  };
  /// How far the tag's middle moves in the picture for a radian of the table.
  Eigen::Vector2d shift_by_angle(std::size_t tag, double angle_rad) const;
  std::optional<Place> place(std::size_t tag, const std::function<double(double)>& angle_at, double ahead_rad) const;
  void fill(std::size_t tag, const Place& place, const Eigen::Vector2d& shift_px, Patch& patch) const;
  std::optional<TagSighting> align(std::size_t tag, const Place& place, const CameraMode& mode,
                                   std::span<const std::uint8_t> bytes, Eigen::Vector2d shift_px);
  std::optional<Eigen::Vector2d> search(std::size_t tag, const Place& place, const CameraMode& mode,
                                        std::span<const std::uint8_t> bytes);

  const Calibration calibration_;
  const Lens lens_;
  std::vector<TagPicture> pictures_;
  std::vector<Eigen::Vector2d> last_px_;  ///< shift of each tag where it was last seen
  std::vector<bool> known_;               ///< last_px_ is of the frame before
  std::vector<TagSighting> seen_;
  double strongest_ = 0;  ///< contrast of all tags so far, levels
  std::size_t frames_ = 0;
  int expected_ = 0;
  Patch patch_;
};

}  // namespace celadon
