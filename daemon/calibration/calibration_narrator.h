#pragma once
// What a calibration sees, in sentences: the same at a terminal and in the API.

#include <string>

#include "daemon/calibration/calibration_guide.h"

namespace celadon {

class CalibrationNarrator : public CalibrationGuide {
 public:
  void on_look(const BoardLook& look) override;
  void on_turn(int placement, int angle, int angles, bool found) override;
  void on_passes(int placement, int frames) override;
  void on_stop(int placement, const AxisStop& stop, bool found) override;

 protected:
  /// Never the same sentence twice in a row.
  virtual void say(const std::string& sentence) = 0;
  /// Angles of the present turn that showed the board.
  int seen() const { return seen_; }

 private:
  void say_if_new(const std::string& sentence);
  std::string last_;
  int seen_ = 0;
};

}  // namespace celadon
