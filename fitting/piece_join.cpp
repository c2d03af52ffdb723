#include "fitting/piece_join.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <stdexcept>
#include <utility>
#include <vector>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"

namespace celadon {
namespace {

constexpr double kEquator = 1;
constexpr int kPlacesPerInterval = 8, kMostRefinements = 4, kMostIntervalsPerArc = 512;
constexpr double kResolvedRad = 2e-5;
// Intervals of a direction that was constant and no longer is.
constexpr int kIntervalsAlong = 8;
// Rows that a closed pole binds and the two of the rim; the two rims of a body.
constexpr int kFewestHeadRows = 5, kFewestBodyRows = 4;

using Row = Eigen::RowVectorXd;

bool along(const RangeFunction& f) {
  return f.degree_u() > 0;
}
bool around(const RangeFunction& f) {
  return f.degree_v() > 0;
}

bool rim_at_end(const RangeFunction& head) {
  return head.base().band_end == kEquator;
}

void require_pieces(const RangeFunction& body, const RangeFunction& head) {
  const auto refuse = [](const char* why) { throw std::invalid_argument(std::string("join: ") + why); };
  const BaseSurface &b = body.base(), &h = head.base();
  if (b.spherical() || !h.spherical()) refuse("the body must be over a cylinder and the head over a sphere");
  if (!b.arcs.closed() || !h.arcs.closed()) refuse("both pieces must be closed around");
  if (h.band_end != kEquator && h.band_start != kEquator) refuse("the head has no rim on its equator");
  const double rim = rim_at_end(head) ? b.band_end : b.band_start;
  const Eigen::Isometry3d X_BH = b.X_WB.inverse() * h.X_WB;
  const double size = std::max(1.0, std::abs(rim) + body.coefficients().cwiseAbs().maxCoeff());
  if (!X_BH.linear().isIdentity(1e-12) || (X_BH.translation() - Eigen::Vector3d(0, 0, rim)).norm() > 1e-12 * size)
    refuse("the head's centre is not on the body's axis at the rim");
  if (body.degree_u() == 1 || head.degree_u() == 1) refuse("degree 1 along the pieces has no tangent to share");
  if (around(body) && around(head) && body.degree_v() != head.degree_v()) refuse("their degrees around differ");
}

RangeFunction with_coefficients(const RangeFunction& f, Eigen::MatrixXd coefficients) {
  return {f.base(), f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), std::move(coefficients)};
}

// The same function with knots of its own where it was constant.
RangeFunction varying_along(const RangeFunction& f, int degree) {
  if (along(f)) return f;
  std::vector<double> breaks;
  for (int k = 0; k <= kIntervalsAlong; ++k)
    breaks.push_back(f.knots_u().front() + (f.knots_u().back() - f.knots_u().front()) * k / kIntervalsAlong);
  breaks.back() = f.knots_u().back();
  auto knots = clamped_knots(degree, breaks);
  const auto rows = static_cast<Eigen::Index>(knots.size()) - degree - 1;
  return {f.base(), degree, f.degree_v(), std::move(knots), f.knots_v(), f.coefficients().replicate(rows, 1)};
}
RangeFunction varying_around(const RangeFunction& f, int degree, const std::vector<double>& knots) {
  const auto columns = static_cast<Eigen::Index>(knots.size()) - degree - 1;
  return {f.base(), f.degree_u(), degree, f.knots_u(), knots, f.coefficients().replicate(1, columns)};
}

// What `all` has and `some` has not, with multiplicities.
std::vector<double> missing(const std::vector<double>& some, const std::vector<double>& all) {
  std::vector<double> added;
  std::set_difference(all.begin(), all.end(), some.begin(), some.end(), std::back_inserter(added));
  return added;
}

RangeFunction with_knots_v(const RangeFunction& f, const std::vector<double>& added) {
  if (added.empty()) return f;
  auto refined = insert_knots(f.knots_v(), f.degree_v(), added);
  return {f.base(),    f.degree_u(),  f.degree_v(),
          f.knots_u(), refined.knots, Eigen::MatrixXd((refined.map * f.coefficients().transpose()).transpose())};
}

RangeFunction with_knot_u(const RangeFunction& f, double knot) {
  auto refined = insert_knots(f.knots_u(), f.degree_u(), std::vector<double>{knot});
  return {f.base(),      f.degree_u(), f.degree_v(),
          refined.knots, f.knots_v(),  Eigen::MatrixXd(refined.map * f.coefficients())};
}

// The two rows of coefficients that make value and slope at an end of u.
struct RimRows {
  Eigen::Index rim, inner;
  double lever;  // slope per unit along = (rim - inner) * lever
};
RimRows rim_rows(const RangeFunction& f, bool at_end) {
  const auto& knots = f.knots_u();
  const auto rows = f.coefficients().rows();
  const auto p = static_cast<std::size_t>(f.degree_u());
  const BaseSurface& base = f.base();
  const double unit = base.spherical() ? 1 : 1 / (base.band_end - base.band_start);
  if (at_end) {
    const double h = knots.back() - knots[knots.size() - p - 2];
    return {rows - 1, rows - 2, f.degree_u() * unit / h};
  }
  const double h = knots[p + 1] - knots.front();
  return {0, 1, -f.degree_u() * unit / h};
}
Row rim_of(const RangeFunction& f, bool at_end) {
  return f.coefficients().row(at_end ? f.coefficients().rows() - 1 : 0);
}
// Derivative along at the rim as a row of coefficients around.
Row slope_of(const RangeFunction& f, bool at_end) {
  if (!along(f)) return Row::Zero(f.coefficients().cols());
  const RimRows at = rim_rows(f, at_end);
  return (f.coefficients().row(at.rim) - f.coefficients().row(at.inner)) * at.lever;
}
RangeFunction with_rim(const RangeFunction& f, bool at_end, const Row& rim, const Row& slope) {
  Eigen::MatrixXd c = f.coefficients();
  if (!along(f)) {
    c.row(0) = rim;
    return with_coefficients(f, std::move(c));
  }
  const RimRows at = rim_rows(f, at_end);
  c.row(at.rim) = rim;
  c.row(at.inner) = rim - slope / at.lever;
  return with_coefficients(f, std::move(c));
}

// Functions of v on one knot vector that are products and quotients of others on it.
class Around {
 public:
  Around(const RangeFunction& like, JointContinuity continuity) : degree_(like.degree_v()), knots_(like.knots_v()) {
    if (degree_ == 0) return;
    const Breaks breaks = breaks_of(knots_);
    const auto space = RangeSpace::over(degree_, like.base().arcs, breaks.values, continuity);
    if (space.knots() != knots_) throw std::invalid_argument("join: the knots around are not those of its continuity");
    extraction_ = space.extraction();
    std::vector<Eigen::Triplet<double>> entries;
    for (std::size_t k = 0; k + 1 < breaks.values.size(); ++k)
      for (int i = 0; i < kPlacesPerInterval; ++i) {
        const double v = breaks.values[k] + (breaks.values[k + 1] - breaks.values[k]) * (i + 0.5) / kPlacesPerInterval;
        const int span = find_span(knots_, degree_, v);
        const BasisValues b = basis_values(knots_, degree_, span, v);
        for (int a = 0; a <= degree_; ++a)
          entries.emplace_back(places_, span - degree_ + a, b[static_cast<std::size_t>(a)]);
        ++places_;
      }
    values_.resize(places_, static_cast<Eigen::Index>(knots_.size()) - degree_ - 1);
    values_.setFromTriplets(entries.begin(), entries.end());
    const Eigen::SparseMatrix<double> free = values_ * extraction_;
    solver_.compute(Eigen::SparseMatrix<double>(free.transpose() * free));
    free_ = free;
  }
  // Least squares of f(a, b) over even places.
  Row combine(const Row& a, const Row& b, const std::function<double(double, double)>& f) const {
    if (degree_ == 0) return Row::Constant(1, f(a(0), b(0)));
    const Eigen::VectorXd at_a = values_ * a.transpose(), at_b = values_ * b.transpose();
    Eigen::VectorXd wanted(places_);
    for (int k = 0; k < places_; ++k) wanted(k) = f(at_a(k), at_b(k));
    return (extraction_ * solver_.solve(free_.transpose() * wanted)).transpose();
  }

 private:
  int degree_, places_ = 0;
  std::vector<double> knots_;
  Eigen::SparseMatrix<double> extraction_, values_, free_;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver_;
};

double r_z(double rho, double rho_w) {
  return -rho_w / (kPhiPerW * rho);
}
double rho_w(double r, double r_z) {
  return -kPhiPerW * r * r_z;
}

// Which of two pieces changes.
struct Movers {
  bool body = false, head = false;
};
Movers movers(const RangeFunction& body, const RangeFunction& head) {
  // A translational body has no row of its own for the rim.
  if (!along(body) && around(body)) return {.body = false, .head = true};
  const bool body_in_head = along(body) <= along(head) && around(body) <= around(head);
  const bool head_in_body = along(head) <= along(body) && around(head) <= around(body);
  return {.body = head_in_body, .head = body_in_head || !head_in_body};
}

// Both pieces with common knots around where one of them varies, and rows enough where they move.
void prepare(RangeFunction& body, RangeFunction& head, const Movers& moving) {
  const int degree = std::max(body.degree_v(), head.degree_v());
  if (moving.head && !moving.body) {
    if (along(body) || around(body)) head = varying_along(head, std::max(3, body.degree_u()));
    if (!around(head) && around(body)) head = varying_around(head, degree, body.knots_v());
  }
  if (around(body) && around(head)) {
    const auto for_body = missing(body.knots_v(), head.knots_v()), for_head = missing(head.knots_v(), body.knots_v());
    body = with_knots_v(body, for_body);
    head = with_knots_v(head, for_head);
  }
  const auto split_at_rim = [&](RangeFunction& f, int fewest_rows) {
    while (along(f) && f.coefficients().rows() < fewest_rows) {
      const Breaks breaks = breaks_of(f.knots_u());
      const std::size_t k = rim_at_end(head) ? breaks.values.size() - 2 : 0;
      f = with_knot_u(f, (breaks.values[k] + breaks.values[k + 1]) / 2);
    }
  };
  if (moving.head) split_at_rim(head, kFewestHeadRows);
  if (moving.body) split_at_rim(body, kFewestBodyRows);
}

// Rim rows as the knots of the piece that moves want them: a constant is constant on any.
Row on(const RangeFunction& f, const Row& row) {
  if (row.size() == f.coefficients().cols()) return row;
  return Row::Constant(f.coefficients().cols(), row(0));
}

// What a piece's value and slope at the rim are worth against each other's: they scatter with the number of functions
// around, and as the inverse of the last interval along and its third power.
struct Worth {
  double value, slope;
};
Worth worth_of(const RangeFunction& f, bool at_end) {
  const BaseSurface& base = f.base();
  const double unit_mm = base.spherical() ? kPhiPerW * f.coefficients().mean() : 1;
  const double h = f.degree_u() / std::abs(rim_rows(f, at_end).lever) * unit_mm;
  const auto columns = static_cast<double>(f.coefficients().cols());
  return {h / columns, h * h * h / columns};
}

BodyShare share_of(const RangeFunction& body, const RangeFunction& head, const Movers& moving) {
  const bool end = rim_at_end(head);
  if (!moving.body || !moving.head) return moving.head ? BodyShare{1, 1} : BodyShare{0, 0};
  if (!along(body)) {  // a cylinder and a sphere: one radius, weighted by their areas
    const double R = rim_of(head, end)(0), H = body.base().band_end - body.base().band_start;
    return {H / (R + H), 0};
  }
  const Worth of_body = worth_of(body, end), of_head = worth_of(head, end);
  return {of_body.value / (of_body.value + of_head.value), of_body.slope / (of_body.slope + of_head.slope)};
}

void meet(RangeFunction& body, RangeFunction& head, const Movers& moving, const BodyShare& share,
          JointContinuity continuity) {
  const bool end = rim_at_end(head);
  if (!along(body) && !around(body) && !along(head) && !around(head)) {
    const Row common = share.value * rim_of(body, end) + (1 - share.value) * rim_of(head, end);
    body = with_rim(body, end, common, Row());
    head = with_rim(head, end, common, Row());
    return;
  }
  const Around splines(moving.head ? head : body, continuity);
  const RangeFunction& like = moving.head ? head : body;
  const Row r = on(like, rim_of(body, end)), r_along = on(like, slope_of(body, end)), rho = on(like, rim_of(head, end)),
            rho_along = on(like, slope_of(head, end));
  Row rim = moving.head ? r : rho, slope = moving.body ? splines.combine(rho, rho_along, r_z) : r_along;
  if (moving.body && moving.head) {
    rim = share.value * r + (1 - share.value) * rho;
    slope = share.slope * r_along + (1 - share.slope) * slope;
  }
  if (moving.body) body = with_rim(body, end, rim, slope);
  if (moving.head) head = with_rim(head, end, rim, splines.combine(rim, slope, rho_w));
}

// Every interval of both halved around.
bool refine_around(RangeFunction& body, RangeFunction& head) {
  const RangeFunction& like = around(head) ? head : body;
  const Breaks breaks = breaks_of(like.knots_v());
  if (!around(like) || static_cast<int>(breaks.values.size()) > kMostIntervalsPerArc * like.base().arcs.count())
    return false;
  std::vector<double> middles;
  for (std::size_t k = 0; k + 1 < breaks.values.size(); ++k)
    middles.push_back((breaks.values[k] + breaks.values[k + 1]) / 2);
  if (around(body)) body = with_knots_v(body, middles);
  if (around(head)) head = with_knots_v(head, middles);
  return true;
}

}  // namespace

RimInfluence rim_influence(const RangeFunction& joined, bool at_end, double at) {
  if (!along(joined)) return {1, 0};
  const BaseSurface& base = joined.base();
  const double u = base.spherical() ? at : (at - base.band_start) / (base.band_end - base.band_start);
  const RimRows rows = rim_rows(joined, at_end);
  const int p = joined.degree_u(), span = find_span(joined.knots_u(), p, u);
  const BasisValues values = basis_values(joined.knots_u(), p, span, u);
  const auto of_row = [&](Eigen::Index row) {
    const Eigen::Index k = row - (span - p);
    return k >= 0 && k <= p ? values[static_cast<std::size_t>(k)] : 0;
  };
  const double inner = of_row(rows.inner);
  return {of_row(rows.rim) + inner, -inner / rows.lever};
}

Meeting meeting(const RangeFunction& body, const RangeFunction& head) {
  require_pieces(body, head);
  const bool end = rim_at_end(head);
  const double rim = end ? body.base().band_end : body.base().band_start;
  const auto columns = std::max(body.coefficients().cols(), head.coefficients().cols());
  const Eigen::Index places = std::clamp<Eigen::Index>(7 * columns, 360, 20000);
  Meeting largest;
  for (Eigen::Index k = 0; k < places; ++k) {
    const double theta = 2 * std::numbers::pi * static_cast<double>(k) / static_cast<double>(places);
    const SurfacePoint a = body.surface_point(theta, rim), b = head.surface_point(theta, kEquator);
    largest.gap_mm = std::max(largest.gap_mm, (a.p_W - b.p_W).norm());
    largest.angle_rad =
        std::max(largest.angle_rad, std::atan2(a.normal_W.cross(b.normal_W).norm(), a.normal_W.dot(b.normal_W)));
  }
  return largest;
}

JoinedPieces join(const RangeFunction& body, const RangeFunction& head, JointContinuity continuity) {
  require_pieces(body, head);
  const Movers moving = movers(body, head);
  JoinedPieces joined{body, head, share_of(body, head, moving)};
  prepare(joined.body, joined.head, moving);
  RangeFunction wide_body = joined.body, wide_head = joined.head;
  for (int refined = 0;; ++refined) {
    joined.body = wide_body, joined.head = wide_head;
    meet(joined.body, joined.head, moving, joined.of_body, continuity);
    if (meeting(joined.body, joined.head).angle_rad <= kResolvedRad || refined == kMostRefinements ||
        !refine_around(wide_body, wide_head))
      return joined;
  }
}

}  // namespace celadon
