#pragma once
#include <string>

namespace celadon {

/// A device fault: operation, device, cause, and what state the machine was left in; message() is one sentence.
struct DeviceError {
  enum class Kind {
    not_found,
    refused,
    timed_out,
    broken_reply,
    wrong_protocol,
    wrong_state,
    fault,
    interlock,
    lost,
    interrupted,
    system
  };
  Kind kind = Kind::system;
  std::string operation;  ///< "home", "rotate to 90.000 deg"
  std::string device;     ///< the URL
  std::string cause;      ///< with errno, exception or fault code
  std::string left;  ///< "laser off, motor stopped", "unknown: the link is down; the controller's lease turns the laser
                     ///< off within 500 ms"
  std::string remedy;
  std::string message() const {
    return operation + " on " + device + " failed: " + cause + "; the machine was left with " + left +
           (remedy.empty() ? "." : "; " + remedy + ".");
  }
};

}  // namespace celadon
