#pragma once
// A corner where four squares meet, to a fraction of a pixel.

#include <Eigen/Core>
#include <optional>

#include "acquisition/calibrate/board_picture.h"

namespace celadon {

/// Where a corner is expected and what it looks like.
struct SaddleGuess {
  Eigen::Vector2d p_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d along_row = Eigen::Vector2d::UnitX(), along_column = Eigen::Vector2d::UnitY();  ///< of its edges
  double radius_px = 8;  ///< of the disc that holds nothing but this corner
};

struct Saddle {
  Eigen::Vector2d p_px = Eigen::Vector2d::Zero();
  double sigma_px = 0;       ///< of each coordinate, from the pixels' noise
  double blur_px = 0;        ///< standard deviation of the edges' width
  double half_contrast = 0;  ///< levels; above 0 if the squares at +row +column and -row -column are the bright ones
  double rms = 0;            ///< of the residuals, levels
};

/// Least squares fit of
///   I(q) = b + g . (q - p) + c erf(n1 . (q - p) / (sqrt(2) s)) erf(n2 . (q - p) / (sqrt(2) s))
/// to the pixels q of a disc: two straight edges with unit normals n1, n2 that cross in p, blurred by s, under light
/// that changes linearly. sigma_px^2 is the mean of the diagonal of N^-1 (J^T V J) N^-1, N = J^T J, for p, with V the
/// noise of each pixel at its level: linear propagation of that noise through the fit.
/// @return nothing if the disc leaves the picture, the fit does not settle within the disc or the corner's contrast is
/// below 4 times the residuals'
std::optional<Saddle> fit_saddle(const GreyView& picture, const PictureNoise& noise, const SaddleGuess& guess);

}  // namespace celadon
