// Grammar: REPLAY.md.
#include "acquisition/recording.h"

#include <fcntl.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string_view>

#include "acquisition/camera_fault.h"
#include "acquisition/file_descriptor.h"

namespace celadon {
namespace {

constexpr std::string_view kFirstLine = "celadon-recording,";
constexpr std::string_view kColumns = "file,table_angle_deg,stamp_ns,exposure_ns,laser";
constexpr std::size_t kMostFrames = 10'000'000;
constexpr double kRadPerDeg = std::numbers::pi / 180;
constexpr std::array<std::string_view, 4> kUses{"background", "look", "turn", "overlap"};
constexpr std::size_t kFields_1_0 = 5, kFields_1_1 = 9, kFields_1_2 = 10, kFields_1_3 = 12;
constexpr unsigned kMinor = 4;  // the newest that is known
constexpr int kMostLaser = 255;

struct Refusal {
  std::string message;
};

template <class T>
std::optional<T> number_of(std::string_view text) {
  T value{};
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (fault != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::vector<std::string_view> fields_of(std::string_view line) {
  std::vector<std::string_view> fields;
  for (;;) {
    const std::size_t comma = line.find(',');
    fields.push_back(line.substr(0, comma));
    if (comma == std::string_view::npos) return fields;
    line.remove_prefix(comma + 1);
  }
}

std::string quote(std::string_view text) {
  std::string out(1, '"');
  out.append(text.substr(0, 60));
  return out.append(text.size() > 60 ? "...\"" : "\"");
}

/// Walks the lines of an index.
class IndexReader {
 public:
  IndexReader(std::string_view text, std::string name) : rest_(text), name_(std::move(name)) {}

  RecordingIndex read() {
    read_version();
    read_settings();
    for (std::string_view line; next(line);) read_frame(line);
    if (index_.frames.empty()) refuse("no frame follows the columns", "record again");
    return std::move(index_);
  }

 private:
  [[noreturn]] void refuse(const std::string& what, const std::string& remedy) const {
    throw Refusal{name_ + ", line " + std::to_string(line_) + ": " + what + "; " + remedy + "."};
  }

  bool next(std::string_view& line) {
    while (!rest_.empty()) {
      const std::size_t end = rest_.find('\n');
      line = rest_.substr(0, end);
      rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
      ++line_;
      if (line.ends_with('\r')) line.remove_suffix(1);
      if (!line.empty() && line.front() != '#') return true;
    }
    return false;
  }

  void read_version() {
    std::string_view line;
    if (!next(line) || !line.starts_with(kFirstLine)) {
      refuse("the first line is " + quote(line) + " and must be \"celadon-recording,1.0\"",
             "give the folder of a recording");
    }
    const std::string_view version = line.substr(kFirstLine.size());
    const std::size_t dot = version.find('.');
    const auto major = number_of<unsigned>(version.substr(0, dot));
    const auto minor = dot == std::string_view::npos ? std::nullopt : number_of<unsigned>(version.substr(dot + 1));
    if (!major || !minor) refuse("the version " + quote(version) + " must read MAJOR.MINOR", "record again");
    if (*major != 1) refuse("version " + quote(version) + " is not 1", "update Celadon or record again");
    minor_ = *minor;
  }

  void read_settings() {
    for (std::string_view line; next(line);) {
      if (line == kColumns) {
        if (index_.camera.empty()) refuse("the setting camera is missing", "add a line \"camera,NAME\"");
        return;
      }
      read_setting(line);
    }
    refuse("the line of columns \"" + std::string(kColumns) + "\" is missing", "add it");
  }

  void read_setting(std::string_view line) {
    const std::size_t comma = line.find(',');
    const std::string_view key = line.substr(0, comma);
    const std::string_view value = comma == std::string_view::npos ? std::string_view{} : line.substr(comma + 1);
    const auto choose = [&](std::initializer_list<std::string_view> choices) {
      const auto* const found = std::find(choices.begin(), choices.end(), value);
      if (found != choices.end()) return static_cast<int>(found - choices.begin());
      std::string list;
      for (const std::string_view choice : choices) list += (list.empty() ? "" : ", ") + std::string(choice);
      refuse("the setting " + quote(key) + " is " + quote(value) + " and must be one of " + list, "correct it");
    };
    if (key == "camera" && !value.empty()) {
      index_.camera = value;
    } else if (key == "date" && !value.empty() && minor_ >= 1) {
      index_.scan.date = value;
    } else if (key == "mode" && minor_ >= 1) {
      index_.scan.mode = choose({"step", "sweep"}) == 0 ? "step" : "sweep";
    } else if (key == "profiles" && minor_ >= 1) {
      const auto profiles = number_of<int>(value);
      if (!profiles || *profiles < 1) refuse("profiles is " + quote(value) + " and must be 1 or more", "correct it");
      index_.scan.profiles = *profiles;
    } else if (key == "saturated_level" && minor_ >= 1) {
      const auto level = number_of<int>(value);
      if (!level || *level < 1 || *level > 255) {
        refuse("saturated_level is " + quote(value) + " and must be 1 to 255", "correct it");
      }
      index_.saturated_level = *level;
    } else if (key == "simulated") {
      index_.simulated = choose({"0", "1"}) == 1;
    } else if (key == "shutter") {
      index_.shutter = choose({"global", "rolling"}) == 1 ? Shutter::rolling : Shutter::global;
    } else if (key == "colour") {
      index_.colour = static_cast<ColourChannel>(choose({"red", "green", "luma"}));
    } else if (key == "yuyv_size") {
      const auto size = fields_of(value);
      const auto width = number_of<int>(size.front()), height = number_of<int>(size.back());
      if (size.size() != 2 || !width || !height || *width < 2 || *width % 2 != 0 || *height < 1 || *width > 65535 ||
          *height > 65535) {
        refuse("yuyv_size is " + quote(value) + " and must be an even width and a height up to 65535",
               "write it as \"yuyv_size,1280,1024\"");
      }
      index_.yuyv_width_px = *width;
      index_.yuyv_height_px = *height;
    } else if (key == "yuv" && minor_ >= 4) {
      const int which = choose({"601,full", "601,limited", "709,full", "709,limited"});
      index_.yuv =
          ColourCoding{ColourLayout::yuyv, 0, which < 2 ? LumaWeights::bt601 : LumaWeights::bt709, which % 2 == 1};
    } else if (minor_ <= kMinor) {
      refuse("the setting " + quote(line) + " is unknown or empty",
             "correct it, or put the columns \"" + std::string(kColumns) + "\" before the frames");
    }
  }

  void read_frame(std::string_view line) {
    const auto fields = fields_of(line);
    const bool known = fields.size() == kFields_1_0 || (fields.size() == kFields_1_1 && minor_ >= 1) ||
                       (fields.size() == kFields_1_2 && minor_ >= 2) || (fields.size() == kFields_1_3 && minor_ >= 3);
    if (!known && !(minor_ > kMinor && fields.size() > kFields_1_3)) {
      refuse("there are " + std::to_string(fields.size()) + " fields and must be 5" +
                 (minor_ >= 3   ? ", 9, 10 or 12"
                  : minor_ == 2 ? ", 9 or 10"
                  : minor_ == 1 ? " or 9"
                                : ""),
             "correct or remove the line");
    }
    if (index_.frames.size() == kMostFrames) refuse("there are over 10000000 frames", "cut the recording into parts");
    RecordedFrame frame;
    frame.line = line_;
    frame.file = fields[0];
    const std::filesystem::path path(frame.file);
    const bool leaves =
        path.is_absolute() || std::any_of(path.begin(), path.end(), [](const auto& part) { return part == ".."; });
    const bool yuyv = frame.file.ends_with(".yuyv");
    if (leaves || !(yuyv || frame.file.ends_with(".pgm") || frame.file.ends_with(".png"))) {
      refuse("the file " + quote(frame.file) + " must be a .pgm, .png or .yuyv inside the folder", "correct the name");
    }
    if (yuyv && index_.yuyv_width_px == 0) {
      refuse("the setting yuyv_size is missing", "add a line \"yuyv_size,WIDTH,HEIGHT\" before the columns");
    }
    if (!index_.frames.empty() && yuyv != index_.frames.front().file.ends_with(".yuyv")) {
      refuse("the frames mix YUYV and grey files", "cut the recording into parts");
    }
    const auto angle = number_of<double>(fields[1]);
    if (!angle || !std::isfinite(*angle)) {
      refuse("the angle " + quote(fields[1]) + " must be a finite number of degrees", "correct the line");
    }
    const auto stamp = number_of<std::int64_t>(fields[2]), exposure = number_of<std::int64_t>(fields[3]);
    if (!stamp || (!index_.frames.empty() && *stamp <= index_.frames.back().stamp_ns)) {
      refuse("the stamp " + quote(fields[2]) + " must be a whole number of ns above the frame's before",
             "sort the lines by stamp");
    }
    if (!exposure || *exposure < 0) {
      refuse("the exposure " + quote(fields[3]) + " must be a whole number of ns, 0 or more", "correct the line");
    }
    if (fields[4] != "0" && fields[4] != "1") {
      refuse("the laser is " + quote(fields[4]) + " and must be 0 or 1", "correct the line");
    }
    frame.table_angle_rad = *angle * kRadPerDeg;
    frame.stamp_ns = *stamp;
    frame.exposure_ns = *exposure;
    frame.use = fields[4] == "1" ? FrameUse::turn : FrameUse::background;
    if (fields.size() >= kFields_1_1) read_use(fields, frame);
    if (fields.size() >= kFields_1_2) read_laser(fields[kFields_1_2 - 1], frame);
    if (fields.size() >= kFields_1_3) read_stop(fields, frame);
    auto& stops = index_.scan.stops;
    if (frame.use == FrameUse::turn && std::find(stops.begin(), stops.end(), frame.stop) == stops.end()) {
      stops.push_back(frame.stop);
    }
    index_.frames.push_back(std::move(frame));
  }

  void read_use(const std::vector<std::string_view>& fields, RecordedFrame& frame) const {
    const auto* const use = std::find(kUses.begin(), kUses.end(), fields[5]);
    if (use == kUses.end() || (use == kUses.begin()) != (fields[4] == "0")) {
      refuse("the use " + quote(fields[5]) + " must be background with the laser 0, or look, turn or overlap with 1",
             "correct the line");
    }
    frame.use = static_cast<FrameUse>(use - kUses.begin());
    const auto rad = number_of<double>(fields[6]), sigma = number_of<double>(fields[7]),
               speed = number_of<double>(fields[8]);
    if (!rad || !sigma || !speed || !std::isfinite(*rad) || !(*sigma >= 0) || !std::isfinite(*sigma) ||
        !std::isfinite(*speed) || std::abs(*rad - frame.table_angle_rad) > 1e-9 * (1 + std::abs(*rad))) {
      refuse("the angle in radians, its uncertainty and the speed, " + quote(fields[6]) + ", " + quote(fields[7]) +
                 ", " + quote(fields[8]) + ", must be finite numbers, the first that of table_angle_deg",
             "correct the line");
    }
    frame.table_angle_rad = *rad;
    frame.table_angle_sigma_rad = *sigma;
    frame.table_speed_rad_per_s = *speed;
  }

  void read_laser(std::string_view field, RecordedFrame& frame) {
    const auto laser = number_of<int>(field);
    if (!laser || *laser < 0 || *laser > kMostLaser) {
      refuse("the number of the laser " + quote(field) + " must be 0 to " + std::to_string(kMostLaser),
             "correct the line");
    }
    frame.laser = *laser;
    auto& lasers = index_.scan.lasers;
    if (frame.use == FrameUse::turn && std::find(lasers.begin(), lasers.end(), *laser) == lasers.end()) {
      lasers.push_back(*laser);
    }
  }

  void read_stop(const std::vector<std::string_view>& fields, RecordedFrame& frame) const {
    const auto elevation = number_of<double>(fields[kFields_1_2]), lift = number_of<double>(fields[kFields_1_2 + 1]);
    if (!elevation || !lift || !std::isfinite(*elevation) || !std::isfinite(*lift)) {
      refuse("the elevation and the lift, " + quote(fields[kFields_1_2]) + ", " + quote(fields[kFields_1_2 + 1]) +
                 ", must be finite numbers of radians and mm",
             "correct the line");
    }
    frame.stop = {*elevation, *lift};
  }

  std::string_view rest_;
  std::string name_;
  int line_ = 0;
  unsigned minor_ = 0;
  RecordingIndex index_;
};

/// The shortest text that gives the same number.
std::string number_text(double value) {
  std::array<char, 32> buffer;
  return {buffer.data(), std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr};
}

}  // namespace

tl::expected<RecordingIndex, std::string> parse_recording_index(const std::string& text, const std::string& name) {
  try {
    return IndexReader(text, name).read();
  } catch (const Refusal& refusal) {
    return tl::unexpected(refusal.message);
  }
}

std::string format_recording_index(const RecordingIndex& index) {
  static constexpr std::array<const char*, 3> kColours{"red", "green", "luma"};
  std::string out = std::string(kFirstLine) + (index.yuv ? "1.4" : "1.3") + "\ncamera," + index.camera +
                    "\nsimulated," + (index.simulated ? "1" : "0") + "\nshutter," +
                    (index.shutter == Shutter::rolling ? "rolling" : "global") + "\ncolour," +
                    kColours.at(static_cast<std::size_t>(index.colour)) + "\n";
  if (index.yuyv_width_px != 0) {
    out += "yuyv_size," + std::to_string(index.yuyv_width_px) + "," + std::to_string(index.yuyv_height_px) + "\n";
  }
  if (index.yuv) {
    out += std::string("yuv,") + (index.yuv->weights == LumaWeights::bt601 ? "601" : "709") +
           (index.yuv->limited_range ? ",limited\n" : ",full\n");
  }
  if (index.saturated_level != 0) out += "saturated_level," + std::to_string(index.saturated_level) + "\n";
  if (!index.scan.date.empty()) out += "date," + index.scan.date + "\n";
  if (!index.scan.mode.empty()) out += "mode," + index.scan.mode + "\n";
  if (index.scan.profiles > 0) out += "profiles," + std::to_string(index.scan.profiles) + "\n";
  out += std::string(kColumns) + "\n";
  for (const RecordedFrame& frame : index.frames) {
    out += frame.file + "," + number_text(frame.table_angle_rad / kRadPerDeg) + "," + std::to_string(frame.stamp_ns) +
           "," + std::to_string(frame.exposure_ns) + (frame.use == FrameUse::background ? ",0," : ",1,") +
           std::string(kUses.at(static_cast<std::size_t>(frame.use))) + "," + number_text(frame.table_angle_rad) + "," +
           number_text(frame.table_angle_sigma_rad) + "," + number_text(frame.table_speed_rad_per_s) + "," +
           std::to_string(frame.laser) + "," + number_text(frame.stop.elevation_rad) + "," +
           number_text(frame.stop.lift_mm) + "\n";
  }
  return out;
}

RecordingWriter::RecordingWriter(std::filesystem::path folder, const CameraMode& mode, const RecordedScan& scan)
    : folder_(std::move(folder)), mode_(mode) {
  if (mode.identity.empty() || mode.identity.find_first_of("\r\n") != std::string::npos) {
    throw std::invalid_argument("RecordingWriter: the camera's identity must be one line of text");
  }
  index_.camera = mode.identity;
  index_.scan = scan;
  index_.simulated = mode.simulated;
  index_.shutter = mode.shutter;
  index_.saturated_level = mode.saturated_level;
  if (mode.format == PixelFormat::yuyv) {
    index_.yuyv_width_px = mode.width_px;
    index_.yuyv_height_px = mode.height_px;
    if (mode.colour.layout == ColourLayout::yuyv) index_.yuv = mode.colour;
  }
}

tl::expected<void, CameraError> RecordingWriter::append(const Frame& frame, const AngleAtInstant& angle, FrameUse use,
                                                        int laser, const AxisStop& stop) {
  const auto height = static_cast<std::size_t>(mode_.height_px);
  if (!std::isfinite(angle.angle_rad) || frame.bytes().size() < mode_.stride_bytes * height ||
      (!index_.frames.empty() && frame.info.stamp_ns <= index_.frames.back().stamp_ns)) {
    throw std::invalid_argument(
        "RecordingWriter::append: a frame of another mode, a stamp that does not rise, or no angle");
  }
  const bool yuyv = mode_.format == PixelFormat::yuyv;
  std::array<char, 32> name;
  std::snprintf(name.data(), name.size(), "frame-%07zu.%s", index_.frames.size(), yuyv ? "yuyv" : "pgm");
  const std::filesystem::path file = folder_ / name.data();
  if (!yuyv) {
    if (auto written = write_pgm(file, mode_.width_px, mode_.height_px, mode_.stride_bytes, frame.bytes()); !written) {
      return tl::unexpected(
          CameraError{CameraError::Kind::system, written.error().errno_value, written.error().message});
    }
  } else {
    const std::size_t row_bytes = static_cast<std::size_t>(mode_.width_px) * 2;
    std::FILE* stream = std::fopen(file.c_str(), "wb");
    bool good = stream != nullptr;
    for (std::size_t row = 0; row < height && good; ++row) {
      good = std::fwrite(frame.bytes().data() + row * mode_.stride_bytes, 1, row_bytes, stream) == row_bytes;
    }
    if (stream != nullptr && std::fclose(stream) != 0) good = false;
    if (!good) {
      return tl::unexpected(camera_fault(CameraError::Kind::system, "recording " + file.string(), "writing", errno,
                                         "free some space or choose another folder"));
    }
  }
  index_.frames.push_back({.file = name.data(),
                           .table_angle_rad = angle.angle_rad,
                           .table_angle_sigma_rad = angle.sigma_rad,
                           .table_speed_rad_per_s = angle.speed_rad_per_s,
                           .stamp_ns = frame.info.stamp_ns,
                           .exposure_ns = frame.info.exposure_ns,
                           .use = use,
                           .laser = laser,
                           .stop = stop});
  return {};
}

tl::expected<void, CameraError> RecordingWriter::finish() {
  const std::filesystem::path target = folder_ / "index.csv", beside = folder_ / "index.csv.part";
  const std::string text = format_recording_index(index_);
  const auto fail = [&](const char* operation) {
    const int code = errno;
    ::unlink(beside.c_str());
    return tl::unexpected(camera_fault(CameraError::Kind::system, "recording " + target.string(), operation, code,
                                       "free some space or choose another folder"));
  };
  const FileDescriptor file(::open(beside.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (!file) return fail("creating the index");
  for (std::size_t at = 0; at < text.size();) {
    const ssize_t count = ::write(file.get(), text.data() + at, text.size() - at);
    if (count < 0 && errno != EINTR) return fail("writing the index");
    at += static_cast<std::size_t>(std::max<ssize_t>(count, 0));
  }
  if (::fsync(file.get()) != 0) return fail("writing the index to the disk");
  if (::rename(beside.c_str(), target.c_str()) != 0) return fail("naming the index");
  return {};
}

}  // namespace celadon
