#include "daemon/profile_log.h"

#include <cstring>
#include <limits>

#include <nlohmann/json.hpp>

#include "firmware_bridge/clock.h"

namespace celadon {
namespace {

enum RecordType : std::uint16_t {
  kHeader = 1,
  kPose = 2,
  kProfile = 3,
  kOverlapProfile = 4,
  kPosition = 5,
  kFrame = 6,
  kEnd = 7,
  kStop = 8
};

constexpr std::uint32_t kHasCovariance = 1, kHasRow = 2;
constexpr std::uint16_t kMinor = 2, kMinorOfColours = 3;  ///< versions of the grammar that are written
constexpr std::uint32_t kProfilesPerMark = 16;
constexpr std::int64_t kSyncInterval_ns = 1'000'000'000;
static_assert(sizeof(SampleCovariance) == 6 * sizeof(float) && sizeof(SampleColour) == 3);

/// Appends numbers to a payload in file order.
class Put {
 public:
  explicit Put(std::vector<std::uint8_t>& out) : out_(out) { out_.clear(); }
  template <class T>
  Put& operator()(T value) {
    return array(&value, 1);
  }
  template <class T>
  Put& array(const T* values, std::size_t n) {
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(values);
    out_.insert(out_.end(), bytes, bytes + n * sizeof(T));
    return *this;
  }

 private:
  std::vector<std::uint8_t>& out_;
};

/// Takes numbers from a payload; good() turns false when it ends too early.
class Take {
 public:
  explicit Take(std::span<const std::uint8_t> in) : in_(in) {}
  template <class T>
  T get() {
    T value{};
    array(&value, 1);
    return value;
  }
  template <class T>
  void array(T* values, std::size_t n) {
    if (!good_ || n > in_.size() / sizeof(T)) {
      good_ = false;
      return;
    }
    if (n > 0) std::memcpy(values, in_.data(), n * sizeof(T));
    in_ = in_.subspan(n * sizeof(T));
  }
  std::string rest() {
    std::string text(reinterpret_cast<const char*>(in_.data()), in_.size());
    in_ = {};
    return text;
  }
  std::size_t left() const { return in_.size(); }
  bool good() const { return good_; }

 private:
  std::span<const std::uint8_t> in_;
  bool good_ = true;
};

void put_profile(std::vector<std::uint8_t>& out, const Profile& p, bool with_colour) {
  const std::uint32_t fields = (p.covariance.empty() ? 0 : kHasCovariance) | (p.row.empty() ? 0 : kHasRow);
  Put put(out);
  put(p.index)(p.pose)(p.laser)(static_cast<std::uint8_t>(p.order))(p.lift_mm)(p.table_angle_rad)(p.time_ns);
  put(static_cast<std::uint32_t>(p.size()))(fields);
  put.array(p.r_mm.data(), p.size()).array(p.theta_rad.data(), p.size()).array(p.z_mm.data(), p.size());
  put.array(p.covariance.data(), p.covariance.size()).array(p.row.data(), p.row.size());
  if (!with_colour) return;
  const std::vector<SampleColour> unknown(p.colour.empty() ? p.size() : 0);
  put.array(p.colour.data(), p.colour.size()).array(unknown.data(), unknown.size());
}

bool take_profile(std::span<const std::uint8_t> payload, bool with_colour, Profile& p) {
  Take take(payload);
  p.index = take.get<std::uint32_t>();
  p.pose = take.get<std::uint16_t>();
  p.laser = take.get<std::uint8_t>();
  const auto order = take.get<std::uint8_t>();
  p.lift_mm = take.get<double>();
  p.table_angle_rad = take.get<double>();
  p.time_ns = take.get<std::int64_t>();
  const std::size_t n = take.get<std::uint32_t>();
  const auto fields = take.get<std::uint32_t>();
  if (!take.good() || order > 1 || (fields & ~(kHasCovariance | kHasRow)) != 0) return false;
  if (n > take.left() / (3 * sizeof(double))) return false;  // before memory is asked for
  p.order = static_cast<ProfileOrder>(order);
  p.r_mm.resize(n);
  p.theta_rad.resize(n);
  p.z_mm.resize(n);
  p.covariance.resize((fields & kHasCovariance) != 0 ? n : 0);
  p.row.resize((fields & kHasRow) != 0 ? n : 0);
  take.array(p.r_mm.data(), n);
  take.array(p.theta_rad.data(), n);
  take.array(p.z_mm.data(), n);
  take.array(p.covariance.data(), p.covariance.size());
  take.array(p.row.data(), p.row.size());
  p.colour.resize(with_colour ? n : 0);
  take.array(p.colour.data(), p.colour.size());
  return take.good();
}

std::string header_text(const LogHeader& header) {
  ScanRecord record;
  record.request = header.request;
  nlohmann::json text{{"writer", "celadond 0.1.0"},        {"date", header.date},
                      {"machine", header.machine},         {"camera", header.camera},
                      {"simulated", header.simulated},     {"request", to_json(record)["request"]},
                      {"calibration", header.calibration}, {"lasers", header.lasers}};
  if (header.colour) text["colour"] = true;
  return text.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

bool take_header(std::span<const std::uint8_t> payload, LogHeader& header) {
  try {
    const auto json = nlohmann::json::parse(payload.begin(), payload.end());
    header.date = json.at("date").get<std::string>();
    header.machine = json.at("machine").get<std::string>();
    header.camera = json.at("camera").get<std::string>();
    header.simulated = json.at("simulated").get<bool>();
    header.calibration = json.at("calibration").get<std::string>();
    header.lasers = json.value("lasers", std::vector<int>());  // since 1.1
    header.colour = json.value("colour", false);               // since 1.3
    auto request = scan_request_from_json(json.at("request"));
    if (!request) return false;
    header.request = *request;
    return true;
  } catch (const nlohmann::json::exception&) {
    return false;
  }
}

LogPose take_pose(Take& take) {
  LogPose pose;
  pose.pose = take.get<std::uint16_t>();
  take.get<std::uint16_t>();
  take.get<std::uint32_t>();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 4; ++j) pose.X_SP.matrix()(i, j) = take.get<double>();
  }
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) pose.covariance(i, j) = pose.covariance(j, i) = take.get<double>();
  }
  return pose;
}

PositionSample take_position(Take& take) {
  PositionSample s;
  s.counter = take.get<std::uint32_t>();
  take.get<std::uint32_t>();
  s.device_time_us = take.get<std::uint64_t>();
  s.angle_rad = take.get<double>();
  s.host_before_ns = take.get<std::int64_t>();
  s.host_after_ns = take.get<std::int64_t>();
  return s;
}

LogFrame take_frame(Take& take) {
  LogFrame f;
  f.sequence = take.get<std::uint64_t>();
  f.stamp_ns = take.get<std::int64_t>();
  f.exposure_ns = take.get<std::int64_t>();
  f.lost_before = take.get<std::uint32_t>();
  f.verdict = static_cast<FrameVerdict>(take.get<std::uint16_t>());
  return f;
}

LogStop take_stop(Take& take) {
  const auto elevation_rad = take.get<double>();
  return {{elevation_rad, take.get<double>()}};
}

LogEnd take_end(Take& take) {
  LogEnd e;
  e.outcome = static_cast<LogOutcome>(take.get<std::uint16_t>());
  take.get<std::uint16_t>();
  e.profiles = take.get<std::uint32_t>();
  e.samples = take.get<std::uint64_t>();
  e.frames = take.get<std::uint64_t>();
  e.lost = take.get<std::uint64_t>();
  e.stale = take.get<std::uint64_t>();
  e.corrupt = take.get<std::uint64_t>();
  if (take.good()) e.reason = take.rest();
  return e;
}

}  // namespace

// --- writer ---

tl::expected<std::unique_ptr<ProfileLogWriter>, LogError> ProfileLogWriter::create(const std::filesystem::path& file,
                                                                                   const LogHeader& header) {
  auto records = RecordWriter::create(file, header.colour ? kMinorOfColours : kMinor);
  if (!records) return tl::make_unexpected(records.error());
  std::unique_ptr<ProfileLogWriter> log(new ProfileLogWriter(std::move(*records)));
  log->colour_ = header.colour;
  const std::string text = header_text(header);
  log->records_->put(kHeader, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
  if (auto written = log->append(LogPose{}); !written) return tl::make_unexpected(written.error());
  return log;
}

tl::expected<void, LogError> ProfileLogWriter::append(const LogPose& pose) {
  Put put(payload_);
  put(pose.pose)(std::uint16_t{0})(std::uint32_t{0});
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 4; ++j) put(pose.X_SP.matrix()(i, j));
  }
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) put(pose.covariance(i, j));
  }
  records_->put(kPose, payload_);
  return records_->flush();
}

tl::expected<void, LogError> ProfileLogWriter::append(const Profile& profile, bool overlap) {
  put_profile(payload_, profile, colour_);
  if (!overlap && counts_.profiles % kProfilesPerMark == 0) marks_.push_back(records_->mark());
  records_->put(overlap ? kOverlapProfile : kProfile, payload_);
  if (auto written = records_->flush(); !written) return written;
  if (!overlap) {
    ++counts_.profiles;
    counts_.samples += profile.size();
  }
  // The real clock: the disk knows no simulated time.
  const std::int64_t now_ns = MonotonicClock().now_ns();
  if (now_ns - last_sync_ns_ > kSyncInterval_ns) {
    last_sync_ns_ = now_ns;
    records_->start_sync();
  }
  return {};
}

void ProfileLogWriter::append(const PositionSample& s) {
  Put put(payload_);
  put(s.counter)(std::uint32_t{0})(s.device_time_us)(s.angle_rad)(s.host_before_ns)(s.host_after_ns);
  records_->put(kPosition, payload_);
}

void ProfileLogWriter::append(const LogFrame& f) {
  ++counts_.frames;
  counts_.lost += f.lost_before;
  if (f.verdict == FrameVerdict::stale) ++counts_.stale;
  if (f.verdict == FrameVerdict::corrupt) ++counts_.corrupt;
  Put put(payload_);
  put(f.sequence)(f.stamp_ns)(f.exposure_ns)(f.lost_before)(static_cast<std::uint16_t>(f.verdict))(std::uint16_t{0});
  records_->put(kFrame, payload_);
}

void ProfileLogWriter::append(const LogStop& s) {
  if (s.stop == stop_) return;
  stop_ = s.stop;
  Put put(payload_);
  put(stop_.elevation_rad)(stop_.lift_mm);
  records_->put(kStop, payload_);
}

tl::expected<void, LogError> ProfileLogWriter::finish(LogOutcome outcome, const std::string& reason) {
  Put put(payload_);
  put(static_cast<std::uint16_t>(outcome))(std::uint16_t{0})(counts_.profiles)(counts_.samples)(counts_.frames);
  put(counts_.lost)(counts_.stale)(counts_.corrupt).array(reason.data(), reason.size());
  records_->put(kEnd, payload_);
  auto written = records_->flush();
  records_->start_sync();
  return written;
}

std::vector<RecordMark> ProfileLogWriter::divide(int parts) const {
  std::vector<RecordMark> edges;
  edges.reserve(static_cast<std::size_t>(parts) + 1);
  for (int k = 0; k < parts; ++k) {
    edges.push_back(marks_.empty()
                        ? records_->mark()
                        : marks_[marks_.size() * static_cast<std::size_t>(k) / static_cast<std::size_t>(parts)]);
  }
  edges.push_back(records_->mark());
  return edges;
}

// --- reader ---

tl::expected<std::unique_ptr<ProfileLogReader>, LogError> ProfileLogReader::open(const std::filesystem::path& file) {
  auto records = RecordReader::open(file);
  if (!records) return tl::make_unexpected(records.error());
  std::unique_ptr<ProfileLogReader> log(new ProfileLogReader(std::move(*records)));
  Record record;
  if (!log->records_->next(record) || record.type != kHeader || !take_header(record.payload, log->header_)) {
    std::string why = log->records_->error();
    if (why.empty()) {
      why = "The profile log " + file.string() +
            " has no readable header record at offset 16; it was never begun or was damaged there.";
    }
    return tl::make_unexpected(LogError{0, why});
  }
  return log;
}

tl::expected<std::unique_ptr<ProfileLogReader>, LogError> ProfileLogReader::open(const std::filesystem::path& file,
                                                                                 const RecordMark& begin,
                                                                                 const RecordMark& end) {
  auto log = open(file);
  if (log) (*log)->records_->confine(begin, end);
  return log;
}

void ProfileLogReader::rewind() {
  records_->rewind();
  error_.clear();
}

const std::string& ProfileLogReader::error() const {
  return error_.empty() ? records_->error() : error_;
}

bool ProfileLogReader::broken(const Record& record, const char* what) {
  error_ = "The profile log " + records_->file().string() + " holds " + what + " at offset " +
           std::to_string(record.offset) +
           " that does not follow version 1 of its grammar; use the program that wrote it.";
  return false;
}

const Profile* ProfileLogReader::next() {
  Record record;
  while (error_.empty() && records_->next(record)) {
    if (record.type == kProfile) {
      if (take_profile(record.payload, header_.colour, profile_)) return &profile_;
      broken(record, "a profile");
    } else if (record.type == kEnd) {
      Take take(record.payload);
      end_ = take_end(take);
    }
  }
  return nullptr;
}

std::optional<LogEntry> ProfileLogReader::next_entry() {
  Record record;
  while (error_.empty() && records_->next(record)) {
    Take take(record.payload);
    LogEntry entry;
    switch (record.type) {
      case kPose:
        entry = take_pose(take);
        break;
      case kProfile:
      case kOverlapProfile:
        if (!take_profile(record.payload, header_.colour, profile_)) {
          broken(record, "a profile");
          return std::nullopt;
        }
        return LoggedProfile{record.type == kOverlapProfile, &profile_};
      case kPosition:
        entry = take_position(take);
        break;
      case kFrame:
        entry = take_frame(take);
        break;
      case kEnd:
        entry = take_end(take);
        break;
      case kStop:
        entry = take_stop(take);
        break;
      default:
        continue;  // of a later minor version
    }
    if (!take.good()) {
      broken(record, "a short record");
      return std::nullopt;
    }
    if (const auto* end = std::get_if<LogEnd>(&entry)) end_ = *end;
    return entry;
  }
  return std::nullopt;
}

}  // namespace celadon
