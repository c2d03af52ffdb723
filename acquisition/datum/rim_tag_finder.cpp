#include "acquisition/datum/rim_tag_finder.h"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>

#include <Eigen/Geometry>
#include <cstddef>

namespace celadon {
namespace {

constexpr double kPixelCentre = 0.5;  // libapriltag counts pixels from their edges
constexpr int kMostWrongBits_rim = 1;
constexpr float kLeastMargin_rim = 15;  // of a decoded tag, levels

}  // namespace

struct RimTagFinder::Library {
  std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> family{tag36h11_create(), tag36h11_destroy};
  std::unique_ptr<apriltag_detector_t, void (*)(apriltag_detector_t*)> detector{apriltag_detector_create(),
                                                                                apriltag_detector_destroy};
};

RimTagFinder::RimTagFinder() : library_(std::make_unique<Library>()) {
  apriltag_detector_add_family_bits(library_->detector.get(), library_->family.get(), kMostWrongBits_rim);
  library_->detector->quad_decimate = 1;  // seen from the side their cells are few pixels high
  library_->detector->nthreads = 1;
}

RimTagFinder::~RimTagFinder() = default;

std::vector<SeenTag> RimTagFinder::find(std::span<const std::uint8_t> grey, int width_px, int height_px) {
  image_u8_t image{width_px, height_px, width_px, const_cast<std::uint8_t*>(grey.data())};  // is not written to
  const std::unique_ptr<zarray_t, void (*)(zarray_t*)> found(apriltag_detector_detect(library_->detector.get(), &image),
                                                             apriltag_detections_destroy);
  std::vector<SeenTag> tags;
  for (int i = 0; i < zarray_size(found.get()); ++i) {
    apriltag_detection_t* detection = nullptr;
    zarray_get(found.get(), i, &detection);
    if (detection->decision_margin < kLeastMargin_rim) continue;
    Eigen::Matrix3d H;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) H(r, c) = MATD_EL(detection->H, r, c);
    }
    SeenTag tag{detection->id, {}};
    constexpr std::array<std::array<double, 2>, 4> kCorners{{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};
    for (std::size_t k = 0; k < 4; ++k) {
      tag.corners_px[k] = (H * Eigen::Vector3d(kCorners[k][0], kCorners[k][1], 1)).hnormalized() -
                          Eigen::Vector2d::Constant(kPixelCentre);
    }
    tags.push_back(tag);
  }
  return tags;
}

}  // namespace celadon
