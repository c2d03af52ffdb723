#include "fitting/solid_properties.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "fitting/bspline_basis.h"
#include "fitting/gauss_legendre.h"
#include "fitting/knots.h"

namespace celadon {
namespace {

// Everything is integrated in units of the body's size about its middle. Fluxes of x, f x and f g x over the surface,
// f, g coordinates: 1; x, y, z; xx, yy, zz, xy, xz, yz; and the area.
using Moments = Eigen::Array<double, 11, 1>;
constexpr int kArea = 10;

[[noreturn]] void refuse(const std::string& why) {
  throw std::invalid_argument("solid_properties: " + why);
}

void add_flux(Moments& sum, const Eigen::Vector3d& p, double flux) {
  sum[0] += flux;
  sum.segment<3>(1) += flux * p.array();
  sum.segment<3>(4) += flux * p.array().square();
  sum[7] += flux * p.x() * p.y();
  sum[8] += flux * p.x() * p.z();
  sum[9] += flux * p.y() * p.z();
}

// Integral and the same of the integrands' absolute values, which says what rounding is.
struct Quadrature {
  Moments value = Moments::Zero(), magnitude = Moments::Zero();
  void add(double weight, const Moments& integrand) {
    value += weight * integrand;
    magnitude += weight * integrand.abs();
  }
};

struct Total {
  Moments value = Moments::Zero(), error = Moments::Zero();
};

// Two orders agree, or the interval is halved: a body's rational integrands are analytic on a knot rectangle.
constexpr double kRounding = 2e-15;
constexpr int kDeepest = 6;
bool agree(const Quadrature& a, const Quadrature& b) {
  return ((a.value - b.value).abs() <= kRounding * b.magnitude + 1e-18).all();
}

// The basis functions and slopes at the nodes of a rule on [lo, hi] of a span.
struct Abscissae {
  int first = 0;  // index of the first of degree + 1 functions
  std::vector<double> weights;
  std::vector<BasisValues> value, slope;
  Abscissae(const std::vector<double>& knots, int degree, double lo, double hi, int points) {
    const int span = find_span(knots, degree, 0.5 * (lo + hi));
    const GaussRule& rule = gauss_rule(points);
    const double half = (hi - lo) / 2;
    first = span - degree;
    for (std::size_t k = 0; k < rule.nodes.size(); ++k) {
      const auto d = basis_derivatives(knots, degree, span, lo + half * (1 + rule.nodes[k]));
      weights.push_back(half * rule.weights[k]);
      value.push_back(d[0]);
      slope.push_back(d[1]);
    }
  }
  std::size_t size() const { return weights.size(); }
};

// Exact for the second moments of polynomials, and near to rounding for the arcs' rational ones.
int points_for(int degree) {
  return std::max((5 * degree + 1) / 2, 10);
}

class Integrator {
 public:
  // `points`: homogeneous, in units of the size, the middle at the origin.
  Integrator(const NurbsSurface& surface, Eigen::Matrix4Xd points) : surface_(surface), points_(std::move(points)) {}

  Total lateral() const {
    Total total;
    const std::vector<double> u = breaks_of(surface_.knots_u).values, v = breaks_of(surface_.knots_v).values;
    for (std::size_t i = 0; i + 1 < u.size(); ++i)
      for (std::size_t j = 0; j + 1 < v.size(); ++j) add_patch(u[i], u[i + 1], v[j], v[j + 1], 0, total);
    return total;
  }

  // What closes row i of control points: rays from its centre to the rim, a disc if that is plane. Outward to the left
  // of the rim's direction at the end of u, to the right at its start.
  Total cap(int i) const {
    Total total;
    const Eigen::Matrix4Xd rim = points_.middleCols(Eigen::Index{i} * surface_.count_v(), surface_.count_v());
    const Eigen::Matrix3Xd at = rim.topRows<3>().array().rowwise() / rim.row(3).array();
    // The last point is the first one again.
    const Eigen::Vector3d centre = at.leftCols(at.cols() - 1).rowwise().mean();
    if ((at.colwise() - centre).colwise().norm().maxCoeff() < 1e-12) return total;  // a pole
    const std::vector<double> v = breaks_of(surface_.knots_v).values;
    const Rim along{rim, centre, i == 0 ? -1.0 : 1.0};
    for (std::size_t j = 0; j + 1 < v.size(); ++j) add_sector(along, v[j], v[j + 1], 0, total);
    return total;
  }

 private:
  struct Rim {
    Eigen::Matrix4Xd points;
    Eigen::Vector3d centre;
    double sign;
  };

  Quadrature patch(double u0, double u1, double v0, double v1, int more) const {
    const Abscissae u(surface_.knots_u, surface_.degree_u, u0, u1, points_for(surface_.degree_u) + more);
    const Abscissae v(surface_.knots_v, surface_.degree_v, v0, v1, points_for(surface_.degree_v) + more);
    const Eigen::Index p = surface_.degree_u, q = surface_.degree_v;
    Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, kMaxDegree + 1> row(4, q + 1), row_u(4, q + 1);
    Quadrature sum;
    for (std::size_t a = 0; a < u.size(); ++a) {
      row.setZero();
      row_u.setZero();
      for (Eigen::Index i = 0; i <= p; ++i) {
        const auto control = points_.middleCols((u.first + i) * surface_.count_v() + v.first, q + 1);
        row += u.value[a][static_cast<std::size_t>(i)] * control;
        row_u += u.slope[a][static_cast<std::size_t>(i)] * control;
      }
      for (std::size_t b = 0; b < v.size(); ++b) {
        const auto N = Eigen::Map<const Eigen::VectorXd>(v.value[b].data(), q + 1);
        const auto N_v = Eigen::Map<const Eigen::VectorXd>(v.slope[b].data(), q + 1);
        const Eigen::Vector4d h = row * N, h_u = row_u * N, h_v = row * N_v;
        const double w = h.w();
        const Eigen::Vector3d S = h.head<3>() / w;
        // w S_u and w S_v.
        const Eigen::Vector3d S_u = h_u.head<3>() - h_u.w() * S, S_v = h_v.head<3>() - h_v.w() * S;
        const Eigen::Vector3d outward = S_v.cross(S_u) / (w * w);
        Moments m = Moments::Zero();
        add_flux(m, S, S.dot(outward));
        m[kArea] = outward.norm();
        sum.add(u.weights[a] * v.weights[b], m);
      }
    }
    return sum;
  }

  void add_patch(double u0, double u1, double v0, double v1, int depth, Total& total) const {
    const Quadrature coarse = patch(u0, u1, v0, v1, 0), fine = patch(u0, u1, v0, v1, 2);
    if (depth < kDeepest && !agree(coarse, fine)) {
      const double u = 0.5 * (u0 + u1), v = 0.5 * (v0 + v1);
      add_patch(u0, u, v0, v, depth + 1, total);
      add_patch(u0, u, v, v1, depth + 1, total);
      add_patch(u, u1, v0, v, depth + 1, total);
      add_patch(u, u1, v, v1, depth + 1, total);
      return;
    }
    total.value += fine.value;
    total.error += (fine.value - coarse.value).abs();
  }

  Quadrature sector(const Rim& rim, double v0, double v1, int more) const {
    const Abscissae v(surface_.knots_v, surface_.degree_v, v0, v1, points_for(surface_.degree_v) + more);
    const GaussRule& out = gauss_rule(2);  // exact for what a cone's moments are along its rays: cubic
    Quadrature sum;
    for (std::size_t b = 0; b < v.size(); ++b) {
      const auto control = rim.points.middleCols(v.first, surface_.degree_v + 1);
      const Eigen::Vector4d h = control * Eigen::Map<const Eigen::VectorXd>(v.value[b].data(), surface_.degree_v + 1);
      const Eigen::Vector4d h_v = control * Eigen::Map<const Eigen::VectorXd>(v.slope[b].data(), surface_.degree_v + 1);
      const Eigen::Vector3d reach = h.head<3>() / h.w() - rim.centre;
      const Eigen::Vector3d C_v = (h_v.head<3>() - h_v.w() / h.w() * h.head<3>()) / h.w();
      const Eigen::Vector3d turned = rim.sign * reach.cross(C_v);  // twice the sector's area per v
      Moments m = Moments::Zero();
      for (std::size_t k = 0; k < 2; ++k) {
        const double s = 0.5 * (1 + out.nodes[k]);
        add_flux(m, rim.centre + s * reach, 0.5 * out.weights[k] * s * rim.centre.dot(turned));
      }
      m[kArea] = 0.5 * turned.norm();
      sum.add(v.weights[b], m);
    }
    return sum;
  }

  void add_sector(const Rim& rim, double v0, double v1, int depth, Total& total) const {
    const Quadrature coarse = sector(rim, v0, v1, 0), fine = sector(rim, v0, v1, 2);
    if (depth < kDeepest && !agree(coarse, fine)) {
      const double v = 0.5 * (v0 + v1);
      add_sector(rim, v0, v, depth + 1, total);
      add_sector(rim, v, v1, depth + 1, total);
      return;
    }
    total.value += fine.value;
    total.error += (fine.value - coarse.value).abs();
  }

  const NurbsSurface& surface_;
  Eigen::Matrix4Xd points_;
};

}  // namespace

SolidProperties solid_properties(const NurbsSurface& surface) {
  require_clamped(surface.knots_u, surface.degree_u, "solid_properties, u");
  require_clamped(surface.knots_v, surface.degree_v, "solid_properties, v");
  if (std::max(surface.degree_u, surface.degree_v) > kMaxDegree) refuse("a degree is above the largest known");
  if (!surface.closed_v) refuse("the surface is not closed in v");
  if (surface.control_points.cols() != Eigen::Index{surface.count_u()} * surface.count_v()) {
    refuse("the control points do not fit the knots");
  }
  if (!surface.control_points.allFinite() || !(surface.control_points.row(3).minCoeff() > 0)) {
    refuse("a control point is not finite or its weight not positive");
  }

  const Eigen::Matrix3Xd at =
      surface.control_points.topRows<3>().array().rowwise() / surface.control_points.row(3).array();
  const Eigen::Vector3d middle = at.rowwise().mean();
  const double size = (at.colwise() - middle).colwise().norm().maxCoeff();
  if (!(size > 0)) refuse("the surface is a point");
  Eigen::Matrix4Xd points = surface.control_points;
  points.topRows<3>() = ((at.colwise() - middle) / size).array().rowwise() * surface.control_points.row(3).array();
  const Integrator integrator(surface, std::move(points));
  const Total lateral = integrator.lateral();
  const Total start = integrator.cap(0), end = integrator.cap(surface.count_u() - 1);

  Moments sum = lateral.value + start.value + end.value;
  const Moments error = lateral.error + start.error + end.error;
  const double area = lateral.value[kArea] + start.value[kArea] + end.value[kArea];
  SolidProperties solid;
  solid.v_cross_u_outward = sum[0] > 0;
  if (!solid.v_cross_u_outward) sum = -sum;
  // div(f x) = (k + 3) f for f homogeneous of degree k.
  const double volume = sum[0] / 3;
  if (!(volume > 1e-12 * area)) refuse("no volume is enclosed");
  const Eigen::Vector3d centroid = sum.segment<3>(1).matrix() / (4 * volume);
  Eigen::Matrix3d second;
  second << sum[4], sum[7], sum[8], sum[7], sum[5], sum[9], sum[8], sum[9], sum[6];
  second = second / 5 - volume * centroid * centroid.transpose();
  solid.volume_mm3 = volume * std::pow(size, 3);
  solid.lateral_area_mm2 = lateral.value[kArea] * size * size;
  solid.start_cap_area_mm2 = start.value[kArea] * size * size;
  solid.end_cap_area_mm2 = end.value[kArea] * size * size;
  solid.centroid_mm = middle + size * centroid;
  solid.inertia_mm5 = std::pow(size, 5) * (second.trace() * Eigen::Matrix3d::Identity() - second);
  solid.relative_error = std::max({error[0] / 3 / volume, error.segment<3>(1).maxCoeff() / 4 / volume,
                                   error.segment<6>(4).maxCoeff() / 5 / volume, error[kArea] / area});
  return solid;
}

}  // namespace celadon
