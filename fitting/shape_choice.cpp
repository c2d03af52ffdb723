#include "fitting/shape_choice.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <vector>

#include "fitting/even_points.h"
#include "fitting/fit_report.h"
#include "fitting/spherical_stream.h"
#include "fitting/surface_sample.h"
#include "fitting/window_stream.h"

namespace celadon {
namespace {

constexpr std::size_t kPoints = 12000, kFewestPoints = 50;
constexpr int kNormals = 4000;
// Heights that a search looks at first, and between the neighbours of the best, again and again.
constexpr int kHeights = 200, kFiner = 20, kRounds = 6;
constexpr double kDegrees = 180 / std::numbers::pi;
// Rays at more than this to the normal see little of the surface.
const double kSteepCosine = std::cos(75 / kDegrees);
// A base will do if it sees less than this share of the surface so, half the cap of a rod twenty times as long as wide.
// Flat ends have normals within 3 degrees of the axis.
constexpr double kSteepShare = 1e-3;
constexpr double kFlatRad = 3 / kDegrees;
// A sphere is simpler than two pieces: it may be worse by a half and by this mean of sin^2 psi.
constexpr double kSimplerFactor = 1.5, kSimplerMean = 0.01;
// So near to a shoulder, as a share of the height, neighbours do not lie in one plane.
constexpr double kShoulderShare = 0.04;
// A split stays so far from both ends, as a share of the height; and goes to the centre of the sphere that its head's
// samples lie on if that is as near.
constexpr double kEndShare = 0.02, kCentreShare = 0.03;
constexpr int kCentreRounds = 4;

/// Places of the surface and their normals, in the cylinder's frame.
struct Places {
  Eigen::Matrix3Xd p, n;
  double low = 0, high = 0;
  Eigen::Index count() const { return p.cols(); }
};

Eigen::Vector3d ray_of(const Eigen::Vector3d& p, std::optional<double> centre) {
  const Eigen::Vector3d from_axis(p.x(), p.y(), 0), from_centre(p.x(), p.y(), p.z() - centre.value_or(0));
  return (centre ? from_centre : from_axis).normalized();
}

// What rays see: from the centre `below` under that height, from `above` over that one, from the axis between.
struct View {
  std::optional<double> below, above;
  std::optional<double> centre_of(double z) const {
    return below && z < *below ? below : above && z > *above ? above : std::nullopt;
  }
};
double sine_square(const Places& places, Eigen::Index k, const View& view) {
  const double c = places.n.col(k).dot(ray_of(places.p.col(k), view.centre_of(places.p(2, k))));
  return 1 - c * c;
}
double mean_sine_square(const Places& places, const View& view) {
  double sum = 0;
  for (Eigen::Index k = 0; k < places.count(); ++k) sum += sine_square(places, k, view);
  return sum / static_cast<double>(places.count());
}
View from_one_centre(double z) {
  return {z, std::nextafter(z, -1e300)};
}

// Share of the surface that the axis sees at a steep angle at one end, unless the end is flat.
double steep_share(const Places& places, bool top) {
  const double middle = (places.low + places.high) / 2;
  std::vector<double> tilt;
  for (Eigen::Index k = 0; k < places.count(); ++k)
    if ((places.p(2, k) > middle) == top && 1 - sine_square(places, k, {}) < kSteepCosine * kSteepCosine)
      tilt.push_back(std::acos(std::min(1.0, std::abs(places.n(2, k)))));
  if (tilt.empty()) return 0;
  const auto half = tilt.begin() + static_cast<std::ptrdiff_t>(tilt.size() / 2);
  std::nth_element(tilt.begin(), half, tilt.end());
  return *half < kFlatRad ? 0 : static_cast<double>(tilt.size()) / static_cast<double>(places.count());
}

// The height of least cost.
template <class Cost>
double least(double from, double to, const Cost& cost) {
  double best = from, best_cost = std::numeric_limits<double>::infinity(), low = from, high = to;
  for (int round = 0; round < kRounds; ++round) {
    const double step = (high - low) / (round == 0 ? kHeights : kFiner);
    for (int k = 0; k <= (round == 0 ? kHeights : kFiner); ++k) {
      const double z = low + k * step, c = cost(z);
      if (c < best_cost) best = z, best_cost = c;
    }
    low = std::max(from, best - step), high = std::min(to, best + step);
  }
  return best;
}

tl::expected<Places, FitError> places_of(ProfileStream& samples, std::span<const Shoulder> shoulders) {
  const Eigen::Matrix3Xd p = even_points(samples, kPoints);
  if (p.cols() < static_cast<Eigen::Index>(kFewestPoints))
    return tl::unexpected(FitError{
        text("%td samples are too few to see what shape they have; name one, or take more samples", p.cols())});
  const SurfaceSample surface = sample_surface(p, static_cast<int>(kPoints), kNormals);
  Places places;
  const double beside = kShoulderShare * (p.row(2).maxCoeff() - p.row(2).minCoeff());
  const auto beside_shoulder = [&](double z) {
    return std::any_of(shoulders.begin(), shoulders.end(),
                       [&](const Shoulder& shoulder) { return std::abs(z - shoulder.height_mm) < beside; });
  };
  std::vector<Eigen::Index> flat;
  for (Eigen::Index k = 0; k < surface.normal_weights.size(); ++k)
    if (surface.normal_weights(k) > 0 && !beside_shoulder(surface.middles(2, k))) flat.push_back(k);
  if (flat.size() < kFewestPoints)
    return tl::unexpected(
        FitError{"the samples have no neighbours that lie in planes: what shape they have cannot be seen; name one"});
  places.p.resize(3, static_cast<Eigen::Index>(flat.size()));
  places.n.resize(3, places.p.cols());
  for (std::size_t k = 0; k < flat.size(); ++k) {
    places.p.col(static_cast<Eigen::Index>(k)) = surface.middles.col(flat[k]);
    places.n.col(static_cast<Eigen::Index>(k)) = surface.normals.col(flat[k]).normalized();
  }
  places.low = places.p.row(2).minCoeff();
  places.high = places.p.row(2).maxCoeff();
  return places;
}

// A split at the centre of the head's own sphere, where that is what the search meant. The head's samples are those
// above the split: a few rounds.
double at_centre(ProfileStream& samples, double split, bool top, double height) {
  constexpr double inf = std::numeric_limits<double>::infinity();
  double centre = split;
  for (int round = 0; round < kCentreRounds; ++round) {
    WindowStream head(samples, top ? centre : -inf, top ? inf : centre);
    const double next = centre_on_axis_mm(head);
    if (!(std::abs(next - split) <= kCentreShare * height)) return split;
    if (next == centre) break;
    centre = next;
  }
  return centre;
}

std::string steps_of(std::span<const Shoulder> shoulders) {
  std::string heights;
  for (const Shoulder& shoulder : shoulders)
    heights += (heights.empty() ? "" : ", ") + text("%.6g", shoulder.height_mm);
  return text("the wall steps all around at z = %s mm, where no smooth one follows it", heights.c_str());
}

}  // namespace

const char* to_string(BodyShape shape) {
  return shape == BodyShape::cylinder ? "cylinder" : shape == BodyShape::sphere ? "sphere" : "composite";
}

tl::expected<ShapeChoice, FitError> choose_shape(ProfileStream& samples, std::optional<BodyShape> wanted) {
  ShapeChoice choice;
  if (!wanted || *wanted == BodyShape::composite) choice.split.shoulders = find_shoulders(samples);
  const bool stepped = !choice.split.shoulders.empty();
  const auto places = places_of(samples, choice.split.shoulders);
  if (!places) return tl::unexpected(places.error());
  const double top = steep_share(*places, true), bottom = steep_share(*places, false);
  const bool head_above = top >= kSteepShare, head_below = bottom >= kSteepShare;
  const double steep = 100 * (top + bottom);
  if (stepped && !head_above && !head_below) {
    choice.shape = BodyShape::composite;
    choice.reason = steps_of(choice.split.shoulders);
    return choice;
  }
  if (wanted ? *wanted == BodyShape::cylinder : !head_above && !head_below) {
    choice.reason = text(
        "the axis sees %.1f %% of the surface at more than 75 degrees, flat ends apart: a cylinder "
        "follows it",
        steep);
    return choice;
  }
  if (!head_above && !head_below && wanted == BodyShape::composite)
    return tl::unexpected(FitError{text(
        "the axis sees all but %.1f %% of the surface at less than 75 degrees: there is no head to split off, and no "
        "shoulder all around; fit a cylinder, or name a height with --split-above, --split-below or --shoulders",
        steep)});

  // Both searches keep away from the ends.
  const double height = places->high - places->low, low = places->low + kEndShare * height,
               high = places->high - kEndShare * height;
  choice.centre_z_mm = least(low, high, [&](double z) { return mean_sine_square(*places, from_one_centre(z)); });
  const double by_sphere = mean_sine_square(*places, from_one_centre(choice.centre_z_mm));
  View view;
  if (head_above) view.above = least(low, high, [&](double z) { return mean_sine_square(*places, {std::nullopt, z}); });
  if (head_below)
    view.below = least(low, view.above.value_or(high) - kEndShare * height, [&](double z) {
      return mean_sine_square(*places, {z, view.above});
    });
  const double by_pieces = mean_sine_square(*places, view);
  const bool sphere =
      wanted ? *wanted == BodyShape::sphere : !stepped && by_sphere <= kSimplerFactor * by_pieces + kSimplerMean;
  choice.shape = sphere ? BodyShape::sphere : BodyShape::composite;
  if (sphere) {
    const double own = centre_on_axis_mm(samples);
    if (std::abs(own - choice.centre_z_mm) <= kCentreShare * height) choice.centre_z_mm = own;
  } else {
    if (view.above) choice.split.above_mm = at_centre(samples, *view.above, true, height);
    if (view.below) choice.split.below_mm = at_centre(samples, *view.below, false, height);
    // What lies in the heads' part is theirs.
    std::erase_if(choice.split.shoulders, [&](const Shoulder& shoulder) {
      const double z = shoulder.height_mm;
      return (choice.split.below_mm && z <= *choice.split.below_mm + kEndShare * height) ||
             (choice.split.above_mm && z >= *choice.split.above_mm - kEndShare * height);
    });
  }
  const auto mean_angle = [](double mean) { return std::asin(std::sqrt(std::clamp(mean, 0.0, 1.0))) * kDegrees; };
  choice.reason = text(
      "the axis sees %.1f %% of the surface at more than 75 degrees; on average its normals are %.1f "
      "degrees off the rays of a sphere and %.1f off those of a body with %s",
      steep, mean_angle(by_sphere), mean_angle(by_pieces),
      head_above && head_below ? "two heads"
      : head_above             ? "a head above"
                               : "a head below");
  if (!choice.split.shoulders.empty()) choice.reason += "; " + steps_of(choice.split.shoulders);
  return choice;
}

}  // namespace celadon
