#include "acquisition/calibrate/held_out.h"

#include <cmath>
#include <limits>
#include <optional>

#include "acquisition/calibrate/bundle.h"
#include "acquisition/calibrate/initial_camera.h"

namespace celadon::calibrate {
namespace {

constexpr double kUnpredicted = std::numeric_limits<double>::infinity();

/// Squared distances of corners from where they were predicted.
struct Misses {
  double squares = 0;
  int count = 0;

  double rms() const { return count > 0 ? std::sqrt(squares / count) : 0; }
  /// Of one half of the corners, or of both.
  void add(const Estimate& parameters, const Eigen::Isometry3d& X_CB, const ViewObservation& view,
           std::optional<int> half = {}) {
    for (const CornerObservation& corner : view.corners) {
      if (!(corner.weight > 0) || (half && corner.half != *half)) continue;
      const Eigen::Vector3d p_C = X_CB * on_board(parameters, corner.p_mm);
      squares +=
          (project(parameters.camera.data(), p_C.x() / p_C.z(), p_C.y() / p_C.z()).p_px - corner.p_px).squaredNorm();
      ++count;
    }
  }
};

}  // namespace

HeldOutErrors held_out_errors(const Observations& observations, const Estimate& solution) {
  constexpr int kFolds = 5;
  Misses corners, raised, lifted;
  for (int fold = 0; fold < kFolds; ++fold) {
    Observations others = observations;
    std::vector<const ViewObservation*> held_out;
    // Held and turned views and those of each axis are dealt out apart, so that each fold has its share of all.
    int dealt[4] = {0, 0, 0, 0};
    for (ViewObservation& view : others.views) {
      const int kind = view.raised() ? 3 : view.lifted() ? 2 : view.turned() ? 1 : 0;
      if (!view.used || dealt[kind]++ % kFolds != fold) continue;
      held_out.push_back(&observations.views[static_cast<std::size_t>(&view - others.views.data())]);
      view.used = false;
    }
    if (held_out.empty()) continue;
    const auto parameters = solve_bundle(others, solution);
    if (!parameters) return {kUnpredicted, kUnpredicted, kUnpredicted};
    for (const ViewObservation* view : held_out) {
      if (!view->at_zero()) {
        const Eigen::Isometry3d X_CB = pose_of(*parameters, *view);
        if (view->raised()) raised.add(*parameters, X_CB, *view);
        if (view->lifted()) lifted.add(*parameters, X_CB, *view);
        continue;
      }
      Eigen::Isometry3d X_CB = pose_of(solution, *view);
      if (!refine_pose(*parameters, *view, 0, X_CB)) return {kUnpredicted, kUnpredicted, kUnpredicted};
      corners.add(*parameters, X_CB, *view, 1);
    }
  }
  return {corners.count > 0 ? corners.rms() : kUnpredicted, raised.rms(), lifted.rms()};
}

}  // namespace celadon::calibrate
