#include "fitting/range_space.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>

#include "fitting/bspline_basis.h"
#include "fitting/knots.h"

namespace celadon {
namespace {

using Triplets = std::vector<Eigen::Triplet<double>>;

void require_degree(int degree) {
  if (degree < 1 || degree > 5) {
    throw std::invalid_argument("RangeSpace: degree " + std::to_string(degree) + " is not within 1..5");
  }
}

void require_ascending(const std::vector<double>& breaks) {
  bool good = breaks.size() >= 2 && std::isfinite(breaks.front()) && std::isfinite(breaks.back());
  for (std::size_t i = 1; i < breaks.size(); ++i) good = good && breaks[i - 1] < breaks[i];
  if (!good) throw std::invalid_argument("RangeSpace: breaks must be finite, strictly ascending and at least two");
}

Eigen::SparseMatrix<double> identity(int n) {
  Eigen::SparseMatrix<double> E(n, n);
  E.setIdentity();
  return E;
}

}  // namespace

RangeSpace RangeSpace::constant(std::vector<double> breaks) {
  require_ascending(breaks);
  RangeSpace space;
  space.knots_ = {breaks.front(), breaks.back()};
  space.breaks_ = std::move(breaks);
  space.extraction_ = identity(1);
  space.tabulate();
  return space;
}

RangeSpace RangeSpace::open(int degree, std::vector<double> breaks) {
  require_degree(degree);
  require_ascending(breaks);
  RangeSpace space;
  space.degree_ = degree;
  space.knots_ = clamped_knots(degree, breaks);
  space.breaks_ = std::move(breaks);
  space.extraction_ = identity(space.intervals() + degree);
  space.tabulate();
  return space;
}

RangeSpace RangeSpace::over(int degree, const BaseArcs& arcs, int intervals_per_arc, JointContinuity continuity) {
  if (intervals_per_arc < 1) {
    throw std::invalid_argument("RangeSpace::over: " + std::to_string(intervals_per_arc) + " intervals an arc");
  }
  std::vector<double> breaks;
  for (int j = 0; j < arcs.count(); ++j) {
    for (int k = 0; k < intervals_per_arc; ++k) breaks.push_back(j + static_cast<double>(k) / intervals_per_arc);
  }
  breaks.push_back(arcs.count());
  return over(degree, arcs, std::move(breaks), continuity);
}

RangeSpace RangeSpace::over(int degree, const BaseArcs& arcs, std::vector<double> breaks, JointContinuity continuity) {
  require_degree(degree);
  require_ascending(breaks);
  const bool whole = arcs.ends() != ArcEnds::free;
  bool good = whole ? breaks.front() == 0 && breaks.back() == arcs.count()
                    : breaks.front() >= 0 && breaks.back() <= arcs.count();
  for (int j = 1; j < arcs.count(); ++j) {
    const bool within = breaks.front() < j && j < breaks.back();
    good = good && (!within || std::binary_search(breaks.begin(), breaks.end(), j));
  }
  if (!good) throw std::invalid_argument("RangeSpace::over: breaks must run over the arcs and hold every joint");
  const bool simple = degree < 3 || continuity == JointContinuity::thesis;
  if (simple && arcs.ends() == ArcEnds::free) return open(degree, std::move(breaks));
  RangeSpace space;
  space.degree_ = degree;
  space.periodic_ = arcs.periodic();
  space.breaks_ = std::move(breaks);
  if (!simple) {
    space.extract_curvature_continuous(arcs);
  } else if (space.periodic_) {
    space.extract_simple_periodic();
  } else {
    space.knots_ = clamped_knots(degree, space.breaks_);
    space.extraction_ = identity(space.intervals() + degree);
  }
  if (arcs.ends() == ArcEnds::mirrored && degree > 1) space.level_at_ends();
  space.tabulate();
  return space;
}

// Periodic B-splines over the endlessly repeated breaks (3.9), then both ends clamped by knot insertion. Free function
// k is centred, by its Greville abscissa, in ascending order from the first one at or after the seam.
void RangeSpace::extract_simple_periodic() {
  const int n = intervals();
  const double period = breaks_.back() - breaks_.front();
  std::vector<double> endless;  // breaks -degree ... n + degree
  for (int k = -degree_; k <= n + degree_; ++k) {
    const int turn = (k >= 0 ? k : k - n + 1) / n;
    endless.push_back(breaks_[static_cast<std::size_t>(k - turn * n)] + turn * period);
  }
  std::vector<double> added(static_cast<std::size_t>(degree_ - 1), breaks_.front());
  added.insert(added.end(), static_cast<std::size_t>(degree_ - 1), breaks_.back());
  const Refinement refined = insert_knots(endless, degree_, added);

  knots_ = clamped_knots(degree_, breaks_);
  // With multiplicity `degree` at both ends the coefficients there are the values: rows degree_ - 1 onward.
  const int first = degree_ - 1, count = n + degree_;
  const int shift = (degree_ + 1) / 2;  // endless coefficient i belongs to free function (i - shift) mod n
  Triplets entries;
  for (int i = 0; i < count; ++i) {
    const int row = i + 1 < count ? first + i : first;  // F(0) = F(4) to the bit
    for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(refined.map, row); it; ++it) {
      const int free = ((static_cast<int>(it.col()) - shift) % n + n) % n;
      entries.emplace_back(i, free, it.value());
    }
  }
  extraction_.resize(count, n);
  extraction_.setFromTriplets(entries.begin(), entries.end());
}

// Multiplicity degree - 1 at every joint, and F''(v+) - F''(v-) = 4 (1 - w) F'(v) there: r(theta) is C2 exactly. The
// ends of an open range are no joints. README.md, "Range space", has the derivation of a and b.
void RangeSpace::extract_curvature_continuous(const BaseArcs& arcs) {
  const int q = degree_;
  std::vector<double> ends{breaks_.front()};  // of the arcs, as far as the breaks go
  for (int j = 1; j < arcs.count(); ++j)
    if (ends.front() < j && j < breaks_.back()) ends.push_back(j);
  ends.push_back(breaks_.back());
  const int arc_count = static_cast<int>(ends.size()) - 1;
  const double quarter_sin = std::sin(arcs.arc_rad() / 4);
  const double jump = 8 * quarter_sin * quarter_sin;  // J = 4 (1 - w)

  std::vector<int> at(static_cast<std::size_t>(arc_count) + 1);  // index of each arc's end among the breaks
  Breaks with_multiplicity{breaks_, std::vector<int>(breaks_.size(), 1)};
  for (int j = 0; j <= arc_count; ++j) {
    const auto found = std::lower_bound(breaks_.begin(), breaks_.end(), ends[static_cast<std::size_t>(j)]);
    at[static_cast<std::size_t>(j)] = static_cast<int>(found - breaks_.begin());
    with_multiplicity.multiplicities[static_cast<std::size_t>(at[static_cast<std::size_t>(j)])] = q - 1;
  }
  knots_ = clamped_knots(q, with_multiplicity);

  // Clamped coefficient 0 is F at the start, the last one F at the end; each arc has intervals + q - 2 between them.
  struct Joint {
    double a1, b1;  // knot spacings next to it, left and right
    double a, b;    // c-1 = (1 - a) d + a c-2,  c1 = (1 - b) d + b c2
    int free;       // index of d
  };
  struct Arc {
    const Joint *before = nullptr, *after = nullptr;  // nullptr: an open end
    int first, last;                                  // its clamped coefficients: c1 of the one, c-1 of the other joint
    int own;                                          // index of the free coefficient that `first` has or would have
  };
  std::vector<Joint> joint(static_cast<std::size_t>(arc_count));
  std::vector<Arc> arc(static_cast<std::size_t>(arc_count));
  const auto spacing = [&](int interval) {
    return breaks_[static_cast<std::size_t>(interval) + 1] - breaks_[static_cast<std::size_t>(interval)];
  };
  int row = 1, free = periodic_ ? 0 : 1;
  for (int j = 0; j < arc_count; ++j) {
    const auto J = static_cast<std::size_t>(j), previous = static_cast<std::size_t>((j + arc_count - 1) % arc_count);
    const int begin = at[J], length = at[J + 1] - begin;
    const int last = at[previous + 1] - 1, length_before = at[previous + 1] - at[previous];
    const double a1 = spacing(last), a2 = length_before > 1 ? spacing(last - 1) : 0;
    const double b1 = spacing(begin), b2 = length > 1 ? spacing(begin + 1) : 0;
    const double P = (q - 1) / (b1 * (b1 + b2)), Q = (q - 1) / (a1 * (a1 + a2));
    const double R = ((q - 1) * (1 / a1 + 1 / b1) + jump) / (a1 + b1);
    joint[J] = {a1, b1, Q / (Q + R), P / (P + R), free};
    const bool joint_before = periodic_ || j > 0, joint_after = periodic_ || j + 1 < arc_count;
    arc[J] = {joint_before ? &joint[J] : nullptr,
              joint_after ? &joint[static_cast<std::size_t>((j + 1) % arc_count)] : nullptr, row, row + length + q - 3,
              free};
    row += length + q - 2;
    free += length + q - 2 - (joint_after ? 1 : 0);
  }
  const int count = row + 1;
  if (!periodic_) ++free;

  Triplets entries;
  for (const Arc& here : arc) {
    const auto own = [&](int k) { return here.own + k - here.first; };
    if (here.before && here.after && here.last == here.first + 1) {  // each is the other's c2 or c-2
      const double a = here.after->a, b = here.before->b, whole = 1 - a * b;
      entries.emplace_back(here.first, here.before->free, (1 - b) / whole);
      entries.emplace_back(here.first, here.after->free, b * (1 - a) / whole);
      entries.emplace_back(here.last, here.after->free, (1 - a) / whole);
      entries.emplace_back(here.last, here.before->free, a * (1 - b) / whole);
      continue;
    }
    for (int k = here.first; k <= here.last; ++k) {
      if (k == here.first && here.before) {
        entries.emplace_back(k, here.before->free, 1 - here.before->b);
        entries.emplace_back(k, own(k + 1), here.before->b);
      } else if (k == here.last && here.after) {
        entries.emplace_back(k, here.after->free, 1 - here.after->a);
        entries.emplace_back(k, own(k - 1), here.after->a);
      } else {
        entries.emplace_back(k, own(k), 1);
      }
    }
  }
  if (periodic_) {  // F(0) = F(4) = (b1 c-1 + a1 c1)/(a1 + b1)
    const Joint& seam = joint.front();
    Triplets of_seam;
    for (const auto& entry : entries)
      for (const auto& [from, share] : {std::pair{count - 2, seam.b1}, std::pair{1, seam.a1}})
        if (entry.row() == from)
          for (const int end : {0, count - 1})
            of_seam.emplace_back(end, entry.col(), share / (seam.a1 + seam.b1) * entry.value());
    entries.insert(entries.end(), of_seam.begin(), of_seam.end());
  } else {
    entries.emplace_back(0, 0, 1);
    entries.emplace_back(count - 1, free - 1, 1);
  }
  extraction_.resize(count, free);
  extraction_.setFromTriplets(entries.begin(), entries.end());
}

// F' = 0 at both ends: their two outermost functions in one each. What is mirrored there is curvature continuous then.
void RangeSpace::level_at_ends() {
  const int n = free_count(), left = std::max(1, n - 2);
  Triplets entries;
  for (int k = 0; k < n; ++k) entries.emplace_back(k, std::clamp(k - 1, 0, left - 1), 1);
  Eigen::SparseMatrix<double> joined(n, left);
  joined.setFromTriplets(entries.begin(), entries.end());
  extraction_ = (extraction_ * joined).pruned();
}

std::span<const int> RangeSpace::active(int interval) const {
  const auto k = static_cast<std::size_t>(interval);
  const auto first = static_cast<std::size_t>(active_first_[k]), end = static_cast<std::size_t>(active_first_[k + 1]);
  return {active_.data() + first, end - first};
}

std::span<const double> RangeSpace::polynomial(int interval, int a) const {
  const auto order = static_cast<std::size_t>(degree_) + 1;
  const auto index = static_cast<std::size_t>(active_first_[static_cast<std::size_t>(interval)] + a);
  return {polynomial_.data() + index * order, order};
}

void RangeSpace::tabulate() {
  const Eigen::SparseMatrix<double, Eigen::RowMajor> rows = extraction_;
  const int q = degree_, n = free_count();
  active_first_ = {0};
  for (int interval = 0; interval < intervals(); ++interval) {
    const double middle =
        0.5 * (breaks_[static_cast<std::size_t>(interval)] + breaks_[static_cast<std::size_t>(interval) + 1]);
    const int span = find_span(knots_, q, middle);
    std::set<int> columns;
    for (int i = span - q; i <= span; ++i) {
      for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(rows, i); it; ++it) {
        columns.insert(static_cast<int>(it.col()));
      }
    }
    std::vector<int> active(columns.begin(), columns.end());
    // Cyclically ascending: start behind the one gap.
    for (std::size_t i = 1; i < active.size() && static_cast<int>(active.size()) < n; ++i) {
      if (active[i] != active[i - 1] + 1) {
        std::rotate(active.begin(), active.begin() + static_cast<std::ptrdiff_t>(i), active.end());
        break;
      }
    }

    const IntervalMatrix power = power_from_bezier(q) * bezier_conversion(knots_, q, span);
    std::vector<double> table(active.size() * static_cast<std::size_t>(q + 1));
    for (int i = 0; i <= q; ++i) {
      for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator it(rows, span - q + i); it; ++it) {
        const auto a = static_cast<std::size_t>(std::find(active.begin(), active.end(), static_cast<int>(it.col())) -
                                                active.begin());
        for (int k = 0; k <= q; ++k)
          table[a * static_cast<std::size_t>(q + 1) + static_cast<std::size_t>(k)] += it.value() * power(k, i);
      }
    }
    active_.insert(active_.end(), active.begin(), active.end());
    polynomial_.insert(polynomial_.end(), table.begin(), table.end());
    active_first_.push_back(static_cast<int>(active_.size()));
  }
}

}  // namespace celadon
