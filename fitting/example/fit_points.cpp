// Points on standard input, "x y z" a line in millimetres; the exact NURBS surface on standard output: degrees, knots
// and homogeneous control points. The part may lie anywhere.

#include <cstdio>
#include <iostream>
#include <vector>

#include "fitting/local_frame.h"
#include "fitting/point_stream.h"
#include "fitting/range_fit.h"

namespace {

int fail(const std::string& why) {
  std::fprintf(stderr, "fit_points: %s\n", why.c_str());
  return 2;
}

void print(const char* name, const std::vector<double>& knots) {
  std::printf("%s", name);
  for (const double knot : knots) std::printf(" %.17g", knot);
  std::printf("\n");
}

}  // namespace

int main() {
  std::vector<Eigen::Vector3d> read;
  for (Eigen::Vector3d p; std::cin >> p.x() >> p.y() >> p.z();) read.push_back(p);
  if (read.empty()) return fail("no points on standard input; give lines of x y z");
  const Eigen::Matrix3Xd points = Eigen::Map<const Eigen::Matrix3Xd>(read.front().data(), 3, std::ssize(read));

  // The part's own axis, then the points about it.
  const auto frame = celadon::local_frame(points);
  if (!frame) return fail(frame.error().message);
  celadon::PointStream samples(frame->X_SL.inverse() * points);
  const auto fit = celadon::fit_samples(samples);
  if (!fit) return fail(fit.error().message);

  std::fprintf(stderr, "%s, noise %.3g mm, rms %.3g mm: %s\n", celadon::to_string(fit->report.model),
               fit->report.noise_mm, fit->report.geometric_mm.rms, fit->report.decided_by.c_str());
  const celadon::NurbsSurface& surface = fit->surface;  // in the part's frame
  std::printf("degree %d %d\n", surface.degree_u, surface.degree_v);
  print("knots_u", surface.knots_u);
  print("knots_v", surface.knots_v);
  for (Eigen::Index k = 0; k < surface.control_points.cols(); ++k) {
    const Eigen::Vector4d p = surface.control_points.col(k);
    const Eigen::Vector3d at = frame->X_SL * (p.head<3>() / p.w());
    std::printf("%.17g %.17g %.17g %.17g\n", at.x(), at.y(), at.z(), p.w());
  }
  return 0;
}
