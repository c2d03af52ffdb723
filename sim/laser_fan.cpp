#include "sim/laser_fan.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/rotation.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr auto kMiddlePlace = static_cast<std::size_t>(kAcross / 2);
constexpr double kNeighbours_px = 6;  // rays of a smooth surface that are further apart get others in between
constexpr double kTouching_px = 0.05;
constexpr double kFanLowest_mm = -60, kFanHighest_mm = 180;  // of a fan that lights more than the camera sees
constexpr int kDeepest = 9;                                  // halvings of the fan's step: 0.5 micrometres

double apart_px(const Beam& a, const Beam& b) {
  return std::hypot(a.x_px - b.x_px, a.y_px - b.y_px);
}

}  // namespace

double across_mm(const LaserSheet& sheet, int k) {
  constexpr int kMiddle = kAcross / 2;
  return (k - kMiddle) * 1.2 * std::max(sheet.sigma_mm, 0.01);
}

LaserFan::LaserFan(const OpticsConfig& config, const LaserSheet& sheet, const Scene& scene)
    : config_(config), sheet_(sheet) {
  constexpr double kAim_mm = 30;
  // Above the top's near end; of a top below the emitter up to its far end.
  const double below = sheet_.emitter_W.z() - scene.z_max_mm(), far = scene.r_max_mm() + 1;
  const double from = sheet_.emitter_W.head<2>().norm();
  double top = scene.z_max_mm() + std::max(6.0, below * (kAim_mm + far) / (from + far) + 1);
  // The fan in steps of nearly two rows at 30 mm in front of the axis; cubics in between err by 1e-4 px.
  const double step = 0.22 * 1024 / config_.camera.height_px;
  const double c = std::cos(sheet.azimuth_rad), s = std::sin(sheet.azimuth_rad);
  const Vector3d normal = turned(sheet.normal_W, c, -s);
  double z = -15;
  if (config_.axes.any()) {
    z = kFanLowest_mm;
    top = kFanHighest_mm;
  }
  while (z < top) {
    Vector3d aim(kAim_mm, 0, z);
    aim.y() = (sheet.distance_mm - normal.x() * aim.x() - normal.z() * z) / normal.y();
    const double height = (z - sheet.emitter_W.z()) / 50;
    if (sheet.bow_mm != 0) aim += sheet.bow_mm * height * height * normal;
    fan_.push_back((turned(aim, c, s) - sheet.emitter_W).normalized());
    z += step;
  }
}

Posture LaserFan::posture_for_row(const Exposure& exposure, double row, double node) const {
  return exposure.posture_at(std::clamp(row, 0.0, config_.camera.height_px - 1.0), node);
}

LaserFan::View LaserFan::view_of(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure,
                                 double node) const {
  const bool rows_differ =
      exposure.line_time_ns != 0 && apart_rad(posture_for_row(exposure, 0, node), posture_for_row(exposure, 1e9, node),
                                              !turns_invisibly(scene)) > 1e-9;
  const double middle_row = 0.5 * (config_.camera.height_px - 1);
  const Posture middle = posture_for_row(exposure, middle_row, node);
  return {scene, camera, exposure, node, middle, scene.table_pose(middle, config_.spindle, config_.axes), rows_differ};
}

Ray LaserFan::ray_W(const Vector3d& direction, int k) const {
  return {sheet_.emitter_W + across_mm(sheet_, k) * sheet_.normal_W, direction};
}

// One ray of the sheet to where it meets the scene, and that point into the image.
Beam LaserFan::trace_ray(const View& view, const Ray& ray_W, const Posture& posture,
                         const std::optional<Near>& near) const {
  Beam beam;
  const TablePose pose =
      posture == view.middle ? view.middle_pose : view.scene.table_pose(posture, config_.spindle, config_.axes);
  const Ray ray_T{pose.to_table(ray_W.p), pose.direction_to_table(ray_W.d)};
  std::optional<Hit> hit;
  if (near) hit = view.scene.refine(ray_T, near->t, near->facet);
  const bool seen = near && (hit || near->is_seen);
  if (!hit) hit = view.scene.intersect(ray_T);
  if (!hit) return beam;
  const Vector3d centre_T = pose.to_table(view.camera.centre_W());
  const Vector3d to_camera = centre_T - hit->p;
  const double facing = -hit->normal.dot(ray_T.d);
  if (hit->normal.dot(to_camera) <= 0 || facing <= 0) return beam;
  if (!seen && view.scene.intersect({hit->p + 0.02 * hit->normal, to_camera}, 0, 1)) return beam;
  const Vector3d p_H = pose.to_head(hit->p);
  const Eigen::Vector2d pixel = view.camera.project(p_H);
  beam.x_px = pixel.x();
  beam.y_px = pixel.y();
  beam.p = p_H.cast<float>();
  beam.t = hit->t;
  beam.posture = posture;
  beam.surface = hit->material == Material::platter ? Beam::kPlatter : hit->surface;
  beam.facet = hit->facet;
  // A fan spreads in one direction: irradiance falls as 1 / distance.
  const double irradiance = facing * std::hypot(sheet_.emitter_W.x(), sheet_.emitter_W.y()) / hit->t;
  double reflectance = hit->print > 0                       ? hit->print
                       : hit->material == Material::platter ? config_.platter_albedo
                                                            : view.scene.albedo(*hit);
  if (config_.glaze > 0 && hit->material == Material::object) {
    const double gloss = std::max(0.0, hit->normal.dot((to_camera.normalized() - ray_T.d).normalized()));
    reflectance += config_.glaze * std::pow(gloss, config_.glaze_exponent);
  }
  beam.brightness = static_cast<float>(irradiance * reflectance);
  if (hit->material == Material::object) dress(view, *hit, ray_T, pose, beam);
  return beam;
}

// What lies beyond a matt surface of one colour.
void LaserFan::dress(const View& view, const Hit& hit, const Ray& ray_T, const TablePose& pose, Beam& beam) const {
  if (config_.subsurface.share > 0) {
    const Vector3d inside = hit.p + config_.subsurface.depth_mm * ray_T.d.normalized();
    beam.halo_px = static_cast<float>(view.camera.project(pose.to_head(inside)).x() - beam.x_px);
  }
  if (config_.fields.contrast != 1) {
    const double psi = std::atan2(hit.p.y(), hit.p.x()) / (2 * std::numbers::pi);
    beam.around = static_cast<float>((psi < 0 ? psi + 1 : psi) * ReflectanceFields::kAround);
    beam.up = static_cast<float>(hit.p.z() / config_.fields.pitch_mm);
  }
}

bool LaserFan::turns_invisibly(const Scene& scene) const {
  if (scene.held()) return true;
  return scene.turns_invisibly() && !config_.spindle.any() && config_.fields.contrast == 1;
}

Beam LaserFan::trace_middle(const View& view, const Vector3d& direction, const Beam* near) const {
  const Ray middle = ray_W(direction, kAcross / 2);
  if (near != nullptr) {
    const Posture posture = view.rows_differ ? posture_for_row(view.exposure, near->y_px, view.node) : view.middle;
    if (near->surface == Beam::kPlatter) return trace_ray(view, middle, posture, std::nullopt);
    return trace_ray(view, middle, posture, Near{near->t, near->facet, true});
  }
  const Beam beam = trace_ray(view, middle, view.middle, std::nullopt);
  if (!view.rows_differ || !beam.visible()) return beam;
  // The row a point falls on sets its instant, the instant the posture, the posture (weakly) the row.
  const Posture posture = posture_for_row(view.exposure, beam.y_px, view.node);
  if (beam.surface == Beam::kPlatter) return trace_ray(view, middle, posture, std::nullopt);
  return trace_ray(view, middle, posture, Near{beam.t, beam.facet, !view.scene.has_edges()});
}

// Rays between the strand's last one and the ray `to`, which met `end`.
void LaserFan::add_between(const View& view, const Vector3d& to, const Beam& end, int depth, Strand& strand) const {
  const Vector3d from = strand.directions.back();
  const Beam begin = strand.beams[kMiddlePlace].back();
  if (depth == kDeepest || (!begin.visible() && !end.visible())) return;
  if (begin.visible() && end.visible()) {
    const double apart = apart_px(begin, end);
    if (apart < kTouching_px || (begin.surface == end.surface && apart < kNeighbours_px)) return;
  }
  const Vector3d between = (from + to).normalized();
  const Beam beam = trace_middle(view, between, nullptr);
  add_between(view, between, beam, depth + 1, strand);
  strand.directions.push_back(between);
  strand.beams[kMiddlePlace].push_back(beam);
  add_between(view, to, end, depth + 1, strand);
}

void LaserFan::trace(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node,
                     Strand& strand) const {
  const View view = view_of(scene, camera, exposure, node);
  std::vector<Beam>& middle = strand.beams[kMiddlePlace];
  strand.directions.clear();
  strand.dense = scene.has_edges();
  middle.clear();
  for (const Vector3d& direction : fan_) {
    const Beam beam = trace_middle(view, direction, nullptr);
    if (scene.has_edges() && !middle.empty()) add_between(view, direction, beam, 0, strand);
    strand.directions.push_back(direction);
    middle.push_back(beam);
  }
  trace_across(view, nullptr, strand);
}

void LaserFan::trace_near(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node,
                          const Strand& near, Strand& strand) const {
  const View view = view_of(scene, camera, exposure, node);
  strand.directions = near.directions;
  strand.dense = near.dense;
  std::vector<Beam>& middle = strand.beams[kMiddlePlace];
  middle.assign(strand.directions.size(), {});
  for (std::size_t j = 0; j < middle.size(); ++j) {
    const Beam& seen = near.beams[kMiddlePlace][j];
    if (!seen.visible()) continue;
    middle[j] = trace_middle(view, strand.directions[j], &seen);
  }
  trace_across(view, &near, strand);
}

double LaserFan::shift_px(const Scene& scene, const VirtualCamera& camera, const Exposure& exposure, double node,
                          const Strand& strand) const {
  constexpr std::size_t kSample = 8;
  const View view = view_of(scene, camera, exposure, node);
  double most = 0;
  for (std::size_t j = 0; j < strand.directions.size(); j += kSample) {
    const Beam& beam = strand.beams[kMiddlePlace][j];
    if (!beam.visible()) continue;
    const Beam moved = trace_middle(view, strand.directions[j], &beam);
    if (moved.surface == beam.surface) most = std::max(most, apart_px(beam, moved));
  }
  return most;
}

// The places beside the middle, from what the middle met.
void LaserFan::trace_across(const View& view, const Strand* near, Strand& strand) const {
  const std::vector<Beam>& middle = strand.beams[kMiddlePlace];
  for (std::size_t k = 0; k < kAcross; ++k) {
    if (k == kMiddlePlace) continue;
    std::vector<Beam>& beams = strand.beams[k];
    beams.assign(middle.size(), {});
    for (std::size_t j = 0; j < middle.size(); ++j) {
      const Beam& centre = middle[j];
      if (!centre.visible()) continue;
      // A place beside the middle lies further along its ray by about as much as on the rays before.
      std::optional<Near> start;
      if (near != nullptr && near->beams[k][j].visible() && near->beams[k][j].surface != Beam::kPlatter) {
        start = {near->beams[k][j].t, near->beams[k][j].facet, !view.scene.has_edges()};
      } else if (centre.surface != Beam::kPlatter) {
        const auto goes_on = [&](std::size_t back) {
          return j >= back && beams[j - back].surface == centre.surface && middle[j - back].surface == centre.surface;
        };
        const auto further_by = [&](std::size_t back) { return beams[j - back].t - middle[j - back].t; };
        const double further = !goes_on(1) ? 0 : goes_on(2) ? 2 * further_by(1) - further_by(2) : further_by(1);
        start = {centre.t + further, goes_on(1) ? beams[j - 1].facet : centre.facet, !view.scene.has_edges()};
      }
      beams[j] = trace_ray(view, ray_W(strand.directions[j], static_cast<int>(k)), centre.posture, start);
      if (!view.scene.has_edges() && beams[j].surface != centre.surface) beams[j] = {};
    }
  }
  join(view.scene, strand);
}

void LaserFan::join(const Scene& scene, Strand& strand) const {
  for (std::vector<Beam>& beams : strand.beams) {
    for (std::size_t j = 0; j + 1 < beams.size(); ++j) {
      Beam& a = beams[j];
      const Beam& b = beams[j + 1];
      a.joined = a.visible() && b.visible() && a.y_px != b.y_px;
      if (!a.joined) continue;
      if (scene.has_edges()) {
        const double apart = apart_px(a, b);
        a.joined = apart < (a.surface == b.surface ? kNeighbours_px : kTouching_px);
      } else {
        a.joined = a.surface == b.surface && (a.p - b.p).squaredNorm() < 16.F;
      }
    }
  }
}

}  // namespace celadon::sim
