#pragma once
// What the tests of sums and fits share: objects in closed form, scans of them, streams from memory, dense references.

#include <Eigen/Core>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <numbers>
#include <random>
#include <vector>

#include "fitting/normal_solver.h"
#include "fitting/range_fit.h"

namespace celadon::test {

using Shape = std::function<double(double theta, double z)>;
inline constexpr double kPi = std::numbers::pi;

/// The closed freeform body of the benchmarks, 0 <= z <= 120 mm.
inline double freeform(double t, double z) {
  return 30 + 6 * std::sin(2 * kPi * z / 120) + 3 * std::cos(2 * t) * std::sin(kPi * z / 120) +
         1.5 * std::cos(5 * t + 0.05 * z);
}

class MemoryStream : public ProfileStream {
 public:
  std::vector<Profile> profiles;
  int passes = 0;
  void rewind() override {
    at_ = 0;
    ++passes;
  }
  const Profile* next() override { return at_ < profiles.size() ? &profiles[at_++] : nullptr; }
  std::size_t points() const {
    std::size_t n = 0;
    for (const Profile& p : profiles) n += p.size();
    return n;
  }

 private:
  std::size_t at_ = 0;
};

inline void push(Profile& p, double r, double theta, double z) {
  p.r_mm.push_back(r);
  p.theta_rad.push_back(theta);
  p.z_mm.push_back(z);
}

struct ScanSetting {
  int profiles = 200, rows = 200;
  double height = 120, sigma = 0;
  double correlation = 0;    ///< AR(1) along the line
  double profile_sigma = 0;  ///< an error common to each profile
  unsigned seed = 1;
};

inline MemoryStream scan(const Shape& shape, const ScanSetting& s) {
  std::mt19937_64 random(s.seed);
  std::normal_distribution<double> normal;
  MemoryStream stream;
  for (int i = 0; i < s.profiles; ++i) {
    Profile p;
    p.index = static_cast<std::uint32_t>(i);
    const double theta = 2 * kPi * (i + 0.5) / s.profiles, common = s.profile_sigma * normal(random);
    double e = normal(random);
    for (int j = 0; j < s.rows; ++j) {
      if (j) e = s.correlation * e + std::sqrt(1 - s.correlation * s.correlation) * normal(random);
      const double z = s.height * j / (s.rows - 1);
      push(p, shape(theta, z) + s.sigma * e + common, theta, z);
      p.row.push_back(static_cast<std::uint16_t>(j));
    }
    stream.profiles.push_back(std::move(p));
  }
  return stream;
}

inline MemoryStream scattered(const Shape& shape, int n, double sigma, unsigned seed = 1, double height = 120) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0, 1);
  MemoryStream stream;
  for (int k = 0; k < n; ++k) {
    if (k % 1024 == 0) {
      stream.profiles.emplace_back();
      stream.profiles.back().order = ProfileOrder::scattered;
    }
    const double t = 2 * kPi * share(random), z = height * share(random);
    push(stream.profiles.back(), shape(t, z) + sigma * normal(random), t, z);
  }
  return stream;
}

inline MomentGrid accumulate(MemoryStream& stream, const GridSpecification& grid) {
  MomentGrid sums(grid);
  stream.rewind();
  while (const Profile* p = stream.next()) sums.add(p->r_mm, p->theta_rad, p->z_mm);
  return sums;
}

inline tl::expected<RangeFit, FitError> fit(MemoryStream& stream, const RangeFitOptions& options = {}) {
  const auto grid = choose_grid(stream, options);
  if (!grid) return tl::unexpected(grid.error());
  const MomentGrid sums = accumulate(stream, *grid);
  stream.passes = 0;
  return fit_range(sums, stream, options);
}

/// RMS and largest difference to the truth over an even grid, where `where` holds.
struct Miss {
  double rms = 0, max = 0;
};
inline Miss miss(const RangeFunction& f, const Shape& truth, const std::function<bool(double, double)>& where = {}) {
  Miss m;
  double square = 0, count = 0;
  const double lo = f.base().band_start, hi = f.base().band_end;
  for (int i = 0; i < 211; ++i)
    for (int j = 0; j <= 120; ++j) {
      const double t = 2 * kPi * (i + 0.37) / 211, z = lo + (hi - lo) * j / 120;
      if (where && !where(t, z)) continue;
      const double e = f(t, z) - truth(t, z);
      square += e * e;
      ++count;
      m.max = std::max(m.max, std::abs(e));
    }
  m.rms = std::sqrt(square / count);
  return m;
}

/// B-spline values by the recursion of Cox and de Boor, on their own: nothing of the code under test.
inline double bspline(const std::vector<double>& knots, int i, int degree, double t) {
  const auto k = static_cast<std::size_t>(i), d = static_cast<std::size_t>(degree);
  if (degree == 0) {
    const bool last = knots[k + 1] == knots.back() && t == knots.back() && knots[k] < knots[k + 1];
    return (knots[k] <= t && t < knots[k + 1]) || last ? 1 : 0;
  }
  double value = 0;
  if (knots[k + d] > knots[k]) value += (t - knots[k]) / (knots[k + d] - knots[k]) * bspline(knots, i, degree - 1, t);
  if (knots[k + d + 1] > knots[k + 1])
    value += (knots[k + d + 1] - t) / (knots[k + d + 1] - knots[k + 1]) * bspline(knots, i + 1, degree - 1, t);
  return value;
}

/// One row per sample: all free functions of a pair of spaces, u running fastest.
inline Eigen::MatrixXd design(const FitSpace& space, const std::vector<double>& v, const std::vector<double>& z) {
  const auto values = [](const RangeSpace& s, double t) {
    const auto count = static_cast<int>(s.knots().size()) - s.degree() - 1;
    Eigen::RowVectorXd b(count);
    for (int i = 0; i < count; ++i) b(i) = bspline(s.knots(), i, s.degree(), t);
    return Eigen::RowVectorXd(b * s.extraction());
  };
  const int nu = space.u.free_count(), nv = space.v.free_count();
  Eigen::MatrixXd rows(static_cast<Eigen::Index>(v.size()), nu * nv);
  for (std::size_t k = 0; k < v.size(); ++k) {
    const Eigen::RowVectorXd bu = values(space.u, z[k]), bv = values(space.v, v[k]);
    for (int j = 0; j < nv; ++j) rows.row(static_cast<Eigen::Index>(k)).segment(j * nu, nu) = bv(j) * bu;
  }
  return rows;
}

/// Uniform breaks along z.
inline std::vector<double> even_breaks(double lo, double hi, int intervals) {
  std::vector<double> b;
  for (int i = 0; i <= intervals; ++i) b.push_back(lo + (hi - lo) * i / intervals);
  return b;
}

/// The normal matrix as a dense one, u running fastest.
inline Eigen::MatrixXd dense(const StencilMatrix& a) {
  const int nu = a.count_u();
  Eigen::MatrixXd m(a.size(), a.size());
  AlignedVector<double> x(a.field_size(), 0.0), y(a.field_size());
  for (int c = 0; c < a.size(); ++c) {
    x[a.at(c % nu, c / nu)] = 1;
    a.multiply(x.data(), y.data());
    x[a.at(c % nu, c / nu)] = 0;
    for (int r = 0; r < a.size(); ++r) m(r, c) = y[a.at(r % nu, r / nu)];
  }
  return m;
}

}  // namespace celadon::test
