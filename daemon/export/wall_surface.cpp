#include "daemon/export/wall_surface.h"

#include <TColStd_Array1OfInteger.hxx>
#include <TColStd_Array1OfReal.hxx>
#include <TColStd_Array2OfReal.hxx>
#include <TColgp_Array2OfPnt.hxx>
#include <algorithm>
#include <cmath>
#include <sstream>
#include <vector>

namespace celadon {
namespace {

/// Distinct knots with their multiplicities.
struct KnotTable {
  std::vector<double> values;
  std::vector<int> multiplicities;
  explicit KnotTable(const std::vector<double>& knots) {
    for (const double knot : knots) {
      if (values.empty() || knot > values.back()) {
        values.push_back(knot);
        multiplicities.push_back(0);
      }
      ++multiplicities.back();
    }
  }
  TColStd_Array1OfReal knots() const {
    TColStd_Array1OfReal array(1, static_cast<int>(values.size()));
    std::copy(values.begin(), values.end(), array.begin());
    return array;
  }
  TColStd_Array1OfInteger counts() const {
    TColStd_Array1OfInteger array(1, static_cast<int>(multiplicities.size()));
    std::copy(multiplicities.begin(), multiplicities.end(), array.begin());
    return array;
  }
};

std::optional<std::string> knot_problem(const char* direction, const std::vector<double>& knots, int degree) {
  if (!std::all_of(knots.begin(), knots.end(), [](double knot) { return std::isfinite(knot); }) ||
      !std::is_sorted(knots.begin(), knots.end())) {
    return std::string("the knots in ") + direction + " are not ascending finite numbers";
  }
  const KnotTable table(knots);
  for (std::size_t i = 0; i < table.values.size(); ++i) {
    const bool end = i == 0 || i + 1 == table.values.size();
    if (end ? table.multiplicities[i] != degree + 1 : table.multiplicities[i] > degree) {
      return std::string("the knot ") + number(table.values[i]) + " in " + direction + " has multiplicity " +
             std::to_string(table.multiplicities[i]) + " at degree " + std::to_string(degree);
    }
  }
  return std::nullopt;
}

}  // namespace

std::string number(double value) {
  std::ostringstream text;
  text.precision(6);
  text << value;
  return text.str();
}

std::optional<std::string> wall_problem(const NurbsSurface& wall) {
  if (auto problem = knot_problem("u", wall.knots_u, wall.degree_u)) {
    return problem;
  }
  if (auto problem = knot_problem("v", wall.knots_v, wall.degree_v)) {
    return problem;
  }
  for (Eigen::Index i = 0; i < wall.control_points.cols(); ++i) {
    const Eigen::Vector4d point = wall.control_points.col(i);
    if (!point.allFinite() || !(point.w() > 1e-12)) {
      return "control point " + std::to_string(i) + " is not finite or its weight is not positive";
    }
  }
  return std::nullopt;
}

Handle(Geom_BSplineSurface) surface_of(const NurbsSurface& wall) {
  TColgp_Array2OfPnt poles(1, wall.count_u(), 1, wall.count_v());
  TColStd_Array2OfReal weights(1, wall.count_u(), 1, wall.count_v());
  for (int i = 0; i < wall.count_u(); ++i) {
    for (int j = 0; j < wall.count_v(); ++j) {
      const Eigen::Vector4d point = wall.control_point(i, j);
      poles(i + 1, j + 1) = gp_Pnt(point.x() / point.w(), point.y() / point.w(), point.z() / point.w());
      weights(i + 1, j + 1) = point.w();
    }
  }
  const KnotTable u(wall.knots_u);
  const KnotTable v(wall.knots_v);
  return new Geom_BSplineSurface(poles, weights, u.knots(), v.knots(), u.counts(), v.counts(), wall.degree_u,
                                 wall.degree_v);
}

bool is_pole(const NurbsSurface& wall, int row) {
  const Eigen::Vector4d first = wall.control_point(row, 0);
  for (int j = 1; j < wall.count_v(); ++j) {
    const Eigen::Vector4d other = wall.control_point(row, j);
    if ((first.head<3>() / first.w() - other.head<3>() / other.w()).norm() > tolerance_mm) {
      return false;
    }
  }
  return true;
}

}  // namespace celadon
