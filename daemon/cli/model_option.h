#pragma once
// Options that every fit has: how general the surface is, and when it is good enough.

#include <string>

#include <CLI/CLI.hpp>

#include "daemon/usage_error.h"
#include "fitting/range_fit.h"

namespace celadon::cli {

inline SurfaceModel model_from(const std::string& text) {
  for (const auto model :
       {SurfaceModel::cylinder, SurfaceModel::revolution, SurfaceModel::translational, SurfaceModel::general}) {
    if (text == to_string(model) || text == to_string(model, BaseKind::sphere)) return model;
  }
  return SurfaceModel::automatic;
}

inline JointContinuity continuity_from(const std::string& text) {
  return text == "thesis" ? JointContinuity::thesis : JointContinuity::curvature;
}

inline void add_model_options(CLI::App& command, std::string& model, double& tolerance_mm, double& form_tolerance_mm,
                              std::string& space) {
  command.add_option("--model", model, "how general the surface is")
      ->check(CLI::IsMember({"auto", "cylinder", "sphere", "revolution", "translational", "general"}));
  command
      .add_option("--tolerance", tolerance_mm,
                  "refine until 95 % of the errors are below it [mm]; 0: what the data carry")
      ->check(not_negative());
  command
      .add_option("--form-tolerance", form_tolerance_mm,
                  "deviation from a simpler form that is accepted [mm]; negative: 1e-9 of the size")
      ->check(finite());
  command
      .add_option("--space", space,
                  "continuity at the meridians 0, 90, 180, 270 degrees: curvature, or as in the thesis")
      ->check(CLI::IsMember({"curvature", "thesis"}));
}

}  // namespace celadon::cli
