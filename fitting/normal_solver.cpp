#include "fitting/normal_solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "fitting/banded_cholesky.h"
#include "fitting/dense_product.h"

namespace celadon {
namespace {

constexpr int kSmall = 320;    // unknowns up to which the direct factor is always the quicker way
constexpr double kSparse = 8;  // and samples an unknown below which it is
// Functions of a direction above which its Gram matrix is solved as a band: below, its inverse is multiplied sooner.
constexpr int kDense = 160;
// Of the probes that estimate a trace, whose own scatter is far larger.
constexpr double kProbeTolerance = 1e-4;

using MapMatrix = Eigen::Map<const Eigen::MatrixXd, 0, Eigen::OuterStride<>>;

double trace(const StencilMatrix& a) {
  double sum = 0;
  for (int j = 0; j < a.count_v(); ++j)
    for (int i = 0; i < a.count_u(); ++i) sum += a.diagonal(i, j);
  return sum;
}

SmoothingBasis::Direction diagonalise(const GramMatrices& gram) {
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> solver(gram[2], gram[0]);
  return {solver.eigenvectors(), solver.eigenvalues().cwiseMax(0).cwiseSqrt()};
}

// Gram matrices of each direction alone, weighted by all samples: the functions of the other one add up to 1.
struct SampleGram {
  Eigen::MatrixXd along_u, around_v;
  explicit SampleGram(const StencilMatrix& a) {
    const int nu = a.count_u(), nv = a.count_v(), band = a.band_u();
    along_u.setZero(nu, nu);
    around_v.setZero(nv, nv);
    Eigen::ArrayXd over_v(nu);
    for (int o = 0; o < a.planes_v(); ++o)
      for (int d = -band; d <= band; ++d) {
        over_v.setZero();
        for (int j = 0; j < nv; ++j) {
          const Eigen::Map<const Eigen::ArrayXd> entries(a.plane(o, d) + a.at(0, j), nu);
          over_v += entries;
          around_v(j, a.neighbour(j, o)) += entries.sum();
        }
        for (int i = std::max(0, -d); i < std::min(nu, nu - d); ++i) along_u(i, i + d) += over_v(i);
      }
  }
};

double dot(const AlignedVector<double>& a, const AlignedVector<double>& b) {
  using Vector = Eigen::Map<const Eigen::VectorXd>;
  const auto n = static_cast<Eigen::Index>(a.size());
  return Vector(a.data(), n).dot(Vector(b.data(), n));
}

}  // namespace

// (A + mu E)^-1 were the samples' density a product along z and around: A = Gu x Gv / weight. Without smoothing the
// Gram matrices are the samples' own, and each unknown is scaled by what they put on the diagonal; with it, the density
// is taken as even and both pairs (G, second derivatives) are diagonalised, where the energy's eigenvalues are nearly
// (sqrt(a) + sqrt(b))^2.
struct NormalSolver::Preconditioner {
  // z = left_u * (D . (left_u' r right_v)) * right_v' or left_u * r * right_v, all with padded rows
  Eigen::MatrixXd left_u, left_u_transposed, right_v;
  Eigen::ArrayXXd scale;
  bool spectral = false, usable = true;
  std::optional<BandedCholesky> banded_u, banded_v;  // in place of the inverses where these are large

  Preconditioner(const NormalEquations& equations, SmoothingBasis& basis, double mu) {
    const StencilMatrix& a = equations.matrix();
    scale.resize(a.count_u(), a.count_v());
    spectral = mu > 0;
    if (spectral) {
      const auto &u = basis.along_u(), &v = basis.around_v();
      left_u = with_padded_rows(u.vectors);
      left_u_transposed = with_padded_rows(u.vectors.transpose());
      right_v = v.vectors;
      const Eigen::MatrixXd &gu = basis.energy().along_u[0], &gv = basis.energy().along_v[0];
      const double density = trace(a) / (gu.trace() * gv.trace());
      for (int j = 0; j < a.count_v(); ++j)
        for (int i = 0; i < a.count_u(); ++i) {
          const double root = u.roots(i) + v.roots(j);
          scale(i, j) = 1 / (density + mu * root * root);
        }
    } else {
      const SampleGram gram(a);
      for (int j = 0; j < a.count_v(); ++j)
        for (int i = 0; i < a.count_u(); ++i) {
          const double d = a.diagonal(i, j);
          scale(i, j) = d > 0 ? std::sqrt(gram.along_u(i, i) * gram.around_v(j, j) / d) : 0;
        }
      if (std::max(a.count_u(), a.count_v()) > kDense) {
        banded_u.emplace(gram.along_u, a.band_u());
        banded_v.emplace(gram.around_v, a.planes_v() / 2);
        usable = banded_u->ok() && banded_v->ok();
        return;
      }
      const Eigen::LLT<Eigen::MatrixXd> u(gram.along_u), v(gram.around_v);
      usable = u.info() == Eigen::Success && v.info() == Eigen::Success;
      if (!usable) return;
      left_u = with_padded_rows(u.solve(Eigen::MatrixXd::Identity(a.count_u(), a.count_u())));
      right_v = v.solve(Eigen::MatrixXd::Identity(a.count_v(), a.count_v()));
    }
  }

  void apply(const StencilMatrix& a, const AlignedVector<double>& r, AlignedVector<double>& z, Eigen::MatrixXd& work,
             Eigen::MatrixXd& half) const {
    const Eigen::Index stride = static_cast<Eigen::Index>(a.field_size()) / a.count_v();
    const Eigen::Map<const Eigen::MatrixXd, 0, Eigen::OuterStride<>> from(r.data() + a.at(0, 0), a.count_u(),
                                                                          a.count_v(), Eigen::OuterStride<>(stride));
    Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> to(z.data() + a.at(0, 0), a.count_u(), a.count_v(),
                                                            Eigen::OuterStride<>(stride));
    const auto multiplied = [](Eigen::MatrixXd& result, const Eigen::MatrixXd& left, const Eigen::MatrixXd& right) {
      result.setZero();
      add_product(1, left, right, result);
    };
    if (spectral) {
      work.topRows(a.count_u()) = from;
      multiplied(half, left_u_transposed, work);
      multiplied(work, half, right_v);
      work.topRows(a.count_u()).array() *= scale;
      multiplied(half, left_u, work);
      work.setZero();
      add_transposed_product(1, half, right_v, work);
      to = work.topRows(a.count_u());
    } else if (banded_u) {
      // Solved along columns, which are contiguous: once as it is and once transposed.
      Eigen::MatrixXd across = (from.array() * scale).matrix();
      banded_v->divide(across);
      Eigen::MatrixXd along = across.transpose();
      banded_u->divide(along);
      to = (along.transpose().array() * scale).matrix();
    } else {
      work.topRows(a.count_u()) = (from.array() * scale).matrix();
      multiplied(half, left_u, work);
      multiplied(work, half, right_v);
      to = (work.topRows(a.count_u()).array() * scale).matrix();
    }
  }
};

BendingEnergy bending_energy(const NormalEquations& equations) {
  const double r = equations.mean_range() > 0 ? equations.mean_range() : 1;
  if (equations.base() == BaseKind::sphere)
    return spherical_energy(equations.space().u, equations.space().v, equations.arcs());
  return {gram_matrices(equations.space().u), gram_matrices(equations.space().v, equations.arcs(), r)};
}

double energy_factor(const NormalEquations& equations, const BendingEnergy& energy, double relative_weight) {
  const double bending = energy.trace();
  return bending > 0 ? relative_weight * trace(equations.matrix()) / bending : 0;
}

const BendingEnergy& SmoothingBasis::energy() {
  if (!energy_) energy_ = bending_energy(equations_);
  return *energy_;
}
const SmoothingBasis::Direction& SmoothingBasis::along_u() {
  if (!u_) u_ = diagonalise(energy().along_u);
  return *u_;
}
const SmoothingBasis::Direction& SmoothingBasis::around_v() {
  if (!v_) v_ = diagonalise(energy().along_v);
  return *v_;
}

NormalSolver::NormalSolver(const NormalEquations& equations, double smoothing, const Options& options)
    : equations_(equations), options_(options) {
  if (!options_.basis) options_.basis = &own_basis_.emplace(equations);
  if (smoothing <= 0) return;
  mu_ = energy_factor(equations, options_.basis->energy(), smoothing);
  if (mu_ > 0) {
    regularised_ = equations.matrix();
    options_.basis->energy().add_to(*regularised_, mu_);
  }
}

NormalSolver::NormalSolver(const NormalEquations& equations, double smoothing)
    : NormalSolver(equations, smoothing, Options{}) {}

bool NormalSolver::factorise() {
  if (const PoleJets* jets = equations_.jets()) {
    if (!pole_factor_) pole_factor_ = std::make_unique<PoleSolver>(system(), *jets);
    return pole_factor_->ok();
  }
  if (!factor_) factor_ = std::make_unique<BlockCholesky>(system());
  return factor_->ok();
}

bool NormalSolver::conjugate_gradients(const AlignedVector<double>& b, double tolerance, AlignedVector<double>& x) {
  const StencilMatrix& a = system();
  if (!preconditioner_) preconditioner_ = std::make_shared<const Preconditioner>(equations_, *options_.basis, mu_);
  if (!preconditioner_->usable) return false;
  AlignedVector<double> r(b), z(b.size(), 0.0), p, q(b.size());
  Eigen::MatrixXd work = Eigen::MatrixXd::Zero(padded_rows(a.count_u()), a.count_v()), half = work;
  x.assign(b.size(), 0.0);
  preconditioner_->apply(a, r, z, work, half);
  p = z;
  double rz = dot(r, z);
  const double target = tolerance * tolerance * rz;
  for (iterations_ = 0; rz > target; ++iterations_) {
    if (iterations_ == options_.max_iterations) return false;
    a.multiply(p.data(), q.data());
    const double curvature = dot(p, q);
    if (!(curvature > 0)) return false;
    const double alpha = rz / curvature;
    for (std::size_t k = 0; k < x.size(); ++k) {
      x[k] += alpha * p[k];
      r[k] -= alpha * q[k];
    }
    preconditioner_->apply(a, r, z, work, half);
    const double next = dot(r, z), beta = next / rz;
    rz = next;
    for (std::size_t k = 0; k < p.size(); ++k) p[k] = z[k] + beta * p[k];
  }
  return std::isfinite(rz);
}

bool NormalSolver::solve_field(const AlignedVector<double>& b, double tolerance, AlignedVector<double>& x) {
  const StencilMatrix& a = equations_.matrix();
  const bool banded = a.count_u() == 1 || a.count_v() == 1;  // its factor costs as little as the matrix itself
  const bool direct =
      options_.direct || banded || equations_.jets() || a.size() <= kSmall || equations_.weight() < kSparse * a.size();
  if (!factor_ && !direct && conjugate_gradients(b, tolerance, x)) return true;
  if (!factorise()) return false;
  x.resize(b.size());
  pole_factor_ ? pole_factor_->solve(b.data(), x.data()) : factor_->solve(b.data(), x.data());
  return true;
}

// Solved about the mean range, where the right-hand side is small and rounding with it.
std::optional<Eigen::MatrixXd> NormalSolver::solve() {
  const Eigen::MatrixXd mean =
      Eigen::MatrixXd::Constant(equations_.matrix().count_u(), equations_.matrix().count_v(), equations_.mean_range());
  const auto correction = apply_inverse(equations_.gradient(mean));
  if (!correction) return std::nullopt;
  return mean + *correction;
}

std::optional<Eigen::MatrixXd> NormalSolver::apply_inverse(const Eigen::MatrixXd& y) {
  AlignedVector<double> x;
  if (!solve_field(equations_.to_field(y), options_.tolerance, x)) return std::nullopt;
  return equations_.to_matrix(x);
}

double NormalSolver::effective_parameters() {
  const StencilMatrix& a = equations_.matrix();
  const PoleJets* jets = equations_.jets();
  const int nu = a.count_u(), nv = a.count_v(), n = jets ? jets->unknowns() : a.size();
  if (mu_ <= 0) return equations_.supported_unknowns();
  // tr (A + mu E)^-1 A = n - mu tr (A + mu E)^-1 E: what smoothing takes away is the small part where it matters. The
  // trace is the mean of z' (A + mu E)^-1 mu E z over signs z: all unit vectors when small, else fixed signs, the same
  // for every mu so that their noise cancels in comparisons.
  const bool exact = n <= kSmall;
  const int probes = exact ? n : 4;
  std::uint64_t state = 0x9e3779b97f4a7c15u;
  double lost = 0;
  AlignedVector<double> of_samples(a.field_size()), of_both(a.field_size()), x;
  const auto sign = [&] {
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (state >> 33) & 1 ? 1.0 : -1.0;
  };
  const int first = jets ? jets->first_row() : 0, rows = jets ? jets->last_row() - first : nu, free = rows * nv;
  for (int k = 0; k < probes; ++k) {
    Eigen::MatrixXd z = Eigen::MatrixXd::Zero(nu, nv);  // P times a unit vector, or times signs
    for (int i = 0; i < free; ++i) z(first + i % rows, i / rows) = exact ? (i == k ? 1.0 : 0.0) : sign();
    for (int i = free; i < n; ++i)
      if (!exact || i == k) z += (exact ? 1.0 : sign()) * jets->column(i - free);
    const auto field = equations_.to_field(z);
    a.multiply(field.data(), of_samples.data());
    system().multiply(field.data(), of_both.data());
    for (std::size_t i = 0; i < of_both.size(); ++i) of_both[i] -= of_samples[i];
    if (!solve_field(of_both, kProbeTolerance, x)) return n;
    lost += dot(field, x);
  }
  return n - (exact ? lost : lost / probes);
}

RangeFunction range_function(const NormalEquations& equations, const Eigen::MatrixXd& free) {
  return range_function(equations.space(), equations.base(), equations.arcs(), free);
}

RangeFunction range_function(const FitSpace& space, BaseKind kind, const BaseArcs& arcs, const Eigen::MatrixXd& free) {
  const auto &u = space.u, &v = space.v;
  BaseSurface base;
  base.kind = kind;
  base.arcs = arcs;
  base.band_start = u.breaks().front();
  base.band_end = u.breaks().back();
  std::vector<double> knots_u(u.knots());
  if (!base.spherical())
    for (double& k : knots_u) k = std::clamp((k - base.band_start) / (base.band_end - base.band_start), 0.0, 1.0);
  const Eigen::MatrixXd along_u = u.extraction() * free;
  Eigen::MatrixXd coefficients = along_u * v.extraction().transpose();
  return {base, u.degree(), v.degree(), std::move(knots_u), v.knots(), std::move(coefficients)};
}

}  // namespace celadon
