#include "daemon/cli/log_file.h"

#include <array>
#include <cstring>
#include <fstream>
#include <utility>

#include "fitting/moved_stream.h"

namespace celadon::cli {

bool is_profile_log(const std::filesystem::path& file) {
  std::array<char, sizeof kLogMagic> begin{};
  std::ifstream in(file, std::ios::binary);
  return in.read(begin.data(), begin.size()) && std::memcmp(begin.data(), kLogMagic, sizeof kLogMagic) == 0;
}

tl::expected<std::unique_ptr<LogFile>, std::string> LogFile::open(const std::filesystem::path& file,
                                                                  const CloudOptions& options) {
  auto reader = ProfileLogReader::open(file);
  if (!reader) return tl::make_unexpected(reader.error().message);
  return std::unique_ptr<LogFile>(
      new LogFile(std::move(*reader), options.X_SF.value_or(Eigen::Isometry3d::Identity())));
}

std::string LogFile::ending() const {
  const auto& end = reader_->end();
  if (!end)
    return "The scan was interrupted: its log has no end" +
           (reader_->torn_bytes() > 0 ? ", and its last " + std::to_string(reader_->torn_bytes()) + " bytes are torn"
                                      : std::string()) +
           "; what it holds is fitted.";
  if (end->outcome == LogOutcome::complete) return {};
  return std::string("The scan ") + (end->outcome == LogOutcome::cancelled ? "was cancelled" : "failed") +
         (end->reason.empty() ? "" : " (" + end->reason + ")") + "; what its log holds is fitted.";
}

void LogFile::rewind() {
  reader_->rewind();
  X_PS_.clear();
  points_ = 0;
}

const Profile* LogFile::next() {
  while (error_.empty()) {
    const auto entry = reader_->next_entry();
    if (!entry) return nullptr;
    if (const auto* pose = std::get_if<LogPose>(&*entry)) X_PS_[pose->pose] = pose->X_SP.inverse();
    const auto* logged = std::get_if<LoggedProfile>(&*entry);
    if (logged == nullptr || logged->overlap) continue;
    const Profile& profile = *logged->profile;
    const auto X_PS = X_PS_.find(profile.pose);
    if (X_PS == X_PS_.end()) {
      error_ = "profile " + std::to_string(profile.index) + " names pose " + std::to_string(profile.pose) +
               ", which its log does not have before it; give a log that celadond wrote.";
      return nullptr;
    }
    points_ += profile.size();
    const Eigen::Isometry3d X_LS = X_LS_ * X_PS->second * Eigen::Translation3d(0, 0, -profile.lift_mm);
    if (X_LS.matrix().isIdentity(0)) return &profile;
    move_profile(profile, X_LS, moved_);
    return &moved_;
  }
  return nullptr;
}

}  // namespace celadon::cli
