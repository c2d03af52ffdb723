#include "fitting/stencil_matrix.h"

#include <algorithm>

namespace celadon {
namespace {

// A row of constant j: y_i += sum over du of a_du,i x_(i + du).
template <int kBand>
void add_products(const double* a, std::size_t plane, const double* x, double* y, int n) {
  for (int i = 0; i < n; ++i) {
    double sum = y[i];
    for (int d = 0; d <= 2 * kBand; ++d)
      sum += a[static_cast<std::size_t>(d) * plane + static_cast<std::size_t>(i)] * x[i + d];
    y[i] = sum;
  }
}

}  // namespace

StencilMatrix::StencilMatrix(int count_u, int band_u, int count_v, int band_v)
    : count_u_(count_u),
      band_u_(band_u),
      count_v_(count_v),
      band_v_(band_v),
      planes_v_(std::min(2 * band_v + 1, count_v)),
      pitch_((count_u + 2 * band_u + 3) / 4 * 4) {
  entries_.assign(static_cast<std::size_t>(planes_v_ * (2 * band_u_ + 1)) * field_size(), 0.0);
}

int StencilMatrix::neighbour(int j, int plane) const {
  const int k = planes_v_ == count_v_ ? j + plane : j + plane - band_v_;
  return k < 0 ? k + count_v_ : (k >= count_v_ ? k - count_v_ : k);
}

int StencilMatrix::plane_of(int j, int k) const {
  int d = k - j;
  if (planes_v_ == count_v_) return d < 0 ? d + count_v_ : d;
  if (d > band_v_) d -= count_v_;
  if (d < -band_v_) d += count_v_;
  return d + band_v_;
}

void StencilMatrix::multiply(const double* x, double* y) const {
  std::fill(y, y + field_size(), 0.0);
  for (int j = 0; j < count_v_; ++j) {
    double* to = y + at(0, j);
    for (int o = 0; o < planes_v_; ++o) {
      const double* from = x + at(0, neighbour(j, o)) - band_u_;
      const double* a = plane(o, -band_u_) + at(0, j);
      switch (band_u_) {
        case 0:
          add_products<0>(a, field_size(), from, to, count_u_);
          break;
        case 1:
          add_products<1>(a, field_size(), from, to, count_u_);
          break;
        case 2:
          add_products<2>(a, field_size(), from, to, count_u_);
          break;
        case 3:
          add_products<3>(a, field_size(), from, to, count_u_);
          break;
        case 4:
          add_products<4>(a, field_size(), from, to, count_u_);
          break;
        default:
          add_products<5>(a, field_size(), from, to, count_u_);
          break;
      }
    }
  }
}

}  // namespace celadon
