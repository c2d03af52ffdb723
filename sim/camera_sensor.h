#pragma once
// What a USB camera shows: one picture after the other, each in two steps, since a driver notes a frame's time when its
// first data come and gets its pixels later.

#include <cstdint>
#include <span>

namespace celadon::sim {

class CameraSensor {
 public:
  virtual ~CameraSensor() = default;
  virtual int width_px() const = 0;
  virtual int height_px() const = 0;
  virtual std::int64_t period_ns() const = 0;
  virtual std::int64_t longest_exposure_ns() const = 0;
  /// False: someone else has the camera.
  virtual bool start() = 0;
  virtual void stop() = 0;
  /// Whether the first data of the next picture are there now; that picture is then under way until end_picture().
  virtual bool begin_picture() = 0;
  struct Picture {
    std::span<const std::uint8_t> luma;  ///< row by row; empty until it is read out, short if bytes were lost
    bool corrupt = false;
    std::span<const std::uint8_t> chroma = {};  ///< U V for every two pixels of a row; empty: the picture is grey
  };
  /// Of the picture under way.
  virtual Picture picture() = 0;
  virtual void end_picture() = 0;
  virtual void set_exposure(std::int64_t exposure_ns) = 0;
};

}  // namespace celadon::sim
