// Requests from the network, configuration files and the store: what is wrong is named, what is right comes back.

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <nlohmann/json.hpp>

#include "daemon/config.h"
#include "daemon/profile_log.h"
#include "daemon/scan_service.h"
#include "daemon/scan_store.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using nlohmann::json;
using testing::TemporaryFolder;
using testing::write_file;

TEST(ScanState, NamesComeBack) {
  for (int i = 0; i <= static_cast<int>(ScanState::interrupted); ++i) {
    const auto state = static_cast<ScanState>(i);
    EXPECT_EQ(scan_state_from(to_string(state)), state);
  }
  EXPECT_FALSE(scan_state_from("running"));
}

TEST(ScanRequestJson, EmptyMeansTheDefaults) {
  const auto request = scan_request_from_json(json::object());
  ASSERT_TRUE(request);
  EXPECT_EQ(request->mode, ScanMode::sweep);
  EXPECT_EQ(request->profiles, 1200);
  EXPECT_EQ(request->model, "auto");
  EXPECT_EQ(request->formats.size(), 4u);
  EXPECT_TRUE(request->lasers.empty());
  const auto all = scan_request_from_json(json{{"lasers", "all"}});
  ASSERT_TRUE(all);
  EXPECT_TRUE(all->lasers.empty());
}

TEST(ScanRequestJson, StereoIsInStepsAndComesBack) {
  const auto request = scan_request_from_json(json{{"method", "stereo"}});
  ASSERT_TRUE(request) << request.error().detail;
  EXPECT_EQ(request->method, ScanMethod::stereo);
  EXPECT_EQ(request->mode, ScanMode::step);
  EXPECT_EQ(request->profiles, kStereoProfiles);
  ScanRecord record;
  record.request = *request;
  const auto back = scan_request_from_json(to_json(record)["request"]);
  ASSERT_TRUE(back) << back.error().detail;
  EXPECT_EQ(back->method, ScanMethod::stereo);
  EXPECT_EQ(back->profiles, kStereoProfiles);
  // Programs from before there was a choice read requests of scans with a laser.
  EXPECT_FALSE(to_json(ScanRecord{})["request"].contains("method"));
}

TEST(ScanRequestJson, WhatStereoCannotDoIsRefused) {
  const std::pair<json, const char*> wrong[] = {
      {{{"method", "sonar"}}, "one of laser, stereo"},
      {{{"method", "stereo"}, {"mode", "sweep"}}, "give step with the method stereo"},
      {{{"method", "stereo"}, {"profiles", 35}}, "from 36 to 720"},
      {{{"method", "stereo"}, {"profiles", 721}}, "from 36 to 720"},
      {{{"method", "stereo"}, {"lasers", {0}}}, "no lasers with the method stereo"},
      {{{"method", "stereo"}, {"elevations_deg", {0, 20}}}, "no elevations"},
      {{{"method", "stereo"}, {"lifts_mm", {0}}}, "no heights"},
      {{{"method", "stereo"}, {"dry_turn", true}}, "no dry turn"},
  };
  for (const auto& [body, sentence] : wrong) {
    const auto request = scan_request_from_json(body);
    ASSERT_FALSE(request) << body;
    EXPECT_EQ(request.error().status, 422);
    EXPECT_NE(request.error().detail.find(sentence), std::string::npos) << request.error().detail;
  }
  EXPECT_TRUE(scan_request_from_json(json{{"method", "laser"}, {"mode", "sweep"}}));
}

TEST(ScanRequestJson, EveryFieldComesBack) {
  ScanRecord record;
  record.request.name = "vase 2.b";
  record.request.mode = ScanMode::step;
  record.request.profiles = 16;
  record.request.exposure_ms = 1.25;
  record.request.lasers = {1, 0};
  record.request.elevations_deg = {-5, 30.5};
  record.request.lifts_mm = {0, 80};
  record.request.model = "revolution";
  record.request.tolerance_mm = 0.1;
  record.request.form_tolerance_mm = 0.05;
  record.request.degree_u = 5;
  record.request.degree_v = 1;
  record.request.formats = {"stl"};
  const auto back = scan_request_from_json(to_json(record)["request"]);
  ASSERT_TRUE(back) << back.error().detail;
  ScanRecord again;
  again.request = *back;
  EXPECT_EQ(to_json(again), to_json(record));
}

TEST(ScanRequestJson, TheExposureMayBeFoundByTheScan) {
  const auto found = scan_request_from_json(json{{"exposure_ms", "auto"}});
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_TRUE(found->exposure_auto);
  ScanRecord record;
  record.request = *found;
  EXPECT_EQ(to_json(record)["request"]["exposure_ms"], "auto");
  EXPECT_TRUE(scan_request_from_json(to_json(record)["request"])->exposure_auto);
  EXPECT_FALSE(scan_request_from_json(json{{"exposure_ms", 3}})->exposure_auto);
}

TEST(ScanRequestJson, NamesWhatIsWrong) {
  struct Case {
    const char* body;
    const char* says;
  };
  const Case cases[] = {
      {R"([])", "JSON object"},
      {R"({"speed": 3})", "'speed' is not a field"},
      {R"({"elevations_deg": 30})", "elevations_deg is 30"},
      {R"({"elevations_deg": [0, 91]})", "from -90 to 90 degrees"},
      {R"({"elevations_deg": [10, 10.0]})", "different numbers"},
      {R"({"lifts_mm": [0, "up"]})", "lifts_mm is"},
      {R"({"lifts_mm": [1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17]})", "at most 16"},
      {R"({"name": "../../etc/passwd"})", "name is"},
      {R"({"name": ".hidden"})", "name is"},
      {R"({"name": 7})", "name is 7"},
      {R"({"mode": "fast"})", "mode is \"fast\""},
      {R"({"profiles": 15})", "profiles is 15; give a whole number from 16 to 100000"},
      {R"({"profiles": 18446744073709551615})", "profiles is 18446744073709551615"},
      {R"({"profiles": 100.5})", "profiles is 100.5"},
      {R"({"profiles": "100"})", "profiles is \"100\""},
      {R"({"exposure_ms": -1})", "exposure_ms is -1"},
      {R"({"exposure_ms": 1e300})", "exposure_ms"},
      {R"({"exposure_ms": "long"})", "exposure_ms is \"long\"; give \"auto\", or a number from 0 to 1000 ms"},
      {R"({"exposure_ms": "auto", "dry_turn": true})",
       "exposure_ms is \"auto\"; give a number of milliseconds with dry_turn"},
      {R"({"exposure_ms": "auto", "method": "stereo"})", "milliseconds with the method stereo"},
      {R"({"lasers": 1})", "lasers is 1; give \"all\" or a list"},
      {R"({"lasers": [0, 0]})", "lasers is [0,0]"},
      {R"({"lasers": [4]})", "lasers is 4"},
      {R"({"lasers": [-1]})", "lasers is -1"},
      {R"({"lasers": ["0"]})", "lasers is \"0\""},
      {R"({"shape": "ball"})", "shape is \"ball\"; give one of cylinder, sphere, composite, auto, none"},
      {R"({"shape": "none", "dry_turn": true})", "dry_turn foretells a surface"},
      {R"({"model": "sphere"})", "model is \"sphere\""},
      {R"({"tolerance_mm": true})", "tolerance_mm is true"},
      {R"({"form_tolerance_mm": -0.1})", "form_tolerance_mm is -0.1"},
      {R"({"degree_u": 0})", "degree_u is 0"},
      {R"({"degree_v": 6})", "degree_v is 6"},
      {R"({"formats": "step"})", "formats is \"step\""},
      {R"({"formats": ["iges"]})", "formats is \"iges\""},
  };
  for (const Case& c : cases) {
    const auto request = scan_request_from_json(json::parse(c.body));
    ASSERT_FALSE(request) << c.body;
    EXPECT_NE(request.error().detail.find(c.says), std::string::npos) << request.error().detail;
    EXPECT_GE(request.error().status, 400);
    EXPECT_LT(request.error().status, 500);
  }
  const auto longest = scan_request_from_json(json{{"name", std::string(65, 'a')}});
  EXPECT_FALSE(longest);
  EXPECT_TRUE(scan_request_from_json(json{{"name", std::string(64, 'a')}}));
}

// --- configuration ---

TEST(Config, ReadsEveryKey) {
  const TemporaryFolder folder;
  write_file(folder / "celadond.toml", R"(
device = "modbus-rtu:/dev/ttyUSB0"
camera = "v4l2:/dev/video0"
calibration = "/etc/celadon/calibration.toml"
store = "/var/lib/celadon"
log_level = "debug"
[button]
source = "evdev:/dev/input/event3:KEY_PROG1"
debounce_ms = 30
long_ms = 1500
short_press = "nothing"
long_press = "scan"
[http]
address = "127.0.0.1"
port = 8080
unix_socket = "/run/celadon.sock"
[scan]
profiles = 720
mode = "step"
formats = ["step", "ply"]
[volume]
r_min_mm = 1
r_max_mm = 100.5
z_min_mm = 2
z_max_mm = 200
[drive]
profile = "leadshine-rs"
io_profile = "io.toml"
io = "modbus-tcp://10.0.0.9"
serial = "3"
steps_per_turn = 4000
motor_turns_per_turn = -18.5
max_speed_deg_per_s = 60
max_acceleration_deg_per_s2 = 200
homing = "mark"
[motion]
lowest_deg = -10
highest_deg = 400.5
jerk_deg_per_s3 = 2000

[calibration_due]
days = 30
scans = 0
)");
  Config config;
  const auto read = read_config(folder / "celadond.toml", config);
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_TRUE(check_config(config));
  EXPECT_EQ(config.device, "modbus-rtu:/dev/ttyUSB0");
  EXPECT_EQ(config.button, "evdev:/dev/input/event3:KEY_PROG1");
  EXPECT_EQ(config.presses.timing.debounce_ns, 30'000'000);
  EXPECT_EQ(config.presses.timing.lasting_ns, 1'500'000'000);
  EXPECT_EQ(config.presses.brief, PressMeaning::nothing);
  EXPECT_EQ(config.presses.lasting, PressMeaning::scan);
  EXPECT_EQ(config.http_port, 8080);
  EXPECT_EQ(config.unix_socket, "/run/celadon.sock");
  EXPECT_EQ(config.scan.profiles, 720);
  EXPECT_EQ(config.scan.mode, ScanMode::step);
  EXPECT_EQ(config.volume.r_max_mm, 100.5);
  EXPECT_EQ(config.calibration_limits.days, 30);
  EXPECT_EQ(config.calibration_limits.scans, 0);
  ASSERT_TRUE(config.drive);
  EXPECT_EQ(config.drive->profile, "leadshine-rs");
  EXPECT_EQ(config.drive->io_profile, "io.toml");
  EXPECT_EQ(config.drive->io, "modbus-tcp://10.0.0.9");
  EXPECT_EQ(config.drive->serial, "3");
  EXPECT_EQ(config.drive->steps_per_turn, 4000);
  EXPECT_EQ(config.drive->motor_turns_per_turn, -18.5);
  EXPECT_EQ(config.drive->max_speed_deg_per_s, 60);
  EXPECT_EQ(config.drive->max_acceleration_deg_per_s2, 200);
  EXPECT_TRUE(config.drive->homes_at_mark);
  EXPECT_EQ(config.motion.lowest_deg, -10);
  EXPECT_EQ(config.motion.highest_deg, 400.5);
  EXPECT_EQ(config.motion.jerk_deg_per_s3, 2000);
  config.device = "usb:";
  EXPECT_NE(check_config(config).error().message.find("[drive] needs"), std::string::npos);
}

TEST(Config, NamesFileLineAndKey) {
  struct Case {
    const char* text;
    const char* says;
  };
  const Case cases[] = {
      {"device = 3\n", "line 1: device is not a text"},
      {"\ndevise = \"x\"\n", "line 2: 'devise' is not known"},
      {"[http]\nport = 70000\n", "line 2: http.port"},
      {"[http]\nhost = \"x\"\n", "http.host is not known"},
      {"[volume]\nr_max_mm = \"wide\"\n", "line 2: volume.r_max_mm"},
      {"[scan]\nprofiles = 3\n", "profiles is 3"},
      {"[scan]\nspeed = 3\n", "'speed'"},
      {"http = 3\n", "http is not a section"},
      {"[button]\nlong_ms = 100\n", "line 2: button.long_ms is no whole number of milliseconds from 300 to 60000"},
      {"[button]\nlong_press = \"dance\"\n", "line 2: button.long_press is not \"scan\""},
      {"[button]\nkey = 3\n", "button.key is not known"},
      {"device = \"unterminated\n", "line 1"},
      {"camera = \"x\"\nstore = \"/home/j\xC3\xB6rg\"\n", "line 2, column 17: holds the byte 0xC3"},
      {"[calibration_due]\ndays = -1\n", "line 2: calibration_due.days is no whole number from 0"},
      {"[calibration_due]\nhours = 1\n", "calibration_due.hours is not known"},
      {"[motion]\nsoft = 3\n", "line 2: motion.soft is not known"},
      {"[drive]\nprofile = 3\n", "drive.profile is not a text"},
      {"[drive]\nspeed = 3\n", "line 2: drive.speed is not known"},
      {"[drive]\nprofile = \"leadshine-rs\"\n", "[drive] lacks io_profile"},
      {"[drive]\nhoming = \"sensor\"\n", "write \"index\" or \"mark\""},
      {"[drive]\nmax_speed_deg_per_s = \"fast\"\n", "is not a number"},
  };
  for (const Case& c : cases) {
    const TemporaryFolder folder;
    write_file(folder / "c.toml", c.text);
    Config config;
    const auto read = read_config(folder / "c.toml", config);
    ASSERT_FALSE(read) << c.text;
    EXPECT_NE(read.error().message.find(c.says), std::string::npos) << read.error().message;
    EXPECT_NE(read.error().message.find("c.toml"), std::string::npos);
  }
  Config config;
  EXPECT_FALSE(read_config("/absent.toml", config));
}

TEST(Config, SaysWhatIsMissing) {
  Config config;
  EXPECT_NE(check_config(config).error().message.find("--device"), std::string::npos);
  config.device = "modbus-tcp://localhost";
  EXPECT_NE(check_config(config).error().message.find("--camera"), std::string::npos);
  config.camera = "webcam";
  EXPECT_NE(check_config(config).error().message.find("'webcam'"), std::string::npos);
  config.camera = "sim:/tmp/x";
  EXPECT_NE(check_config(config).error().message.find("--store"), std::string::npos);
  config.store = "s";
  EXPECT_TRUE(check_config(config));
  config.volume.r_max_mm = 0;
  EXPECT_NE(check_config(config).error().message.find("r_max_mm"), std::string::npos);
  Config recording;
  recording.camera = "replay:/tmp/x";
  EXPECT_NE(check_config(recording).error().message.find("--calibration"), std::string::npos);
}

// --- store ---

TEST(ScanStore, NumbersAreNeverUsedAgain) {
  const TemporaryFolder folder;
  {
    auto store = ScanStore::open(folder / "store");
    ASSERT_TRUE(store) << store.error().message;
    EXPECT_EQ(store->new_scan().value(), 1u);
    EXPECT_EQ(store->new_scan().value(), 2u);
    std::filesystem::remove_all(store->scan_folder(2));
  }
  auto store = ScanStore::open(folder / "store");
  ASSERT_TRUE(store);
  EXPECT_EQ(store->new_scan().value(), 3u);
}

TEST(ScanStore, OneDaemonAtATime) {
  const TemporaryFolder folder;
  const auto first = ScanStore::open(folder / "store");
  ASSERT_TRUE(first);
  const auto second = ScanStore::open(folder / "store");
  ASSERT_FALSE(second);
  EXPECT_NE(second.error().message.find("another celadond"), std::string::npos) << second.error().message;
}

TEST(ScanStore, ScansUnderWayBecomeInterruptedWithWhatTheirLogHolds) {
  const TemporaryFolder folder;
  {
    auto store = ScanStore::open(folder / "store");
    ASSERT_TRUE(store);
    ScanRecord record;
    record.id = *store->new_scan();
    record.state = ScanState::scanning;
    record.created = "2026-01-02T03:04:05Z";
    ASSERT_TRUE(store->save(record));
    auto log = ProfileLogWriter::create(store->log_file(record.id), {});
    Profile p;
    p.r_mm = {30, 30};
    p.theta_rad = p.z_mm = {1, 2};
    ASSERT_TRUE((*log)->append(p));
    record.id = *store->new_scan();
    record.state = ScanState::done;
    record.files = {"report.json"};
    ASSERT_TRUE(store->save(record));
  }
  for (int start = 0; start < 2; ++start) {  // and stays so
    auto store = ScanStore::open(folder / "store");
    std::vector<std::string> problems;
    const auto records = store->load(problems);
    EXPECT_TRUE(problems.empty());
    ASSERT_EQ(records.size(), 2u);
    EXPECT_EQ(records[0].state, ScanState::interrupted);
    EXPECT_NE(records[0].reason.find("1 profiles with 2 samples"), std::string::npos) << records[0].reason;
    EXPECT_EQ(records[1].state, ScanState::done);
    EXPECT_EQ(records[1].files, std::vector<std::string>{"report.json"});
    EXPECT_EQ(records[1].folder, folder / "store/scans/000002/results");
  }
}

TEST(ScanStore, DamagedRecordsAreLeftAloneAndNamed) {
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder / "store/scans/000007");
  std::filesystem::create_directories(folder / "store/scans/000008");
  write_file(folder / "store/scans/000007/scan.json", "{\"version\": 1, ");
  auto store = ScanStore::open(folder / "store");
  std::vector<std::string> problems;
  EXPECT_TRUE(store->load(problems).empty());
  ASSERT_EQ(problems.size(), 2u);
  EXPECT_NE((problems[0] + problems[1]).find("000007"), std::string::npos);
  EXPECT_EQ(testing::read_file(folder / "store/scans/000007/scan.json"), "{\"version\": 1, ");
  EXPECT_EQ(store->new_scan().value(), 9u);
}

}  // namespace
}  // namespace celadon
