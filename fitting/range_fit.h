#pragma once
// The whole fit, from sums and a repeatable stream of profiles to the exact NURBS surface and its report.
// Source: README.md; thesis chapter 3.

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <tl/expected.hpp>

#include "fitting/constraints.h"
#include "fitting/coverage.h"
#include "fitting/deviation_map.h"
#include "fitting/error_histogram.h"
#include "fitting/error_map.h"
#include "fitting/executor.h"
#include "fitting/first_look.h"
#include "fitting/moment_grid.h"
#include "fitting/nurbs_surface.h"
#include "fitting/pole_jets.h"
#include "fitting/profile.h"
#include "fitting/range_function.h"
#include "fitting/range_space.h"
#include "fitting/steps.h"

namespace celadon {

struct ErrorSources;

enum class SurfaceModel { automatic, cylinder, revolution, translational, general };
/// "auto", "cylinder" (over a sphere "sphere"), "revolution", "translational", "general"
const char* to_string(SurfaceModel model, BaseKind base = BaseKind::cylinder);

struct RangeFitOptions {
  BaseKind base = BaseKind::cylinder;  ///< what the range is over; of a sphere, the samples are SphericalStream's
  SurfaceModel model = SurfaceModel::automatic;
  int degree_u = 3, degree_v = 3;           ///< of F, 1..5, for the directions that are not constant
  BaseArcs arcs = BaseArcs::full_circle();  ///< the whole turn, or the open range that is fitted
  double tolerance_mm = 0;                  ///< refine until the 95th percentile is below it; 0: until Cp stops falling
  std::optional<double> form_tolerance_mm{};  ///< delta of the model selection; default systematic_mm, else 1e-9 x size
  double systematic_mm = 0;                   ///< systematic uncertainty of the calibration
  JointContinuity continuity = JointContinuity::curvature;
  std::optional<PoleRule> pole_rule{};  ///< of closed poles of a sphere; default: the one that predicts better
  /// Fixed numbers of intervals instead of the data's choice (both or neither).
  std::optional<int> z_intervals{}, intervals_per_arc{};
  /// Coordinates along the base (z in mm, or w) at which the samples end but the object goes on: the surface reaches
  /// them if samples come near, and an error says so if not. Edges of the grid's cells, as choose_grid() makes them.
  std::optional<double> reach_start{}, reach_end{};
  double hidden_start = 0,
         hidden_end = 0;  ///< so much may be missing there in any case, as in the shadow of a shoulder
  bool robust = true;     ///< Tukey weights by the median absolute deviation
  bool smoothing = true;  ///< bending energy by Mallows' Cp
  /// Fairing: as little bending energy of the range as moves 95 % of the surface by no more than this along rays; 0:
  /// none. Of F, so that nothing shrinks: constants have no energy.
  double fair_mm = 0;
  Constraints constraints{};  ///< held exactly, over a cylinder only
};

struct ErrorSummary {
  double rms = 0, p95 = 0, max = 0;
};

struct RangeFitReport {
  std::size_t points = 0, rejected = 0, unfollowable = 0;
  SurfaceModel model = SurfaceModel::general;
  int degree_u = 3, degree_v = 3;  ///< of the exported surface
  int control_points_u = 0, control_points_v = 0;
  double noise_mm = 0, kappa = 1;
  ErrorSummary residual_mm, geometric_mm;     ///< e_p along the ray, e_g = e_p cos(psi)
  double sd_mean_mm = 0, sd_max_mm = 0;       ///< standard deviation of the surface along the ray; 0: not known
  double coverage = 0;                        ///< share of the clipped band's area with samples, 0..1
  std::string decided_by;                     ///< which test chose the model; both decisions
  std::string stopped_by;                     ///< what ended the refinement
  std::string poles;                          ///< which rule closes the poles, and why; empty: there was no choice
  double z_start_mm = 0, z_end_mm = 0;        ///< band of the surface over a cylinder
  double phi_start_rad = 0, phi_end_rad = 0;  ///< over a sphere; 0 and pi: closed poles
  double cut_below_mm = 0, cut_above_mm = 0;  ///< measured but cut at the rims, along the meridian
  std::vector<HeldConstraint> constraints{};  ///< that hold exactly
  std::vector<WallStep> steps{};              ///< of the wall, which no smooth range follows
  std::vector<std::string> warnings;          ///< what an operator should know, one sentence each
};

struct RangeFit {
  RangeFunction function;
  NurbsSurface surface;
  RangeFitReport report;
  ErrorMap geometric_errors;  ///< perpendicular, of the samples that belong; empty before measure_errors()
  /// What is needed for the standard deviation of the function at any place: CoefficientCovariance::of(*errors). Null
  /// for previews.
  std::shared_ptr<const ErrorSources> errors{};
  std::optional<DeviationMap> deviation{};  ///< the same over the whole band, ready to use; by measure_errors
};

class RobustReference;

/// A fit before its errors are measured: function, surface and report but for `rejected`, `unfollowable`, the errors,
/// the standard deviations and the warnings.
struct SurfaceFit {
  RangeFit fit;
  std::shared_ptr<const RobustReference> judge;  ///< which samples belong to the surface; null: all
  CoveredBand band;
  double grid_start_mm = 0, grid_end_mm = 0;  ///< samples outside were not looked at
  double share = 1;                           ///< of the samples that are there to be read
};

/// Why no surface could be fitted: a value and a remedy in one sentence.
struct FitError {
  std::string message;
};

/// The best grid for a stream: one pass for its band, then the finest dyadic ladder the samples carry.
tl::expected<GridSpecification, FitError> choose_grid(ProfileStream& profiles, const RangeFitOptions& options);

/// The surface, from sums and a first look over the same samples, which both may have been gathered while they came in;
/// `parts` are read once, never copied. Progress is reported by `stage` ("looking for outliers", ...) if given.
/// Errors: no samples, fewer samples than unknowns, all points on the axis, a band without coverage.
/// `share`: of the samples that `parts` hold, an even choice; 1: all. Else noise and kappa are the sums', and weights
/// make sums of that choice alone.
/// @throws std::invalid_argument if the look was over other sums
/// @pre at least one part; the same parts give the same bits whatever the executor
tl::expected<SurfaceFit, FitError> fit_surface(const MomentGrid& sums, const FirstLook& look, ProfileParts parts,
                                               const RangeFitOptions& options = {},
                                               const Executor& executor = run_in_turn,
                                               const std::function<void(const char* stage)>& stage = {},
                                               double share = 1);

/// What a surface misses samples by.
struct SurfaceErrors {
  ErrorHistogram along_ray, geometric;
  void merge(const SurfaceErrors& other);
  ErrorSummary along_ray_mm() const;
  ErrorSummary geometric_mm() const;
};

/// What the surface misses the samples by, which it reads once more, and the standard deviations. It may run while the
/// surface is put to use. The errors are handed out, too, if asked for.
RangeFit measure_errors(SurfaceFit surface, ProfileParts parts, const Executor& executor = run_in_turn,
                        SurfaceErrors* errors = nullptr);

/// A pass for the first look, then both of the above.
tl::expected<RangeFit, FitError> fit_range(const MomentGrid& sums, ProfileStream& profiles,
                                           const RangeFitOptions& options = {},
                                           const std::function<void(const char* stage)>& stage = {});

/// All of it, from a stream alone: the grid, the sums, both of the above.
tl::expected<RangeFit, FitError> fit_samples(ProfileStream& profiles, const RangeFitOptions& options = {});

/// From finished sums alone (no pass over the samples): quick preview and running fit error while scanning.
/// The residuals in its report are those the moments resolve (RMS only).
tl::expected<RangeFit, FitError> fit_sums(const MomentGrid& sums, const RangeFitOptions& options = {});

}  // namespace celadon
