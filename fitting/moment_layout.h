#pragma once
// Where a cell keeps its sums. Local coordinates of a cell are s (along z) and t (along v), both in [-1, 1].

namespace celadon {

/// A cell holds (2 p + 1) rows of weight moments, row b = sum w s^b t^a over lanes a = 0..2 q, and (p + 1) rows of
/// range moments, row b = sum w r s^b t^a over lanes a = 0..q. Lane 2 q + 1 of the first row is sum w r^2; what the
/// remaining lanes hold has no meaning (they fill the vectors).
struct MomentLayout {
  int degree_u = 3, degree_v = 3;
  int weight_lanes = 8, range_lanes = 4;

  MomentLayout(int p, int q) : degree_u(p), degree_v(q), weight_lanes(q <= 3 ? 8 : 16), range_lanes(q <= 3 ? 4 : 8) {}
  int weight_rows() const { return 2 * degree_u + 1; }
  int range_rows() const { return degree_u + 1; }
  int weight(int b, int a) const { return b * weight_lanes + a; }
  int range(int b, int a) const { return weight_rows() * weight_lanes + b * range_lanes + a; }
  int square() const { return 2 * degree_v + 1; }
  /// A multiple of eight: every cell starts on a cache line.
  int stride() const { return (weight_rows() * weight_lanes + range_rows() * range_lanes + 7) / 8 * 8; }
};

}  // namespace celadon
