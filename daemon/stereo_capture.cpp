#include "daemon/stereo_capture.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <utility>

#include "acquisition/stereo/calibration_share.h"
#include "daemon/table_turn.h"

namespace celadon {
namespace {

constexpr double kWholeTurn_rad = 2 * std::numbers::pi;
constexpr int kNoisePictures = 8;
constexpr int kBandsPerPoll = 8;            // so long the machine is not looked after
constexpr std::size_t kFewestSamples = 20;  // of a pair, before a scan is worth its time
constexpr double kManySaturated = 0.02;     // of the picture
constexpr auto kTellInterval = std::chrono::milliseconds(100);

tl::unexpected<ScanStop> stereo_failed(const std::string& reason) {
  return tl::make_unexpected(ScanStop{ScanState::failed, reason, false, false});
}

std::string percent(double share) {
  char text[32];
  std::snprintf(text, sizeof text, "%.0f %%", 100 * share);
  return text;
}

double saturated_share(const CameraMode& mode, std::span<const std::uint8_t> bytes) {
  const LevelPicture picture = levels_of(mode, bytes);
  const auto saturated =
      std::count_if(picture.level.begin(), picture.level.end(), [](float level) { return std::isnan(level); });
  return static_cast<double>(saturated) / static_cast<double>(picture.level.size());
}

/// The pixels of a match in the middle of those of the pair.
MatchedPixels middle_match(const StereoPair& pair, double first_rad, double second_rad) {
  const WindowMatch& match = pair.matches()[pair.matches().size() / 2];
  const NormalPair& geometry = pair.geometry();
  return {geometry.pixel(0, match.x_px, match.y_px), geometry.pixel(1, match.x_px - match.disparity_px, match.y_px),
          first_rad, second_rad};
}

}  // namespace

StereoCapture::StereoCapture(const ScanEquipment& equipment, const ScanRequest& request, FrameFeed& feed)
    : equipment_(equipment),
      request_(request),
      feed_(feed),
      pitch_rad_(kWholeTurn_rad / request.profiles / equipment.calibration.encoder.scale.value),
      apart_(std::max(1, static_cast<int>(std::lround(kPairTurn_rad * request.profiles / kWholeTurn_rad)))),
      sigma_rad_(equipment.device->capabilities().encoder_resolution_rad / std::sqrt(12.)) {
  share_.pair_rad = apart_ * kWholeTurn_rad / request.profiles;
}

tl::expected<StereoCapture::Picture, ScanStop> StereoCapture::picture_after(std::int64_t instant_ns) {
  auto frame = feed_.next_after(instant_ns);
  if (!frame) return tl::make_unexpected(frame.error());
  if (feed_.status().lasers_on != 0) {
    return stereo_failed("A laser shines although none was switched on; cut the power at the machine.");
  }
  feed_.verdict(frame->info, FrameVerdict::profile);
  return Picture{{frame->bytes().begin(), frame->bytes().end()}, feed_.status().angle_rad, frame->info.stamp_ns};
}

tl::expected<StereoCapture::Picture, ScanStop> StereoCapture::picture_at(double encoder_rad) {
  ScannerDevice& device = *equipment_.device;
  auto settled = device.rotate_to(encoder_rad, device.capabilities().max_speed_rad_per_s);
  if (!settled) return tl::make_unexpected(stop_of(settled.error()));
  auto picture = picture_after(settled->host_after_ns);
  if (picture) picture->encoder_rad = settled->angle_rad;
  return picture;
}

tl::expected<StereoPair, ScanStop> StereoCapture::match(const Picture& first, const Picture& second) {
  auto pair =
      StereoPair::begin(equipment_.calibration, equipment_.volume, equipment_.camera.mode(), noise_,
                        {first.bytes, first.encoder_rad, sigma_rad_}, {second.bytes, second.encoder_rad, sigma_rad_});
  if (!pair) return stereo_failed(pair.error());
  for (int band = 0; band < pair->bands(); ++band) {
    if (band % kBandsPerPoll == 0) {
      if (auto polled = feed_.poll(); !polled) return tl::make_unexpected(polled.error());
    }
    pair->match(band);
  }
  return std::move(*pair);
}

std::string StereoCapture::nothing_found(const MatchCounts& m, double saturated) const {
  const std::string found = "Of " + std::to_string(m.windows) + " places of the picture only " +
                            std::to_string(m.samples()) + " on the object could be matched: ";
  if (saturated > kManySaturated) {
    return found + percent(saturated) + " of the picture is saturated; expose for a shorter time, or dim the lamp.";
  }
  if (m.plain >= m.ambiguous + m.inconsistent + m.misfit + m.outside) {
    return found + std::to_string(m.plain) +
           " show too little texture; stereo needs a speckled surface under even light: light it, expose longer, "
           "speckle it, or scan with a laser.";
  }
  if (m.outside > m.ambiguous + m.inconsistent + m.misfit) {
    return found + std::to_string(m.outside) +
           " lie outside the scanner's volume; place the object over the middle of the table, or check calibration "
           "and volume.";
  }
  return found + std::to_string(m.ambiguous + m.inconsistent + m.misfit) +
         " show different things in the two pictures; check that object and camera stand firmly, and the calibration.";
}

tl::expected<ScanPreparation, ScanStop> StereoCapture::look() {
  if (auto off = feed_.laser_off(); !off) return tl::make_unexpected(off.error());
  std::vector<std::vector<std::uint8_t>> standing;
  Picture first;
  const std::int64_t since_ns = equipment_.clock.now_ns();
  for (int k = 0; k < kNoisePictures; ++k) {
    auto picture = picture_after(since_ns);
    if (!picture) return tl::make_unexpected(picture.error());
    standing.push_back(picture->bytes);
    first = std::move(*picture);
  }
  const CameraMode& mode = equipment_.camera.mode();
  noise_ = noise_of(mode, standing);
  auto second = picture_at(first.encoder_rad + apart_ * pitch_rad_);
  if (!second) return tl::make_unexpected(second.error());
  auto pair = match(first, *second);
  if (!pair) return tl::make_unexpected(pair.error());
  Profile profile;
  const MatchCounts counts = pair->fill(profile);
  const double saturated = saturated_share(mode, first.bytes);
  if (profile.size() < kFewestSamples) return stereo_failed(nothing_found(counts, saturated));

  ScanPreparation seen;
  if (saturated > kManySaturated) {
    seen.warnings.push_back(percent(saturated) +
                            " of the picture is saturated, where nothing is measured; expose for a shorter time.");
  }
  share_.calibration_mm =
      radius_uncertainty_mm(middle_match(*pair, first.encoder_rad, second->encoder_rad), equipment_.calibration);
  const auto [low, high] = std::minmax_element(profile.z_mm.begin(), profile.z_mm.end());
  seen.z_low_mm = *low;
  seen.z_high_mm = *high;
  seen.samples = profile.size();
  seen.background_at_rad = first.encoder_rad;
  seen.backgrounds.put(equipment_.camera.mode().exposure_ns, {}, std::move(first.bytes));
  return seen;
}

tl::expected<CaptureResult, ScanStop> StereoCapture::turn(const CaptureTools& tools) {
  const double base = feed_.status().angle_rad;
  const int pictures = request_.profiles + apart_;
  const double target = base + pictures * pitch_rad_;
  if (!turn_fits_travel(equipment_, target)) {
    return stereo_failed(
        "A scan by stereo needs the table to turn a little more than once from where it stands, "
        "beyond the end of its travel; home it and start again.");
  }
  std::deque<Picture> kept;  // until their partner has come
  Profile profile;
  const auto start = std::chrono::steady_clock::now();
  auto last_report = start;
  const auto report = [&](int done, std::uint32_t profiles) {
    const auto now = std::chrono::steady_clock::now();
    if (done < pictures && now - last_report < kTellInterval) return;
    last_report = now;
    const double elapsed_s = std::chrono::duration<double>(now - start).count();
    const FrameFeed::Counts& c = feed_.counts();
    ScanProgress p;
    p.fraction = static_cast<double>(done) / pictures;
    p.angle_deg = done * 360. / request_.profiles;
    p.frames = done;
    p.frames_expected = pictures;
    p.frames_lost = static_cast<int>(c.lost + c.corrupt);
    p.stale_frames = static_cast<int>(c.stale);
    p.frames_per_second = elapsed_s > 0 ? profiles / elapsed_s : 0;
    p.samples = tools.sums.samples();
    p.rejected = tools.sums.rejected();
    p.seconds_left = p.fraction > 0 ? elapsed_s * (1 - p.fraction) / p.fraction : 0;
    tools.observer.on_progress(p);
  };

  CaptureResult result;
  for (int k = 0; k < pictures; ++k) {
    auto picture = picture_at(base + (k + 1) * pitch_rad_);
    if (!picture) return tl::make_unexpected(picture.error());
    tools.datum.see(
        picture->bytes, [angle = picture->encoder_rad](double) { return angle; },
        k * kWholeTurn_rad / request_.profiles, 0);
    kept.push_back(std::move(*picture));
    if (k < apart_) continue;
    const Picture &first = kept.front(), &second = kept.back();
    auto pair = match(first, second);
    if (!pair) return tl::make_unexpected(pair.error());
    share_.counts += pair->fill(profile);
    profile.index = static_cast<std::uint32_t>(share_.pairs++);
    profile.time_ns = first.time_ns + (second.time_ns - first.time_ns) / 2;
    tools.sums.add(profile.r_mm, profile.theta_rad, profile.z_mm);
    tools.look.add(profile);
    if (auto logged = tools.log.append(profile); !logged) {
      return tl::make_unexpected(
          ScanStop{ScanState::failed, logged.error().message, false, false, ScanFailure::system});
    }
    kept.pop_front();
    report(k + 1, profile.index + 1);
  }
  const FrameFeed::Counts& c = feed_.counts();
  result.counters = {"step", tools.log.counts().profiles, c.frames, c.lost, c.stale, c.corrupt, 0};
  return result;
}

}  // namespace celadon
