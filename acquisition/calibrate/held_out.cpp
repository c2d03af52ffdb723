#include "acquisition/calibrate/held_out.h"

#include <cmath>
#include <limits>

#include "acquisition/calibrate/bundle.h"
#include "acquisition/calibrate/initial_camera.h"

namespace celadon::calibrate {

double held_out_rms_px(const Observations& observations, const Estimate& solution) {
  constexpr int kFolds = 5;
  constexpr double kUnpredicted = std::numeric_limits<double>::infinity();
  double squares = 0;
  int count = 0;
  for (int fold = 0; fold < kFolds; ++fold) {
    Observations others = observations;
    std::vector<const ViewObservation*> held_out;
    // Held and turned views are dealt out apart, so that each fold has its share of both.
    int dealt[2] = {0, 0};
    for (ViewObservation& view : others.views) {
      if (!view.used || dealt[view.turned() ? 1 : 0]++ % kFolds != fold) continue;
      held_out.push_back(&observations.views[static_cast<std::size_t>(&view - others.views.data())]);
      view.used = false;
    }
    if (held_out.empty()) continue;
    const auto parameters = solve_bundle(others, solution);
    if (!parameters) return kUnpredicted;
    for (const ViewObservation* view : held_out) {
      Eigen::Isometry3d X_CB = pose_of(solution, *view);
      if (!refine_pose(*parameters, *view, 0, 2, X_CB)) return kUnpredicted;
      for (std::size_t i = 1; i < view->corners.size(); i += 2) {
        const CornerObservation& corner = view->corners[i];
        if (!(corner.weight > 0)) continue;
        const Eigen::Vector3d p_C = X_CB * on_board(*parameters, corner.p_mm);
        squares +=
            (project(parameters->camera.data(), p_C.x() / p_C.z(), p_C.y() / p_C.z()).p_px - corner.p_px).squaredNorm();
        ++count;
      }
    }
  }
  return count > 0 ? std::sqrt(squares / count) : kUnpredicted;
}

}  // namespace celadon::calibrate
