// The edges between the folders, taken from the includes: README.md of the project, "Layout". A planted edge must be
// found.

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include "tests/build_paths.h"

namespace {

namespace fs = std::filesystem;

struct Include {
  std::string from, to;  // file of the project, text between the brackets or quotes
};

bool starts_with(const std::string& text, const std::string& prefix) {
  return text.rfind(prefix, 0) == 0;
}
bool within_any(const std::string& path, const std::vector<std::string>& prefixes) {
  return std::any_of(prefixes.begin(), prefixes.end(), [&](const auto& p) { return starts_with(path, p); });
}

std::vector<Include> includes_of(const fs::path& root) {
  std::vector<Include> found;
  const std::regex pattern(R"(^\s*#\s*include\s*[<"]([^>"]+)[>"])");
  for (const char* folder : {"fitting", "acquisition", "firmware_bridge", "sim", "daemon", "tests"}) {
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      const auto extension = entry.path().extension();
      if (extension != ".cpp" && extension != ".h") continue;
      std::ifstream in(entry.path());
      for (std::string line; std::getline(in, line);) {
        std::smatch match;
        if (std::regex_search(line, match, pattern)) found.push_back({fs::relative(entry.path(), root), match[1]});
      }
    }
  }
  return found;
}

// Which headers of the project a folder may include besides its own; anything inside the project not listed is an edge
// that does not exist.
const std::map<std::string, std::vector<std::string>>& allowed() {
  static const std::map<std::string, std::vector<std::string>> edges = {
      {"fitting/", {}},
      {"firmware_bridge/", {}},
      {"acquisition/", {"fitting/profile.h"}},
      {"sim/",
       {"firmware_bridge/protocol.h", "firmware_bridge/controller_core.h", "firmware_bridge/controller_usb.h",
        "firmware_bridge/usb_protocol.h", "acquisition/frame.h", "acquisition/frame_ring.h",
        "acquisition/calibration.h", "daemon/files/"}},
      {"daemon/files/", {"fitting/"}},
      {"daemon/", {"acquisition/", "firmware_bridge/", "fitting/"}},
  };
  return edges;
}

struct Confined {
  const char* header;
  bool prefix;  // header is the beginning of a family's names
  std::vector<std::string> folders;
};
const std::vector<Confined>& confined() {
  static const std::vector<Confined> rules = {
      {"linux/videodev2.h", false, {"acquisition/", "sim/", "tests/"}},
      {"modbus.h", false, {"firmware_bridge/", "sim/", "tests/"}},
      {"modbus/", true, {"firmware_bridge/", "sim/", "tests/"}},
      {"libusb", true, {"firmware_bridge/", "sim/", "tests/"}},
      {"libevdev/", true, {"firmware_bridge/", "tests/"}},
      {"gpiod.h", false, {"firmware_bridge/", "tests/"}},
      {"boost/", true, {"daemon/http/", "tests/daemon/"}},
      {"opencv2/videoio", true, {}},
      {"opencv2/highgui", true, {}},
      {"opencv2/imgcodecs", true, {}},
      {"thread", false, {"daemon/", "sim/", "tests/"}},
      {"immintrin.h", false, {}},
      {"arm_neon.h", false, {}},
  };
  return rules;
}

std::vector<std::string> violations(const std::vector<Include>& includes) {
  const std::vector<std::string> folders = {"fitting/", "acquisition/", "firmware_bridge/", "sim/", "daemon/"};
  std::vector<std::string> bad;
  for (const auto& [from, to] : includes) {
    for (const auto& rule : confined()) {
      if ((rule.prefix ? starts_with(to, rule.header) : to == rule.header) && !within_any(from, rule.folders))
        bad.push_back(from + " includes <" + to + ">");
    }
    static const std::regex cad_header(
        R"(^(BRep|STEP|TopoDS|Geom_|gp_|Standard_|XSControl|Interface_Static)[A-Za-z_]*\.hxx$)");
    if (std::regex_match(to, cad_header) && !within_any(from, {"daemon/export/", "tests/daemon/"})) {
      bad.push_back(from + " includes OpenCASCADE's " + to);
    }
    if (starts_with(from, "tests/") || !within_any(to, folders)) continue;
    // The longest matching row applies: daemon/files/ before daemon/.
    const std::string* row = nullptr;
    for (const auto& [folder, targets] : allowed()) {
      if (starts_with(from, folder) && (row == nullptr || folder.size() > row->size())) row = &folder;
    }
    if (!starts_with(to, *row) && !within_any(to, allowed().at(*row))) bad.push_back(from + " includes " + to);
  }
  return bad;
}

TEST(Edges, OnlyThoseOfTheArchitectureExist) {
  const auto includes = includes_of(CELADON_SOURCE_DIR);
  ASSERT_GT(includes.size(), 100u);
  for (const auto& line : violations(includes)) ADD_FAILURE() << line;
}

TEST(Edges, PlantedOnesAreFound) {
  for (const Include& planted : std::vector<Include>{{"fitting/knots.cpp", "acquisition/frame.h"},
                                                     {"firmware_bridge/protocol.h", "fitting/profile.h"},
                                                     {"acquisition/triangulation.cpp", "fitting/range_fit.h"},
                                                     {"acquisition/frame.h", "sim/scene.h"},
                                                     {"daemon/scan_job.cpp", "sim/scene.h"},
                                                     {"sim/optics.cpp", "acquisition/triangulation.h"},
                                                     {"daemon/files/cloud_files.cpp", "daemon/results.h"},
                                                     {"daemon/scan_job.cpp", "modbus.h"},
                                                     {"daemon/main.cpp", "linux/videodev2.h"},
                                                     {"daemon/scan_queue.cpp", "boost/beast.hpp"},
                                                     {"fitting/range_fit.cpp", "thread"},
                                                     {"daemon/results.cpp", "STEPControl_Writer.hxx"},
                                                     {"acquisition/laser_line.cpp", "immintrin.h"},
                                                     {"daemon/cli/line.cpp", "opencv2/imgcodecs.hpp"}}) {
    EXPECT_EQ(violations({planted}).size(), 1u) << planted.from << " -> " << planted.to;
  }
}

// Beside the sources, what the README's two commands make: build/ and celadon-demo/, both ignored by git.
TEST(Edges, TopLevelHoldsOnlyWhatTheLayoutNames) {
  const std::set<std::string> named = {"CMakeLists.txt",
                                       "CMakePresets.json",
                                       "README.md",
                                       "CHANGELOG.md",
                                       "LICENSE",
                                       "acquisition",
                                       "cmake",
                                       "daemon",
                                       "debian",
                                       "celadon-demo",
                                       "firmware_bridge",
                                       "fitting",
                                       "sim",
                                       "tests",
                                       "tools",
                                       "build"};
  for (const auto& entry : fs::directory_iterator(CELADON_SOURCE_DIR)) {
    const std::string name = entry.path().filename();
    EXPECT_TRUE(name[0] == '.' || named.count(name) == 1) << name << " stands at the top level";
  }
}

}  // namespace
