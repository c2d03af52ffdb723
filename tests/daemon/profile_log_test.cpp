// The profile log against a file written by hand from its grammar, and against damage of every kind.

#include "daemon/profile_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstring>
#include <limits>

#include "daemon/crc32c.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::read_file;
using testing::TemporaryFolder;
using testing::write_file;

const unsigned char kGolden[] = {
#include "tests/daemon/profile_log_golden.inc"
};

const unsigned char kGolden_1_0[] = {
#include "tests/daemon/profile_log_golden_1_0.inc"
};

const unsigned char kGolden_1_1[] = {
#include "tests/daemon/profile_log_golden_1_1.inc"
};

const unsigned char kGolden_1_3[] = {
#include "tests/daemon/profile_log_golden_1_3.inc"
};

std::string golden() {
  return {reinterpret_cast<const char*>(kGolden), sizeof kGolden};
}

LogHeader golden_header() {
  LogHeader header{"2026-01-02T03:04:05Z", "machine 1", "camera 1", true, {}, "text of\na calibration"};
  header.request.name = "vase";
  header.lasers = {1, 0};
  return header;
}

Profile golden_profile() {
  Profile p;
  p.index = 3;
  p.laser = 1;
  p.lift_mm = 1.5;
  p.table_angle_rad = 0.25;
  p.time_ns = 1500;
  p.r_mm = {30, 30.5};
  p.theta_rad = {.25, .26};
  p.z_mm = {10, 11};
  p.covariance = {{1, 2, 3, 4, 5, 6}, {7, 8, 9, 10, 11, 12}};
  p.row = {100, 101};
  return p;
}

void expect_equal(const Profile& a, const Profile& b) {
  EXPECT_EQ(a.index, b.index);
  EXPECT_EQ(a.pose, b.pose);
  EXPECT_EQ(a.laser, b.laser);
  EXPECT_EQ(a.order, b.order);
  EXPECT_EQ(a.lift_mm, b.lift_mm);
  EXPECT_EQ(a.table_angle_rad, b.table_angle_rad);
  EXPECT_EQ(a.time_ns, b.time_ns);
  EXPECT_EQ(a.r_mm, b.r_mm);
  EXPECT_EQ(a.theta_rad, b.theta_rad);
  EXPECT_EQ(a.z_mm, b.z_mm);
  EXPECT_EQ(a.row, b.row);
  EXPECT_EQ(a.colour, b.colour);
  ASSERT_EQ(a.covariance.size(), b.covariance.size());
  if (a.covariance.empty()) return;
  EXPECT_EQ(std::memcmp(a.covariance.data(), b.covariance.data(), a.covariance.size() * sizeof(SampleCovariance)), 0);
}

/// A log of n profiles; returns the offset at which each record begins.
std::vector<std::size_t> write_log(const std::filesystem::path& file, int n, bool with_end) {
  auto log = ProfileLogWriter::create(file, golden_header());
  EXPECT_TRUE(log) << log.error().message;
  for (int i = 0; i < n; ++i) {
    Profile p = golden_profile();
    p.index = static_cast<std::uint32_t>(i);
    (*log)->append(LogFrame{static_cast<std::uint64_t>(i), i, 1, 0, FrameVerdict::profile});
    EXPECT_TRUE((*log)->append(p));
  }
  if (with_end) {
    EXPECT_TRUE((*log)->finish(LogOutcome::complete, ""));
  }
  std::vector<std::size_t> starts;
  const std::string bytes = read_file(file);
  for (std::size_t at = 16; at < bytes.size();) {
    starts.push_back(at);
    std::uint32_t length = 0;
    std::memcpy(&length, bytes.data() + at + 8, 4);
    at += 24 + ((length + 7) & ~7u);
  }
  return starts;
}

int count_profiles(ProfileStream& stream) {
  int n = 0;
  while (stream.next() != nullptr) ++n;
  return n;
}

TEST(Crc32c, MatchesThePublishedVectors) {  // RFC 3720, appendix B.4
  const std::string zeros(32, '\0'), ones(32, '\xFF');
  std::string rising, falling;
  for (int i = 0; i < 32; ++i) {
    rising += static_cast<char>(i);
    falling += static_cast<char>(31 - i);
  }
  EXPECT_EQ(crc32c("123456789", 9), 0xE3069283u);
  EXPECT_EQ(crc32c(zeros.data(), 32), 0x8A9136AAu);
  EXPECT_EQ(crc32c(ones.data(), 32), 0x62A8AB43u);
  EXPECT_EQ(crc32c(rising.data(), 32), 0x46DD794Eu);
  EXPECT_EQ(crc32c(falling.data(), 32), 0x113FDB5Cu);
  EXPECT_EQ(crc32c(rising.data() + 5, 27, crc32c(rising.data(), 5)), 0x46DD794Eu);
}

/// The golden log, in `file`; with or without colours.
void write_golden(const std::filesystem::path& file, bool colour) {
  LogHeader header = golden_header();
  header.colour = colour;
  auto log = ProfileLogWriter::create(file, header);
  ASSERT_TRUE(log) << log.error().message;
  (*log)->append(PositionSample{7, 123456, .25, 1000, 2000});
  (*log)->append(LogFrame{41, 1500, 4'000'000, 2, FrameVerdict::profile});
  (*log)->append(LogStop{});  // where the axes are known to stand
  (*log)->append(LogStop{{0.5, 30}});
  Profile profile = golden_profile();
  if (colour) profile.colour = {{200, 40, 90}, {}};
  ASSERT_TRUE((*log)->append(profile));
  (*log)->append(LogStop{{0.5, 30}});
  Profile overlap;
  overlap.index = 4;
  overlap.order = ProfileOrder::scattered;
  overlap.table_angle_rad = 6.5;
  overlap.time_ns = 1600;
  overlap.r_mm = {30};
  overlap.theta_rad = {6.5};
  overlap.z_mm = {10};
  if (colour) overlap.colour = {{1, 2, 3}};
  ASSERT_TRUE((*log)->append(overlap, true));
  ASSERT_TRUE((*log)->finish(LogOutcome::cancelled, "button pressed"));
  ASSERT_TRUE((*log)->wait_synced());
  EXPECT_EQ((*log)->bytes(), std::filesystem::file_size(file));
}

TEST(ProfileLog, WritesTheBytesOfItsGrammar) {
  const TemporaryFolder folder;
  write_golden(folder / "log", false);
  EXPECT_EQ(read_file(folder / "log"), golden());
  write_golden(folder / "coloured", true);
  EXPECT_EQ(read_file(folder / "coloured"),
            std::string(reinterpret_cast<const char*>(kGolden_1_3), sizeof kGolden_1_3));
}

TEST(ProfileLog, ReadsTheColoursOfVersion1_3) {
  const TemporaryFolder folder;
  write_file(folder / "log", {reinterpret_cast<const char*>(kGolden_1_3), sizeof kGolden_1_3});
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log) << log.error().message;
  EXPECT_TRUE((*log)->header().colour);
  Profile wanted = golden_profile();
  wanted.colour = {{200, 40, 90}, {}};
  const Profile* p = (*log)->next();
  ASSERT_NE(p, nullptr);
  expect_equal(*p, wanted);
  (*log)->rewind();
  std::vector<SampleColour> overlap;
  while (const auto entry = (*log)->next_entry()) {
    if (const auto* logged = std::get_if<LoggedProfile>(&*entry); logged != nullptr && logged->overlap)
      overlap = logged->profile->colour;
  }
  EXPECT_EQ(overlap, (std::vector<SampleColour>{{1, 2, 3}}));
}

// A profile without colours in a log that has them, as of samples that were left out: each says "not known".
TEST(ProfileLog, AProfileWithoutColoursIsBlackInALogThatHasThem) {
  const TemporaryFolder folder;
  LogHeader header = golden_header();
  header.colour = true;
  auto writer = ProfileLogWriter::create(folder / "log", header);
  ASSERT_TRUE(writer);
  ASSERT_TRUE((*writer)->append(golden_profile()));
  ASSERT_TRUE((*writer)->finish(LogOutcome::complete, ""));
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log);
  const Profile* p = (*log)->next();
  ASSERT_NE(p, nullptr);
  EXPECT_EQ(p->colour, std::vector<SampleColour>(2));
}

TEST(ProfileLog, ReadsALogWrittenByHand) {
  const TemporaryFolder folder;
  write_file(folder / "log", golden());
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log) << log.error().message;
  EXPECT_EQ((*log)->header().date, "2026-01-02T03:04:05Z");
  EXPECT_EQ((*log)->header().machine, "machine 1");
  EXPECT_EQ((*log)->header().calibration, "text of\na calibration");
  EXPECT_EQ((*log)->header().request.name, "vase");
  EXPECT_TRUE((*log)->header().simulated);
  EXPECT_EQ((*log)->header().lasers, (std::vector<int>{1, 0}));
  for (int pass = 0; pass < 3; ++pass) {
    const Profile* p = (*log)->next();
    ASSERT_NE(p, nullptr);
    expect_equal(*p, golden_profile());
    EXPECT_EQ((*log)->next(), nullptr) << "the overlap profile is not part of the fit";
    EXPECT_EQ((*log)->error(), "");
    EXPECT_EQ((*log)->torn_bytes(), 0u);
    ASSERT_TRUE((*log)->end());
    EXPECT_EQ((*log)->end()->outcome, LogOutcome::cancelled);
    EXPECT_EQ((*log)->end()->reason, "button pressed");
    EXPECT_EQ((*log)->end()->samples, 2u);
    (*log)->rewind();
  }
  int poses = 0, positions = 0, frames = 0, overlaps = 0, stops = 0;
  while (const auto entry = (*log)->next_entry()) {
    if (const auto* pose = std::get_if<LogPose>(&*entry)) {
      ++poses;
      EXPECT_TRUE(pose->X_SP.isApprox(Eigen::Isometry3d::Identity()));
      EXPECT_EQ(pose->covariance.norm(), 0);
    }
    if (const auto* position = std::get_if<PositionSample>(&*entry)) {
      ++positions;
      EXPECT_EQ(position->counter, 7u);
      EXPECT_EQ(position->device_time_us, 123456u);
      EXPECT_EQ(position->host_after_ns, 2000);
    }
    if (const auto* frame = std::get_if<LogFrame>(&*entry)) {
      ++frames;
      EXPECT_EQ(frame->sequence, 41u);
      EXPECT_EQ(frame->lost_before, 2u);
    }
    if (const auto* at = std::get_if<LogStop>(&*entry)) {
      ++stops;
      EXPECT_EQ(at->stop, (AxisStop{0.5, 30}));
      EXPECT_EQ(overlaps, 0) << "before the profiles that it is about";
    }
    if (const auto* logged = std::get_if<LoggedProfile>(&*entry)) overlaps += logged->overlap ? 1 : 0;
  }
  EXPECT_EQ(stops, 1);
  EXPECT_EQ(poses, 1);
  EXPECT_EQ(positions, 1);
  EXPECT_EQ(frames, 1);
  EXPECT_EQ(overlaps, 1);
}

TEST(ProfileLog, ReadsALogOfVersion1_0) {
  const TemporaryFolder folder;
  write_file(folder / "log", {reinterpret_cast<const char*>(kGolden_1_0), sizeof kGolden_1_0});
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log) << log.error().message;
  EXPECT_TRUE((*log)->header().lasers.empty());
  EXPECT_EQ((*log)->header().request.name, "vase");
  const Profile* p = (*log)->next();
  ASSERT_NE(p, nullptr);
  expect_equal(*p, golden_profile());
  EXPECT_EQ((*log)->next(), nullptr);
  EXPECT_EQ((*log)->error(), "");
}

TEST(ProfileLog, ReadsALogOfVersion1_1) {
  const TemporaryFolder folder;
  write_file(folder / "log", {reinterpret_cast<const char*>(kGolden_1_1), sizeof kGolden_1_1});
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log) << log.error().message;
  EXPECT_EQ((*log)->header().lasers, (std::vector<int>{1, 0}));
  const Profile* p = (*log)->next();
  ASSERT_NE(p, nullptr);
  expect_equal(*p, golden_profile());
  EXPECT_EQ((*log)->next(), nullptr);
  EXPECT_EQ((*log)->error(), "");
}

TEST(ProfileLog, NeverOverwrites) {
  const TemporaryFolder folder;
  write_file(folder / "log", "precious");
  const auto log = ProfileLogWriter::create(folder / "log", golden_header());
  ASSERT_FALSE(log);
  EXPECT_NE(log.error().message.find("never overwritten"), std::string::npos) << log.error().message;
  EXPECT_EQ(read_file(folder / "log"), "precious");
}

TEST(ProfileLog, TornAtAnyByteKeepsEveryWholeRecord) {
  const TemporaryFolder folder;
  const auto starts = write_log(folder / "log", 4, true);
  const std::string bytes = read_file(folder / "log");
  for (std::size_t cut = starts[1]; cut < bytes.size(); ++cut) {
    write_file(folder / "cut", bytes.substr(0, cut));
    auto log = ProfileLogReader::open(folder / "cut");
    ASSERT_TRUE(log) << log.error().message;
    std::size_t whole = 0;
    while (whole + 1 < starts.size() && starts[whole + 1] <= cut) ++whole;
    EXPECT_EQ(count_profiles(**log), static_cast<int>(whole / 2 > 0 ? (whole - 2) / 2 : 0)) << cut;
    EXPECT_EQ((*log)->error(), "");
    EXPECT_EQ((*log)->torn_bytes(), cut - starts[whole]) << cut;
    EXPECT_FALSE((*log)->end());
  }
}

TEST(ProfileLog, TailOfZerosIsTorn) {  // what a file system may leave after a power cut
  const TemporaryFolder folder;
  write_log(folder / "log", 3, false);
  const std::string bytes = read_file(folder / "log");
  write_file(folder / "log", bytes + std::string(4096, '\0'));
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log);
  EXPECT_EQ(count_profiles(**log), 3);
  EXPECT_EQ((*log)->error(), "");
  EXPECT_EQ((*log)->torn_bytes(), 4096u);
}

RC_GTEST_PROP(ProfileLog, AnyFlippedBitIsFoundAndNamed, ()) {
  const TemporaryFolder folder;
  const auto starts = write_log(folder / "log", 5, true);
  std::string bytes = read_file(folder / "log");
  // In the records between the header and the last one; there a tear and damage cannot be told apart.
  const auto at = *rc::gen::inRange(starts[1], starts.back());
  const auto bit = *rc::gen::inRange(0, 8);
  bytes[at] = static_cast<char>(bytes[at] ^ (1 << bit));
  write_file(folder / "log", bytes);
  auto log = ProfileLogReader::open(folder / "log");
  RC_ASSERT(log.has_value());
  std::size_t hit = 0;
  while (hit + 1 < starts.size() && starts[hit + 1] <= at) ++hit;
  const int before = hit < 3 ? 0 : static_cast<int>((hit - 2) / 2);
  RC_ASSERT(count_profiles(**log) == before);
  RC_ASSERT((*log)->error().find("at offset " + std::to_string(starts[hit])) != std::string::npos);
  RC_ASSERT((*log)->error().find("go on at offset " + std::to_string(starts[hit + 1])) != std::string::npos);
}

TEST(ProfileLog, AMissingRecordIsDamage) {
  const TemporaryFolder folder;
  const auto starts = write_log(folder / "log", 5, true);
  std::string bytes = read_file(folder / "log");
  bytes.erase(starts[5], starts[6] - starts[5]);
  write_file(folder / "log", bytes);
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log);
  EXPECT_EQ(count_profiles(**log), 1);
  EXPECT_NE((*log)->error().find("number 5 at offset " + std::to_string(starts[5])), std::string::npos)
      << (*log)->error();
}

TEST(ProfileLog, SaysWhatIsNoLog) {
  const TemporaryFolder folder;
  const auto message = [&](const std::string& bytes) {
    write_file(folder / "log", bytes);
    const auto log = ProfileLogReader::open(folder / "log");
    return log ? std::string() : log.error().message;
  };
  EXPECT_NE(message("").find("has 0 bytes"), std::string::npos);
  EXPECT_NE(message(std::string(100, 'x')).find("offset 0"), std::string::npos);
  EXPECT_NE(message(golden().substr(0, 20)).find("no readable header"), std::string::npos);
  std::string other = golden();
  other[8] = 2;
  EXPECT_NE(message(other).find("version is 2.2"), std::string::npos);
  EXPECT_FALSE(ProfileLogReader::open(folder.path()));
  EXPECT_FALSE(ProfileLogReader::open(folder / "absent"));
}

TEST(ProfileLog, SkipsRecordsOfALaterMinorVersion) {
  const TemporaryFolder folder;
  auto records = RecordWriter::create(folder / "log", 2);
  ASSERT_TRUE(records);
  const std::string bytes = golden();
  // The header record as written by hand, then a record of a type that version 1.0 does not know.
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 16 + 8, 4);
  (*records)->put(1, {reinterpret_cast<const std::uint8_t*>(bytes.data()) + 16 + 24, length});
  const std::uint8_t unknown[3] = {1, 2, 3};
  (*records)->put(999, unknown);
  ASSERT_TRUE((*records)->flush());
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log);
  EXPECT_FALSE((*log)->next_entry());
  EXPECT_EQ((*log)->error(), "");
}

TEST(ProfileLog, AProfileThatLiesAboutItsLengthIsRefused) {
  const TemporaryFolder folder;
  auto records = RecordWriter::create(folder / "log", 2);
  const std::string bytes = golden();
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 16 + 8, 4);
  (*records)->put(1, {reinterpret_cast<const std::uint8_t*>(bytes.data()) + 16 + 24, length});
  std::uint8_t profile[64] = {};
  const std::uint32_t n = 0xFFFFFFFF;
  std::memcpy(profile + 32, &n, 4);
  (*records)->put(3, profile);
  ASSERT_TRUE((*records)->flush());
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log);
  EXPECT_EQ((*log)->next(), nullptr);
  EXPECT_NE((*log)->error().find("a profile at offset"), std::string::npos) << (*log)->error();
}

RC_GTEST_PROP(ProfileLog, RoundTripIsExact, ()) {
  const TemporaryFolder folder;
  const auto count = *rc::gen::inRange(0, 20);
  std::vector<Profile> profiles;
  for (int i = 0; i < count; ++i) {
    Profile p;
    const auto n = static_cast<std::size_t>(*rc::gen::inRange(0, 300));
    p.index = static_cast<std::uint32_t>(i);
    p.pose = *rc::gen::arbitrary<std::uint16_t>();
    p.laser = *rc::gen::arbitrary<std::uint8_t>();
    p.order = *rc::gen::element(ProfileOrder::rows, ProfileOrder::scattered);
    p.lift_mm = *rc::gen::arbitrary<double>();
    p.time_ns = *rc::gen::arbitrary<std::int64_t>();
    const bool covariance = *rc::gen::arbitrary<bool>(), row = *rc::gen::arbitrary<bool>();
    for (std::size_t k = 0; k < n; ++k) {
      const auto x = static_cast<double>(k);
      p.r_mm.push_back(30 + 1 / (x + 3));
      p.theta_rad.push_back(-x / 7);
      p.z_mm.push_back(x * 1e-3);
      if (covariance) p.covariance.push_back({float(k), 1, 2, 3, 4, -float(k)});
      if (row) p.row.push_back(static_cast<std::uint16_t>(k));
    }
    profiles.push_back(p);
  }
  {
    auto log = ProfileLogWriter::create(folder / "log", golden_header());
    RC_ASSERT(log.has_value());
    for (const Profile& p : profiles) RC_ASSERT((*log)->append(p).has_value());
    if (*rc::gen::arbitrary<bool>()) RC_ASSERT((*log)->finish(LogOutcome::complete, "").has_value());
  }
  auto log = ProfileLogReader::open(folder / "log");
  RC_ASSERT(log.has_value());
  for (int pass = 0; pass < 2; ++pass) {
    for (const Profile& expected : profiles) {
      const Profile* p = (*log)->next();
      RC_ASSERT(p != nullptr);
      expect_equal(*p, expected);
    }
    RC_ASSERT((*log)->next() == nullptr);
    RC_ASSERT((*log)->error().empty());
    (*log)->rewind();
  }
}

// A full disk, by the largest file that the process may write: what was written before stays, whole.
TEST(ProfileLog, AFullDiskIsASentenceAndKeepsWholeRecords) {
  const TemporaryFolder folder;
  constexpr rlim_t kLimit = 20'000;
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{kLimit, kLimit};
    setrlimit(RLIMIT_FSIZE, &limit);
    auto log = ProfileLogWriter::create(folder / "log", golden_header());
    if (!log) _exit(2);
    for (int i = 0; i < 1000; ++i) {
      const auto written = (*log)->append(golden_profile());
      if (written) continue;
      const std::string& m = written.error().message;
      const bool named = m.find("bytes written before are kept") != std::string::npos &&
                         m.find((folder / "log").string()) != std::string::npos &&
                         m.find(std::to_string((*log)->bytes())) != std::string::npos && m.find("free space") != m.npos;
      _exit(named && written.error().errno_value == EFBIG ? 0 : 3);
    }
    _exit(4);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(WEXITSTATUS(status), 0);
  auto log = ProfileLogReader::open(folder / "log");
  ASSERT_TRUE(log) << log.error().message;
  EXPECT_GT(count_profiles(**log), 50);
  EXPECT_EQ((*log)->torn_bytes(), 0u) << "the torn record was cut off";
  EXPECT_EQ((*log)->error(), "");
}

// Parts of a log, read at the same time or one after the other, are the log.
TEST(ProfileLog, PartsTogetherHoldEveryProfileOnce) {
  for (const int count : {0, 1, 15, 16, 17, 130}) {
    for (const int parts : {1, 2, 4, 7}) {
      const TemporaryFolder folder;
      auto log = ProfileLogWriter::create(folder / "a.log", golden_header());
      ASSERT_TRUE(log);
      for (int k = 0; k < count; ++k) {
        Profile p = golden_profile();
        p.index = static_cast<std::uint32_t>(k);
        (*log)->append(LogFrame{static_cast<std::uint64_t>(k), k, 1, 0, FrameVerdict::profile});
        ASSERT_TRUE((*log)->append(p));
        if (k % 5 == 0) {
          ASSERT_TRUE((*log)->append(p, true));
        }
      }
      ASSERT_TRUE((*log)->finish(LogOutcome::complete, ""));
      const std::vector<RecordMark> edges = (*log)->divide(parts);
      ASSERT_EQ(edges.size(), static_cast<std::size_t>(parts) + 1);
      std::uint32_t next = 0;
      for (int k = 0; k < parts; ++k) {
        const auto at = static_cast<std::size_t>(k);
        auto part = ProfileLogReader::open(folder / "a.log", edges[at], edges[at + 1]);
        ASSERT_TRUE(part) << part.error().message;
        EXPECT_EQ((*part)->header().machine, golden_header().machine);
        const std::uint32_t first = next;
        for (int pass = 0; pass < 2; ++pass) {
          next = first;
          (*part)->rewind();
          while (const Profile* p = (*part)->next()) EXPECT_EQ(p->index, next++);
          EXPECT_EQ((*part)->error(), "");
        }
        if (count >= 16 * parts) {
          EXPECT_LE(next - first, static_cast<std::uint32_t>(count / parts + 32));
        }
      }
      EXPECT_EQ(next, static_cast<std::uint32_t>(count));
    }
  }
}

// What follows lies in the next part: no torn tail of a whole log, and no profile lost in silence.
TEST(ProfileLog, DamageInTheLastRecordOfAPartIsTold) {
  const TemporaryFolder folder;
  auto log = ProfileLogWriter::create(folder / "a.log", golden_header());
  ASSERT_TRUE(log);
  for (int k = 0; k < 64; ++k) ASSERT_TRUE((*log)->append(golden_profile()));
  ASSERT_TRUE((*log)->finish(LogOutcome::complete, ""));
  const std::vector<RecordMark> edges = (*log)->divide(2);
  const std::string whole = read_file(folder / "a.log");
  std::size_t last = whole.rfind("CLPR", static_cast<std::size_t>(edges[1].offset) - 1);
  for (const std::size_t at : {last + 20, last + 24 + 8}) {  // of the head, of the payload
    std::string bytes = whole;
    bytes[at] ^= 1;
    std::filesystem::remove(folder / "a.log");
    write_file(folder / "a.log", bytes);
    auto part = ProfileLogReader::open(folder / "a.log", edges[0], edges[1]);
    ASSERT_TRUE(part) << part.error().message;
    EXPECT_EQ(count_profiles(**part), 31);
    EXPECT_THAT((*part)->error(), ::testing::HasSubstr("damaged"));
  }
  write_file(folder / "a.log", whole.substr(0, last + 30));  // cut within the first part, and so before the second
  for (std::size_t k = 0; k < 2; ++k) {
    auto part = ProfileLogReader::open(folder / "a.log", edges[k], edges[k + 1]);
    ASSERT_TRUE(part) << part.error().message;
    count_profiles(**part);
    EXPECT_THAT((*part)->error(), ::testing::HasSubstr("damaged"));
  }
}

TEST(ProfileLog, DamageInOnePartIsToldThere) {
  const TemporaryFolder folder;
  auto log = ProfileLogWriter::create(folder / "a.log", golden_header());
  ASSERT_TRUE(log);
  for (int k = 0; k < 64; ++k) ASSERT_TRUE((*log)->append(golden_profile()));
  ASSERT_TRUE((*log)->finish(LogOutcome::complete, ""));
  const std::vector<RecordMark> edges = (*log)->divide(2);
  std::string bytes = read_file(folder / "a.log");
  bytes[static_cast<std::size_t>(edges[1].offset) + 40] ^= 1;
  write_file(folder / "a.log", bytes);
  for (std::size_t k = 0; k < 2; ++k) {
    auto part = ProfileLogReader::open(folder / "a.log", edges[k], edges[k + 1]);
    ASSERT_TRUE(part);
    count_profiles(**part);
    EXPECT_EQ((*part)->error().empty(), k == 0) << (*part)->error();
  }
}

}  // namespace
}  // namespace celadon
