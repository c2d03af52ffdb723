#pragma once
// How much more the errors of a fit vary than independent noise of the same size would make them: the correlation
// inflation kappa. Source: README.md, "Model selection".

#include <array>
#include <cstddef>
#include <map>
#include <vector>

#include "fitting/profile.h"

namespace celadon {

/// By how much correlation inflates the variance of a fit's unknowns: each of them, and in addition those of the
/// functions that are constant along the profiles, which take up the errors common to a profile.
struct Inflation {
  double within = 1, common = 0;  ///< of functions that vary slowly along the line
  /// Correlation of a line's samples 0, 1, 2, ... steps apart, and samples of a line: finer functions see less of it.
  std::vector<double> along{};
  double rows = 0;
  double total() const { return within + common; }
  /// Of the mean unknown of a fit with `around` functions constant along the profiles among its unknowns.
  double mean(double unknowns, double around) const;
};

/// kappa from the residuals of a reference fit, profile after profile. Lines of rows: the product over both directions
/// of 1 + 2 sum rho_k, k until rho < 0.03, along the line and from profile to profile at the same height; errors common
/// to a profile count by the variance between profiles. Scattered points: the variance of the means of small cells.
class NoiseCorrelation {
 public:
  struct Setting {
    double z_start_mm = 0, z_end_mm = 1;
    double arcs = 4;          ///< v runs over [0, arcs)
    std::size_t samples = 0;  ///< expected
    int unknowns = 1;         ///< of the reference
    int unknowns_around = 1;  ///< in v alone
  };
  explicit NoiseCorrelation(const Setting& setting);

  /// Residuals of a profile's samples (NaN: leave out) and their v; arrays of the profile's length.
  void add(const Profile& profile, const double* v, const double* residual);
  /// What another one has gathered of the profiles that follow. @pre of the same setting
  void merge(const NoiseCorrelation& later);
  /// `lack_of_fit`: what share of the residuals' variance the fit they are to could not follow. It is alike at
  /// neighbours, as correlated errors are, and is none.
  Inflation inflation(double lack_of_fit = 0) const;
  double kappa() const { return inflation().total(); }

 private:
  static constexpr int kLags = 40, kSlots = 64;
  // Products of residuals so many steps apart.
  struct Lags {
    std::array<double, kLags> sum{}, count{};
    double plateau() const;
    double variance() const { return count[0] > 0 ? sum[0] / count[0] : 0; }
    /// rho_0, rho_1, ... above the plateau, as long as they count. `taken`: the share of the variance that the fit has
    /// taken up, alike over so many steps.
    std::vector<double> correlations(double plateau, double taken, double reach) const;
    void merge(const Lags& other);
  };
  struct Laser {
    std::array<std::array<double, kLags>, kSlots> history;
    std::size_t profiles = 0;
  };
  void add_line(const Profile& profile, const double* residual);
  void add_slots(const Profile& profile, const double* residual);
  void add_cells(const Profile& profile, const double* v, const double* residual);
  double scattered_kappa() const;

  Setting setting_;
  std::size_t stride_ = 1, lines_ = 0;
  Lags along_, across_;
  std::map<int, Laser> lasers_;
  double square_ = 0, count_ = 0;                    // of all residuals
  double mean_square_ = 0, profiles_with_mean_ = 0;  // sum of n mean^2 over profiles
  int cells_z_ = 1, cells_v_ = 1;
  std::vector<double> cell_sum_, cell_count_;
  double scattered_square_ = 0, scattered_count_ = 0;
  std::vector<double> line_;
};

}  // namespace celadon
