#pragma once
// Whoever holds the board, as a calibration sees him.

#include <optional>
#include <string>

#include "acquisition/axis_stop.h"
#include "daemon/calibration/board_look.h"
#include "daemon/scan_state.h"
#include "firmware_bridge/scanner_device.h"

namespace celadon {

class CalibrationGuide {
 public:
  virtual ~CalibrationGuide() = default;
  /// Something has to be done by hand, now.
  virtual void ask(const std::string& instruction) = 0;
  /// It is done; asked again and again, a tenth of a second of the machine's clock apart. A press of the machine's own
  /// button says so, too.
  virtual bool done() = 0;
  /// The newest done() was said by somebody who may not stand at the machine: its lamp warns before anything moves.
  virtual bool done_from_afar() const { return false; }
  virtual void on_look(const BoardLook& look) = 0;
  /// The table turns with the board on it.
  virtual void on_turn(int placement, int angle, int angles, bool found) = 0;
  /// The table turned to and fro before the camera; in so many frames the board was found.
  virtual void on_passes(int placement, int frames) = 0;
  /// Head or lift moved, with the board on the platter.
  virtual void on_stop(int placement, const AxisStop& stop, bool found) = 0;
  /// preparing: the machine is about to move; scanning: views are taken; solving.
  virtual void on_state(ScanState) {}
  virtual void on_status(const DeviceStatus&) {}
  /// Why the calibration shall end now; nullopt: it goes on.
  virtual std::optional<std::string> cancelled() = 0;
};

}  // namespace celadon
