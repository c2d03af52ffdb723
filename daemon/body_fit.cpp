#include "daemon/body_fit.h"

#include <algorithm>

#include "fitting/own_frame.h"

namespace celadon {

std::span<const RangeFit> BodyFit::pieces() const {
  if (const auto* one = std::get_if<RangeFit>(&fit)) return {one, 1};
  return std::get<CompositeFit>(fit).pieces;
}

nlohmann::ordered_json BodyFit::report(const ResultNotes& notes) const {
  return std::visit([&](const auto& of) { return report_json(of, notes); }, fit);
}

const RangeFitReport& BodyFit::whole() const {
  return std::visit([](const auto& of) -> const RangeFitReport& { return of.report; }, fit);
}

const RangeFit* BodyFit::wall() const {
  const auto all = pieces();
  const auto found =
      std::find_if(all.begin(), all.end(), [](const RangeFit& piece) { return !piece.function.base().spherical(); });
  return found == all.end() ? nullptr : &*found;
}

bool BodyFit::wall_is_round() const {
  return wall() != nullptr && is_round(wall()->report.model);
}

std::optional<Eigen::Isometry3d> BodyFit::better_axis() const {
  return wall() == nullptr || wall_is_round() ? std::nullopt : axis_of_sections(wall()->function);
}

void place(RangeFit& fitted, const Eigen::Isometry3d& X_WL) {
  const RangeFunction& f = fitted.function;
  BaseSurface base = f.base();
  base.X_WB = X_WL * base.X_WB;
  fitted.function = RangeFunction(base, f.degree_u(), f.degree_v(), f.knots_u(), f.knots_v(), f.coefficients());
  fitted.surface = symbolic_product(fitted.function);
}

}  // namespace celadon
