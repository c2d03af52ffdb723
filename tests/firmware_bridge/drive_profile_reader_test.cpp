// Profiles from their files: the shipped ones, and every kind of nonsense named by file, line, field and remedy.

#include "daemon/drive_profile_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>

#include "tests/build_paths.h"

namespace celadon {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string file_text(const std::string& path) {
  std::ifstream in(std::string(CELADON_SOURCE_DIR) + "/" + path, std::ios::binary);
  EXPECT_TRUE(in) << path;
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

std::string with(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

const DriveRegister& by_name(const DriveProfile& p, const std::string& name) {
  for (const DriveRegister& r : p.registers) {
    if (r.name == name) return r;
  }
  throw std::runtime_error(name);
}

// By the makers' maps, not by the files.
TEST(DriveProfileReader, TheShippedProfilesSayWhatTheManualsSay) {
  const auto az = parse_drive_profile(file_text("firmware_bridge/profiles/oriental-motor-az.toml"), "az");
  ASSERT_TRUE(az) << az.error();
  EXPECT_EQ(az->word_order, WordOrder::high_first);
  EXPECT_TRUE(az->closed_loop && az->has_index);
  EXPECT_EQ(az->registers[az->position].address, 0x00CC);
  EXPECT_EQ(az->registers[az->fault.reg].address, 0x007F);
  EXPECT_EQ(az->registers[az->alarm].address, 0x0080);
  EXPECT_EQ(az->registers[az->stop.front().reg].address, 0x007D);
  EXPECT_EQ(az->registers[az->move.front().reg].address, 0x0058);
  EXPECT_EQ(az->move.size(), 8u);
  EXPECT_TRUE(az->mark.empty());
  ASSERT_TRUE(az->host_watchdog);
  EXPECT_FALSE(az->registers[*az->host_watchdog].confirmed);  // and so not relied on
  // Their pages were not at hand: no motion before somebody looked them up.
  EXPECT_FALSE(by_name(*az, "input_command").confirmed);
  EXPECT_FALSE(by_name(*az, "output_status").confirmed);
  EXPECT_NE(unconfirmed_for_motion(*az), nullptr);

  const auto leadshine = parse_drive_profile(file_text("firmware_bridge/profiles/leadshine-rs.toml"), "rs");
  ASSERT_TRUE(leadshine) << leadshine.error();
  EXPECT_EQ(leadshine->crc_exception, 8);
  EXPECT_FALSE(leadshine->host_watchdog);
  EXPECT_EQ(by_name(*leadshine, "status").address, 0x1003);
  EXPECT_EQ(by_name(*leadshine, "pr_control").address, 0x6002);
  EXPECT_EQ(by_name(*leadshine, "alarm").address, 0x2203);
  EXPECT_EQ(leadshine->registers[leadshine->move.front().reg].address, 0x6200);
  EXPECT_EQ(leadshine->registers[leadshine->move.back().reg].address, 0x6207);
  EXPECT_FALSE(by_name(*leadshine, "pr_control").confirmed);
  EXPECT_FALSE(by_name(*leadshine, "position").confirmed);
  EXPECT_NE(unconfirmed_for_motion(*leadshine), nullptr);
}

TEST(DriveProfileReader, EveryShippedProfileCitesItsSources) {
  int profiles = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(std::string(CELADON_SOURCE_DIR) + "/firmware_bridge/profiles")) {
    const auto profile = read_drive_profile(entry.path());
    ASSERT_TRUE(profile) << profile.error();
    ++profiles;
    EXPECT_EQ(profile->name + ".toml", entry.path().filename());
    for (const DriveRegister& r : profile->registers) {
      EXPECT_GE(r.source.size(), 10u) << profile->name << " " << r.name;
      // What is confirmed was seen on a page.
      EXPECT_EQ(r.confirmed, r.source.find("p. ") != std::string::npos) << profile->name << " " << r.name;
    }
    EXPECT_FALSE(profile->settings.empty());
    EXPECT_FALSE(profile->alarms.empty());
  }
  EXPECT_EQ(profiles, 2);
}

TEST(DriveProfileReader, AnIoModule) {
  const auto io = parse_io_profile(file_text("tests/firmware_bridge/io_module.toml"), "io");
  ASSERT_TRUE(io) << io.error();
  EXPECT_EQ(io->lasers, std::vector<std::uint32_t>{1});
  EXPECT_EQ(io->motor_enable, 2u);
  EXPECT_EQ(io->registers[io->button.reg].area, protocol::Area::input);
  EXPECT_EQ(io->laser_class, 2);
  EXPECT_EQ(unconfirmed_for_safety(*io), nullptr);
}

struct Nonsense {
  const char* from;
  const char* to;
  const char* field;
  const char* why;
};

class DriveNonsense : public testing::TestWithParam<Nonsense> {};

INSTANTIATE_TEST_SUITE_P(
    Profiles, DriveNonsense,
    testing::Values(
        Nonsense{"celadon-drive", "celadon-io", "line 2, format", "must be \"celadon-drive\""},
        Nonsense{"version = \"1.0\"", "version = \"2.0\"", "version", "reads \"1.0\""},
        Nonsense{"word_order = \"high_first\"", "word_order = \"big\"", "word_order", "high_first"},
        Nonsense{"steps_per_turn = 10000", "steps_per_turn = -1", "steps_per_turn", "above 0"},
        Nonsense{"time_stamp = \"host\"", "time_stamp = \"drive\"", "time_stamp", "must be \"host\""},
        Nonsense{"loop = \"closed\"", "loop = \"half\"", "loop", "open"},
        Nonsense{"index = true", "index = 1", "index", "true or false"},
        Nonsense{"crc_exception = 8", "crc_exception = 300", "crc_exception", "1 to 11"},
        Nonsense{"address = 0x1003", "address = 0x11003", "registers.status.address", "0 to 65535"},
        Nonsense{"[registers.status]", "[registers.Status]", "\"Status\"", "small letters"},
        Nonsense{"type = \"u16\"", "type = \"float\"", "type", "u16, s16, u32 or s32"},
        Nonsense{"unit = \"rpm\"", "unit = \"mph\"", "unit", "ms/1000rpm"},
        Nonsense{"unit = \"rpm\"", "unit = \"rpm\"\nscale = 0", "scale", "1e-9"},
        Nonsense{"unit = \"rpm\"", "unit = \"rpm\"\nscales = 1", "scales", "is not a key"},
        Nonsense{"confirmed = true\n", "", "confirmed", "DRIVE_PROFILES.md"},
        Nonsense{"source = \"CS2RS manual, Pr8.02", "source = \"\\u0007", "source", "printable"},
        Nonsense{"position = \"position\"", "position = \"place\"", "state.position", "one of [registers]"},
        Nonsense{"position = \"position\"", "position = \"speed\"", "state.position", "unit is step"},
        Nonsense{"speed = \"speed\"", "speed = \"position\"", "state.speed", "step/s or rpm"},
        Nonsense{"alarm = \"alarm\"", "alarm = \"speed\"", "state.alarm", "without a unit"},
        Nonsense{"mask = 0x0004, value = 0x0004", "mask = 0x0004, value = 0x0005", "state.moving.value", "never holds"},
        Nonsense{"mask = 0x0004, value", "mask = 0x10004, value", "state.moving.mask", "65535"},
        Nonsense{"moving = { register = \"status\"", "moving = { register = \"speed\"", "moving", "bits have none"},
        Nonsense{"value = 0x1111", "value = 0x11111", "reset[0].value", "does not fit"},
        Nonsense{"value = \"target\"", "value = \"speed\"", "move[1].value", "target, speed or acceleration"},
        Nonsense{"{ register = \"pr0_target\", value = \"target\" },", "{ register = \"pr0_target\", value = 0 },",
                 "move", "must write target"},
        Nonsense{"stop = [{ register = \"pr_control\", value = 0x0040 }]", "stop = []", "actions.stop", "empty"},
        Nonsense{"home = [{ register = \"pr_control\", value = 0x0020 }]\n", "", "actions.home", "is missing"},
        Nonsense{"fault = \"motor_stalled\"", "fault = \"bored\"", "fault", "section 6"},
        Nonsense{"fault = \"motor_stalled\"", "fault = \"heartbeat_lost\"", "fault", "16"},
        Nonsense{"code = 0x20", "code = 0", "alarms[2].code", "1 to 65535"}));

TEST_P(DriveNonsense, IsNamed) {
  const Nonsense& n = GetParam();
  const auto parsed =
      parse_drive_profile(with(file_text("firmware_bridge/profiles/leadshine-rs.toml"), n.from, n.to), "a file.toml");
  ASSERT_FALSE(parsed);
  EXPECT_THAT(parsed.error(), AllOf(HasSubstr("a file.toml, line "), HasSubstr(n.field), HasSubstr(n.why)));
}

class IoNonsense : public testing::TestWithParam<Nonsense> {};

INSTANTIATE_TEST_SUITE_P(
    Profiles, IoNonsense,
    testing::Values(
        Nonsense{"laser_class = 2", "laser_class = 4", "laser_class", "1 to 3"},
        Nonsense{"host_watchdog = \"watchdog\"", "host_watchdog = \"inputs\"", "host_watchdog", "unit is ms"},
        Nonsense{"register = \"outputs\"\nlasers", "register = \"inputs\"\nlasers", "outputs.register",
                 "holding register"},
        Nonsense{"lasers = [{ mask = 1 }]", "lasers = []", "outputs.lasers", "one laser at least"},
        Nonsense{"motor_enable = 2", "motor_enable = 1", "outputs", "one output to two things"},
        Nonsense{"lasers = [{ mask = 1 }]", "lasers = [{ mask = 1 }, { mask = 8 }]", "inputs", "for each laser"},
        Nonsense{"button = {", "knob = {", "inputs.button", "is missing"}));

TEST_P(IoNonsense, IsNamed) {
  const Nonsense& n = GetParam();
  const auto parsed =
      parse_io_profile(with(file_text("tests/firmware_bridge/io_module.toml"), n.from, n.to), "io.toml");
  ASSERT_FALSE(parsed);
  EXPECT_THAT(parsed.error(), AllOf(HasSubstr("io.toml, line "), HasSubstr(n.field), HasSubstr(n.why)));
}

TEST(DriveProfileReader, BytesBeyondAsciiAreRefusedByPlace) {
  const auto parsed = parse_drive_profile("format = \"celadon-drive\"\nname = \"\xC3\xA9\"\n", "f.toml");
  ASSERT_FALSE(parsed);
  EXPECT_THAT(parsed.error(), AllOf(HasSubstr("f.toml, line 2, column 9"), HasSubstr("0xC3"), HasSubstr("not ASCII")));
}

TEST(DriveProfileReader, NamesAndFilesThatAreNotThere) {
  EXPECT_THAT(
      read_drive_profile("no-such-drive").error(),
      AllOf(HasSubstr("no-such-drive.toml"), HasSubstr("cannot be opened"), HasSubstr("one of the profiles in")));
  EXPECT_THAT(read_io_profile("/no/such.toml").error(), HasSubstr("/no/such.toml"));
}

TEST(DriveProfileReader, NamesAreLookedUpBesideThePrograms) {
  const auto profile = read_drive_profile("leadshine-rs");
  ASSERT_TRUE(profile) << profile.error();
  EXPECT_EQ(profile->model, "RS");
}

// A seeded sample of what the fuzzer does for longer: never a crash, always a sentence.
TEST(DriveProfileReader, MutatedFilesAreReadOrNamed) {
  std::mt19937 random(7);
  const std::array<std::string, 2> seeds = {file_text("firmware_bridge/profiles/leadshine-rs.toml"),
                                            file_text("firmware_bridge/profiles/oriental-motor-az.toml")};
  int refused = 0;
  for (int i = 0; i < 2000; ++i) {
    std::string text = seeds[static_cast<std::size_t>(i % 2)];
    for (int edits = 1 + i % 4; edits > 0; --edits) {
      const std::size_t at = random() % text.size();
      switch (random() % 4) {
        case 0:
          text[at] = static_cast<char>(random());
          break;
        case 1:
          text.erase(at, 1 + random() % 40);
          break;
        case 2:
          text.insert(at, text.substr(random() % text.size(), random() % 60));
          break;
        default:
          text[at] = "=[]{}\"',.0"[random() % 10];
      }
      if (text.empty()) text = "a";
    }
    const auto parsed = parse_drive_profile(text, "m");
    if (parsed) continue;
    ++refused;
    EXPECT_THAT(parsed.error(), HasSubstr("line ")) << text;
  }
  EXPECT_GT(refused, 500);
}

}  // namespace
}  // namespace celadon
