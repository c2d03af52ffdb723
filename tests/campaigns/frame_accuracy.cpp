// The experiment of the thesis's figure 4.3: errors of estimated frames against the largest noise N_M/R = 3 sigma/R,
// from 0 to 10 percent: of the origin on spheres (percent of R), of the axis on cylinders of length 2R (degrees).
// Beside the thesis's rule on the quadric of least squares with a unit norm of Q_u (Faugeras and Hebert): the quadric
// rule used here, and the whole of local_frame; on whole shapes and on parts. Writes frame_accuracy.csv and
// frame_accuracy.svg into the folder given (default: the current one). An optional second argument is the number of
// trials a point, 100 by default.
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "fitting/local_frame.h"
#include "fitting/quadric.h"
#include "fitting/quadric_axes.h"
#include "tests/fitting/frame_tools.h"

namespace {

namespace test = celadon::test;

constexpr double kRadius = 30, kPi = std::numbers::pi;
constexpr int kPoints = 2000;

struct Frame {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero(), axis = Eigen::Vector3d::UnitZ();
};

// Least squares of q with |Q_u| = 1, centred and scaled.
celadon::Quadric unit_norm_fit(const Eigen::Matrix3Xd& points, Eigen::Vector3d& centre, double& size) {
  const Eigen::Index N = points.cols();
  centre = points.rowwise().mean();
  size = std::sqrt((points.colwise() - centre).squaredNorm() / static_cast<double>(3 * N));
  Eigen::MatrixXd squares(N, 6), rest(N, 4);
  for (Eigen::Index k = 0; k < N; ++k) {
    const Eigen::Vector3d y = (points.col(k) - centre) / size;
    const double root = std::sqrt(2);  // off-diagonal elements count twice in the norm
    squares.row(k) << y.x() * y.x(), y.y() * y.y(), y.z() * y.z(), root * y.x() * y.y(), root * y.y() * y.z(),
        root * y.z() * y.x();
    rest.row(k) << y.transpose(), 1;
  }
  const Eigen::MatrixXd M11 = squares.transpose() * squares, M12 = squares.transpose() * rest,
                        M22 = rest.transpose() * rest, S = M22.ldlt().solve(M12.transpose());
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(M11 - M12 * S);
  const Eigen::VectorXd q = solver.eigenvectors().col(0), l = -S * q;
  const double root = std::sqrt(2);
  return celadon::Quadric::from_coefficients(
      {q[0], q[1], q[2], root * q[3], root * q[4], root * q[5], l[0], l[1], l[2], l[3]});
}

// Table 4.1 without tolerances, as noisy coefficients leave no rank of 2: the odd sign, else the largest eigenvalue.
Frame thesis_frame(const Eigen::Matrix3Xd& points) {
  Eigen::Vector3d centre;
  double size = 1;
  const celadon::Quadric q = unit_norm_fit(points, centre, size);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(q.Q_u);
  const Eigen::Vector3d l = solver.eigenvalues();
  Eigen::Index k = 0;
  l.cwiseAbs().maxCoeff(&k);
  if (l[0] * l[2] < 0) k = l[0] * l[1] < 0 ? 0 : 2;
  return {centre + size * (-0.5 * q.Q_u.fullPivLu().solve(q.v)), solver.eigenvectors().col(k)};
}

Frame quadric_frame(const Eigen::Matrix3Xd& points) {
  const auto fit = celadon::fit_quadric(points);
  if (!fit) std::abort();
  const celadon::QuadricAxes axes = celadon::quadric_axes(*fit);
  // The centre (4.3) whatever its uncertainty: a sphere is what is looked at.
  return {-0.5 * fit->quadric.Q_u.fullPivLu().solve(fit->quadric.v), axes.frames[0].axes.col(2)};
}

Frame whole_frame(const Eigen::Matrix3Xd& points) {
  const auto frame = celadon::local_frame(points);
  if (!frame) {
    std::fprintf(stderr, "frame_accuracy: %s\n", frame.error().message.c_str());
    std::exit(1);
  }
  return {frame->X_SL.translation(), frame->X_SL.linear().col(2)};
}

struct Method {
  const char* name;
  const char* title;
  const char* colour;
  Frame (*frame)(const Eigen::Matrix3Xd&);
};
const std::array<Method, 3> kMethods = {{{"thesis", "the thesis's rule", "#b03030", thesis_frame},
                                         {"quadric", "Taubin's quadric, gap rule", "#3060a0", quadric_frame},
                                         {"local_frame", "local_frame", "#206040", whole_frame}}};

struct Cloud {
  const char* name;
  const char* title;
  bool sphere;
  double extent_rad;
};
const std::array<Cloud, 4> kClouds = {{{"sphere", "whole sphere: origin (% of R)", true, kPi},
                                       {"cap", "60 degree cap: origin (% of R)", true, kPi / 3},
                                       {"cylinder", "whole cylinder: axis (degrees)", false, 2 * kPi},
                                       {"sector", "90 degree sector: axis (degrees)", false, kPi / 2}}};

struct Row {
  std::size_t cloud, method;
  double noise_percent, median, p95;
};

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1) + 0.5)];
}

// Four panels of lines with logarithmic errors: medians, and 95th percentiles dashed.
void write_svg(std::FILE* svg, const std::vector<Row>& rows) {
  constexpr double kWidth = 860, kHeight = 720, kPanelWidth = 350, kPanelHeight = 250;
  std::fprintf(
      svg,
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%g\" height=\"%g\" viewBox=\"0 0 %g %g\" "
      "font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%%\" height=\"100%%\" fill=\"white\"/>\n",
      kWidth, kHeight, kWidth, kHeight);
  for (std::size_t cloud = 0; cloud < kClouds.size(); ++cloud) {
    const double left = 60 + (cloud % 2 ? kPanelWidth + 70 : 0), top = 40 + (cloud / 2 ? kPanelHeight + 70 : 0);
    const double low = -3, high = 2;
    const auto x_of = [&](double percent) { return left + kPanelWidth * percent / 10; };
    const auto y_of = [&](double error) {
      const double exponent = std::clamp(std::log10(std::max(error, 1e-30)), low, high);
      return top + kPanelHeight * (high - exponent) / (high - low);
    };
    std::fprintf(svg, "<text x=\"%.1f\" y=\"%.1f\" font-size=\"14\">%s</text>\n", left, top - 10, kClouds[cloud].title);
    for (int e = static_cast<int>(low); e <= static_cast<int>(high); ++e) {
      const double y = y_of(std::pow(10.0, e));
      std::fprintf(svg, "<path d=\"M%.1f %.1fh%.1f\" stroke=\"#d0d0d0\"/>\n", left, y, kPanelWidth);
      std::fprintf(svg, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\">%g</text>\n", left - 6, y + 4,
                   std::pow(10.0, e));
    }
    for (int percent = 0; percent <= 10; percent += 2) {
      std::fprintf(svg, "<path d=\"M%.1f %.1fv%.1f\" stroke=\"#d0d0d0\"/>\n", x_of(percent), top, kPanelHeight);
      std::fprintf(svg, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">%d</text>\n", x_of(percent),
                   top + kPanelHeight + 16, percent);
    }
    std::fprintf(svg, "<rect x=\"%.1f\" y=\"%.1f\" width=\"%g\" height=\"%g\" fill=\"none\" stroke=\"black\"/>\n", left,
                 top, kPanelWidth, kPanelHeight);
    for (std::size_t method = 0; method < kMethods.size(); ++method) {
      for (const bool upper : {false, true}) {
        std::string path;
        for (const Row& row : rows) {
          if (row.cloud != cloud || row.method != method || row.noise_percent == 0) continue;
          std::array<char, 48> point{};
          std::snprintf(point.data(), point.size(), "%c%.1f %.1f", path.empty() ? 'M' : 'L', x_of(row.noise_percent),
                        y_of(upper ? row.p95 : row.median));
          path += point.data();
        }
        std::fprintf(svg, "<path d=\"%s\" fill=\"none\" stroke=\"%s\" stroke-width=\"%s/>\n", path.c_str(),
                     kMethods[method].colour, upper ? "1\" stroke-dasharray=\"4 3\"" : "2\"");
      }
    }
  }
  const double below = kHeight - 62;
  std::fprintf(svg, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">3 sigma / R (%%)</text>\n", kWidth / 2, below);
  for (std::size_t method = 0; method < kMethods.size(); ++method) {
    const double x = 60 + 230 * static_cast<double>(method), y = below + 24;
    std::fprintf(svg, "<path d=\"M%.1f %.1fh30\" stroke=\"%s\" stroke-width=\"2\"/>\n", x, y - 4,
                 kMethods[method].colour);
    std::fprintf(svg, "<text x=\"%.1f\" y=\"%.1f\">%s</text>\n", x + 38, y, kMethods[method].title);
  }
  std::fprintf(svg,
               "<text x=\"60\" y=\"%.1f\">medians; dashed: 95th percentiles; clipped to the panels</text>\n</svg>\n",
               below + 46);
}

}  // namespace

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);  // a campaign is watched
  const std::string folder = argc > 1 ? argv[1] : ".";
  const int trials = argc > 2 ? std::max(1, std::atoi(argv[2])) : 100;
  std::printf("%d trials a point, %d points a cloud, R = %g mm, seed 43\n", trials, kPoints, kRadius);
  std::printf("%-9s %-12s %9s %12s %12s\n", "cloud", "method", "3s/R (%)", "median", "95 %");
  test::Random random(43);
  std::vector<Row> rows;
  for (std::size_t cloud = 0; cloud < kClouds.size(); ++cloud) {
    const Cloud& c = kClouds[cloud];
    for (int percent = 0; percent <= 10; ++percent) {
      std::array<std::vector<double>, kMethods.size()> errors;
      for (int trial = 0; trial < trials; ++trial) {
        Eigen::Matrix3Xd points = c.sphere ? test::sphere_cap(random, kPoints, kRadius, c.extent_rad)
                                           : test::cylinder_sector(random, kPoints, kRadius, kRadius, c.extent_rad);
        test::add_noise(random, points, percent / 300.0 * kRadius);
        const Eigen::Isometry3d X = test::random_motion(random, 100);
        points = test::moved(X, points);
        for (std::size_t method = 0; method < kMethods.size(); ++method) {
          const Frame frame = kMethods[method].frame(points);
          errors[method].push_back(c.sphere ? 100 * (frame.origin - X.translation()).norm() / kRadius
                                            : test::angle_deg(frame.axis, X.linear().col(2)));
        }
      }
      for (std::size_t method = 0; method < kMethods.size(); ++method) {
        rows.push_back({cloud, method, static_cast<double>(percent), quantile(errors[method], 0.5),
                        quantile(errors[method], 0.95)});
        std::printf("%-9s %-12s %9d %12.3g %12.3g\n", c.name, kMethods[method].name, percent, rows.back().median,
                    rows.back().p95);
      }
    }
  }
  std::FILE* csv = std::fopen((folder + "/frame_accuracy.csv").c_str(), "w");
  std::FILE* svg = std::fopen((folder + "/frame_accuracy.svg").c_str(), "w");
  if (!csv || !svg) {
    std::fprintf(stderr, "frame_accuracy: cannot write into %s; give a folder that exists\n", folder.c_str());
    return 2;
  }
  std::fprintf(csv, "cloud,method,noise_percent,median,p95\n");
  for (const Row& row : rows)
    std::fprintf(csv, "%s,%s,%g,%.4g,%.4g\n", kClouds[row.cloud].name, kMethods[row.method].name, row.noise_percent,
                 row.median, row.p95);
  write_svg(svg, rows);
  if (std::fclose(csv) != 0 || std::fclose(svg) != 0) {
    std::fprintf(stderr, "frame_accuracy: writing into %s failed; is there space left?\n", folder.c_str());
    return 4;
  }
  return 0;
}
