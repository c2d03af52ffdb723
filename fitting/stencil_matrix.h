#pragma once
// The symmetric matrix of normal equations over a grid of free coefficients: banded along u, cyclic and banded along v,
// kept as one plane of entries per offset. Source: README.md, "Solver".

#include <Eigen/Core>
#include <cstddef>

#include "fitting/aligned_allocator.h"

namespace celadon {

/// Unknown (i, j), i = 0..count_u - 1 along u, j = 0..count_v - 1 around v, couples with (i + du, j + dv mod count_v)
/// for |du| <= band_u, |dv| <= band_v. Vectors over the unknowns ("fields") carry band_u zeros on both sides of each
/// row of constant j, so that products need no bounds: element (i, j) is at(i, j), everything else must stay zero.
class StencilMatrix {
 public:
  StencilMatrix() = default;
  StencilMatrix(int count_u, int band_u, int count_v, int band_v);

  int count_u() const { return count_u_; }
  int count_v() const { return count_v_; }
  int band_u() const { return band_u_; }
  int band_v() const { return band_v_; }
  int size() const { return count_u_ * count_v_; }
  std::size_t field_size() const { return static_cast<std::size_t>(count_v_) * static_cast<std::size_t>(pitch_); }
  std::size_t at(int i, int j) const { return static_cast<std::size_t>(j * pitch_ + band_u_ + i); }

  /// Planes of offsets along v: all 2 band_v + 1 of them, or count_v if the circle is shorter than that.
  int planes_v() const { return planes_v_; }
  /// The neighbour of j in a plane, and the plane in which k is a neighbour of j. @pre they are within band_v
  int neighbour(int j, int plane) const;
  int plane_of(int j, int k) const;
  /// Entries of one plane, to be indexed by at(i, j) of the row's unknown.
  double* plane(int plane_v, int du) { return entries_.data() + plane_start(plane_v, du); }
  const double* plane(int plane_v, int du) const { return entries_.data() + plane_start(plane_v, du); }
  double diagonal(int i, int j) const { return plane(plane_of(j, j), 0)[at(i, j)]; }

  /// y = A x over fields.
  void multiply(const double* x, double* y) const;
  void scale(double factor);
  /// Entry of unknowns a and b times d_a d_b. @pre d is count_u x count_v
  void scale_both_sides(const Eigen::MatrixXd& d);
  /// += factor b, entry by entry. @pre of the same counts and bands
  void add(const StencilMatrix& b, double factor);
  /// += g' g where there are entries. g: a column an unknown, u running fastest
  void add_product(const Eigen::MatrixXd& g);
  std::size_t memory_bytes() const { return entries_.capacity() * sizeof(double); }

 private:
  std::size_t plane_start(int plane_v, int du) const {
    return static_cast<std::size_t>(plane_v * (2 * band_u_ + 1) + du + band_u_) * field_size();
  }
  int count_u_ = 0, band_u_ = 0, count_v_ = 0, band_v_ = 0, planes_v_ = 0, pitch_ = 0;
  AlignedVector<double> entries_;
};

}  // namespace celadon
