#include "sim/shapes.h"

#include <cmath>
#include <numbers>

namespace celadon::sim {
namespace {

class Vase final : public Shape {
 public:
  RadiusAt radius(double /*cos_psi*/, double /*sin_psi*/, double z) const override {
    const double rise = std::exp((25 - z) / 18), fall = std::exp((z - 100) / 5);
    const double a = 1 / (1 + rise), b = 1 / (1 + fall);
    const double lip_at = (z - 121) / 5, foot_at = z / 8;
    constexpr double kNothing = 45;  // e^-45 vanishes beside the 13 mm of the body
    const double lip = lip_at * lip_at < kNothing ? 4 * std::exp(-lip_at * lip_at) : 0;
    const double foot = foot_at * foot_at < kNothing ? 5 * std::exp(-foot_at * foot_at) : 0;
    const double body = 26 * a * b;
    return {13 + body + lip + foot, 0,
            body * (rise * a / 18 - fall * b / 5) - lip * 2 * lip_at / 5 - foot * 2 * foot_at / 8};
  }
  double height_mm() const override { return 120; }
  double r_max_mm() const override { return 37.7; }
  double gradient_bound() const override { return 1.75; }  // |r_z| <= 1.42 near z = 100
  bool of_revolution() const override { return true; }
};

class Humidifier final : public Shape {
 public:
  RadiusAt radius(double c1, double s1, double z) const override {
    constexpr double kTurn = std::numbers::pi / 110;
    const double t = kTurn * z, s = std::sin(t), c = std::cos(t);
    const double lean = 0.6 * s, cos_lean = std::cos(lean), sin_lean = std::sin(lean);
    // Multiple angles by the addition theorems.
    const double c2 = c1 * c1 - s1 * s1, s2 = 2 * s1 * c1;
    const double c3 = c2 * c1 - s2 * s1, s3 = s2 * c1 + c2 * s1;
    const double c5 = c3 * c2 - s3 * s2, s5 = s3 * c2 + c3 * s2;
    const double cos_lobe = c3 * cos_lean - s3 * sin_lean, sin_lobe = s3 * cos_lean + c3 * sin_lean;
    const double cos_ripple = c5 * kCos1 - s5 * kSin1, sin_ripple = s5 * kCos1 + c5 * kSin1;
    const double cos_2t = c * c - s * s, sin_2t = 2 * s * c;
    return {33 + 4 * s + 2.4 * cos_lobe + 0.9 * s * cos_ripple + 0.5 * cos_2t * s2,
            -7.2 * sin_lobe - 4.5 * s * sin_ripple + cos_2t * c2,
            kTurn * (4 * c - 1.44 * c * sin_lobe + 0.9 * c * cos_ripple - sin_2t * s2)};
  }
  double height_mm() const override { return 110; }
  double r_max_mm() const override { return 40.9; }
  double gradient_bound() const override { return 1.15; }  // |r_psi| / r <= 12.7/29, |r_z| <= 0.22
  bool of_revolution() const override { return false; }

 private:
  static constexpr double kCos1 = 0.54030230586813971740, kSin1 = 0.84147098480789650665;
};

class Knob final : public Shape {
 public:
  RadiusAt radius(double c1, double s1, double z) const override {
    const double skirt = 1 / (1 + std::exp((z - 10) / 1.5)), grip = 1 / (1 + std::exp((14 - z) / 1.5));
    const double top = std::exp((z - 40) / 3);
    const double c2 = c1 * c1 - s1 * s1, s2 = 2 * s1 * c1;
    const double c6 = c2 * (c2 * c2 - 3 * s2 * s2), s6 = s2 * (3 * c2 * c2 - s2 * s2);  // Moivre
    return {16 + 8 * skirt - 6 * top + 0.8 * c6 * grip, -4.8 * s6 * grip,
            -8 * skirt * (1 - skirt) / 1.5 - 2 * top + 0.8 * c6 * grip * (1 - grip) / 1.5};
  }
  double height_mm() const override { return 40; }
  double r_max_mm() const override { return 24; }
  double gradient_bound() const override { return 2.4; }  // |r_z| <= 2, |r_psi| / r <= 4.8/9.2
  bool of_revolution() const override { return false; }
  bool shows_its_rim() const override { return true; }
};

class LobedShaft final : public Shape {
 public:
  RadiusAt radius(double c1, double s1, double /*z*/) const override {
    const double c2 = c1 * c1 - s1 * s1, s2 = 2 * s1 * c1;
    const double c3 = c2 * c1 - s2 * s1, s3 = s2 * c1 + c2 * s1;
    const double c5 = c3 * c2 - s3 * s2, s5 = s3 * c2 + c3 * s2;
    const double cos_lobe = c5 * kCos - s5 * kSin, sin_lobe = s5 * kCos + c5 * kSin;
    return {25 + 0.6 * c3 + 0.15 * cos_lobe, -1.8 * s3 - 0.75 * sin_lobe, 0};
  }
  double height_mm() const override { return 90; }
  double r_max_mm() const override { return 25.76; }
  double gradient_bound() const override { return 1.01; }  // |r_psi| / r <= 2.55/24.2
  bool of_revolution() const override { return false; }
  bool shows_its_rim() const override { return true; }

 private:
  static constexpr double kCos = 0.92106099400288508280, kSin = 0.38941834230865049167;  // of 0.4
};

class Cylinder final : public Shape {
 public:
  Cylinder(double radius_mm, double height_mm) : radius_(radius_mm), height_(height_mm) {}
  RadiusAt radius(double /*cos_psi*/, double /*sin_psi*/, double /*z*/) const override { return {radius_, 0, 0}; }
  double height_mm() const override { return height_; }
  double r_max_mm() const override { return radius_ * (1 + 1e-9); }
  double gradient_bound() const override { return 1; }
  bool of_revolution() const override { return true; }

 private:
  double radius_, height_;
};

}  // namespace

std::shared_ptr<const Shape> make_vase() {
  return std::make_shared<Vase>();
}
std::shared_ptr<const Shape> make_humidifier() {
  return std::make_shared<Humidifier>();
}
std::shared_ptr<const Shape> make_knob() {
  return std::make_shared<Knob>();
}
std::shared_ptr<const Shape> make_lobed_shaft() {
  return std::make_shared<LobedShaft>();
}
std::shared_ptr<const Shape> make_cylinder(double radius_mm, double height_mm) {
  return std::make_shared<Cylinder>(radius_mm, height_mm);
}

}  // namespace celadon::sim
