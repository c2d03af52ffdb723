#include "sim/scene.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/artefact.h"
#include "sim/mesh_body.h"
#include "sim/no_body.h"
#include "sim/shapes.h"
#include "sim/turned_body.h"

namespace celadon::sim {
namespace {

using Eigen::Vector3d;

constexpr std::string_view kMesh = "mesh:", kBoard = "board:";

// Steps, a shoulder that faces down, and a groove.
std::shared_ptr<const Body> stepped_shaft() {
  return std::make_shared<TurnedBody>(std::vector<TurnedPoint>{{0, 30},
                                                               {22, 30},
                                                               {22, 24},
                                                               {48, 24},
                                                               {48, 18},
                                                               {62, 18},
                                                               {62, 15},
                                                               {66, 15},
                                                               {66, 18},
                                                               {80, 18},
                                                               {80, 12},
                                                               {105, 12}});
}

}  // namespace

const std::vector<std::string>& Scene::names() {
  static const std::vector<std::string> kNames{"vase", "vase-squeezed", "humidifier",    "cylinder",    "cylinder-off",
                                               "knob", "sphere",        "stepped-shaft", "lobed-shaft", "taper"};
  return kNames;
}

tl::expected<Scene, std::string> Scene::make(const std::string& name, const PrintErrors& print) {
  if (name == "vase") return Scene(name, make_vase(), 1, {});
  if (name == "vase-squeezed") return Scene(name, make_vase(), 0.75, {});
  if (name == "humidifier") return Scene(name, make_humidifier(), 1, {});
  if (name == "cylinder") return Scene(name, make_cylinder(30, 100), 1, {});
  if (name == "cylinder-off") return Scene(name, make_cylinder(25, 100), 1, {6, 3, 0});
  if (name == "knob") return Scene(name, make_knob(), 1, {});
  if (name == "sphere") return Scene(name, std::make_shared<SphereBody>(35), {});
  if (name == "stepped-shaft") return Scene(name, stepped_shaft(), {});
  if (name == "lobed-shaft") return Scene(name, make_lobed_shaft(), 1, {});
  if (name == "taper") {
    return Scene(name, std::make_shared<TurnedBody>(std::vector<TurnedPoint>{{0, 30}, {100, 20}}), {});
  }
  if (name == "artefact") return Scene(name, make_artefact(), {3.2, -2.1, 0.7});
  if (name == "empty") return Scene(name, std::make_shared<NoBody>(kPlatterRadius), {});
  if (name.starts_with(kMesh)) {
    auto body = MeshBody::read(name.substr(kMesh.size()));
    if (!body) return tl::unexpected(body.error());
    return Scene(name, *std::move(body), {});
  }
  if (name.starts_with(kBoard)) {
    auto body = BoardBody::make(name.substr(kBoard.size()), print);
    if (!body) return tl::unexpected(body.error());
    return Scene(name, *std::move(body), {});
  }
  std::string known;
  for (const std::string& n : names()) known += n + ", ";
  return tl::unexpected("scene \"" + name + "\" is unknown; choose one of " + known +
                        "artefact, empty, mesh:FILE, board:chessboard, board:tags");
}

Scene::Scene(std::string name, std::shared_ptr<const Body> body, const ObjectPose& pose)
    : name_(std::move(name)), body_(std::move(body)) {
  set_pose(pose);
}

Scene::Scene(std::string name, std::shared_ptr<const Shape> shape, double squeeze_y, const ObjectPose& pose)
    : Scene(std::move(name), std::make_shared<RadialBody>(std::move(shape), squeeze_y), pose) {}

void Scene::set_pose(const ObjectPose& pose) {
  pose_ = pose;
  cos_ = std::cos(pose.turn_rad);
  sin_ = std::sin(pose.turn_rad);
  reach_ = body_->r_max_mm() + std::hypot(pose.x_mm, pose.y_mm);
}

bool Scene::turns_invisibly() const {
  if (held()) return true;
  return body_->of_revolution() && !textured() && paint_.of_revolution() && pose_.x_mm == 0 && pose_.y_mm == 0 &&
         rim_tags_.outlines().empty();
}

void Scene::set_texture(std::uint64_t seed) {
  if (!object_is_printed() && body_->height_mm() > 0) texture_ = std::make_shared<const Texture>(seed);
}

void Scene::set_paint(const Paint& paint) {
  if (!object_is_printed() && body_->height_mm() > 0) paint_ = paint;
}

Vector3d Scene::point_to_object(const Vector3d& p) const {
  const double x = p.x() - pose_.x_mm, y = p.y() - pose_.y_mm;
  return {cos_ * x + sin_ * y, cos_ * y - sin_ * x, p.z()};
}

Ray Scene::to_object(const Ray& ray) const {
  return {point_to_object(ray.p),
          {cos_ * ray.d.x() + sin_ * ray.d.y(), cos_ * ray.d.y() - sin_ * ray.d.x(), ray.d.z()}};
}

Hit Scene::to_table(const Ray& ray, const BodyHit& hit) const {
  const Vector3d& n = hit.normal_O;
  const Vector3d normal(cos_ * n.x() - sin_ * n.y(), sin_ * n.x() + cos_ * n.y(), n.z());
  return {hit.t, ray.p + hit.t * ray.d, normal.normalized(), Material::object, hit.surface, hit.facet, hit.print};
}

std::optional<Hit> Scene::intersect(const Ray& ray, double t_min, double t_max) const {
  std::optional<Hit> platter;
  if (ray.d.z() != 0) {
    const double t = -ray.p.z() / ray.d.z();
    if (t > t_min && t < t_max) {
      const Vector3d p = ray.p + t * ray.d;
      if (p.x() * p.x() + p.y() * p.y() <= kPlatterRadius * kPlatterRadius) {
        platter = Hit{t, p, Vector3d(0, 0, ray.p.z() >= 0 ? 1 : -1), Material::platter,
                      0, 0, rim_tags_.reflectance(p.x(), p.y())};
        t_max = t;
      }
    }
  }
  if (const auto hit = body_->intersect(to_object(ray), t_min, t_max)) return to_table(ray, *hit);
  return platter;
}

std::optional<Hit> Scene::refine(const Ray& ray, double t_near, int facet) const {
  const auto hit = body_->refine(to_object(ray), t_near, facet);
  if (!hit) return std::nullopt;
  return to_table(ray, *hit);
}

Vector3d Scene::point_to_table(const Vector3d& p) const {
  return {cos_ * p.x() - sin_ * p.y() + pose_.x_mm, sin_ * p.x() + cos_ * p.y() + pose_.y_mm, p.z()};
}

std::vector<PrintedCorner> Scene::corners() const {
  std::vector<PrintedCorner> out = body_->corners();
  for (PrintedCorner& corner : out) corner.p = point_to_table(corner.p);
  const std::vector<PrintedCorner> rim = rim_tags_.corners();
  out.insert(out.end(), rim.begin(), rim.end());
  return out;
}

std::vector<std::vector<Vector3d>> Scene::printed() const {
  auto out = body_->printed();
  for (auto& outline : out) {
    for (Vector3d& p : outline) p = point_to_table(p);
  }
  const auto rim = rim_tags_.outlines();
  out.insert(out.end(), rim.begin(), rim.end());
  return out;
}

double Scene::truth_r_mm(double theta, double z) const {
  if (!(z >= 0 && z <= z_max_mm())) return std::numeric_limits<double>::quiet_NaN();
  return body_->reach_mm(to_object({Vector3d(0, 0, z), Vector3d(std::cos(theta), std::sin(theta), 0)}));
}

Eigen::Array3d Scene::truth_reflectance(double theta, double z) const {
  const double r = truth_r_mm(theta, z);
  Hit hit;
  hit.p = {r * std::cos(theta), r * std::sin(theta), z};
  return reflectance(hit);
}

}  // namespace celadon::sim
