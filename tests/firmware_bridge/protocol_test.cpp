#include "firmware_bridge/usb_protocol.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "tests/build_paths.h"
namespace celadon::protocol {
namespace {

// ---- the document and the header say the same ----

struct Row {
  std::string section;
  std::vector<std::string> cells;
};

std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(' ');
  return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(' ') - first + 1);
}

std::vector<std::string> document_lines() {
  std::ifstream file(CELADON_SOURCE_DIR "/firmware_bridge/PROTOCOL.md");
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  return lines;
}

// Table rows that begin with a number, each with the heading above it.
std::vector<Row> document_rows() {
  std::vector<Row> rows;
  std::string section;
  for (const std::string& line : document_lines()) {
    if (line.starts_with('#')) section = trimmed(line.substr(line.find_first_not_of('#')));
    if (!line.starts_with("| ") || !std::isdigit(line[2])) continue;
    Row row{section, {}};
    std::istringstream cells(line.substr(1));
    for (std::string cell; std::getline(cells, cell, '|');) row.cells.push_back(trimmed(cell));
    rows.push_back(row);
  }
  return rows;
}

std::string type_text(const Register& r) {
  static const char* names[] = {"u16", "u32", "s32", "u64", "text"};
  const std::string name = names[static_cast<int>(r.type)];
  return r.count == 1 ? name : name + "[" + std::to_string(r.count) + "]";
}

std::string hex4(int value) {
  char text[8];
  std::snprintf(text, sizeof text, "0x%04X", static_cast<unsigned>(value));
  return text;
}

std::string group_heading(const Group& g) {
  std::string text = std::string(g.name) + ": " + (g.area == Area::input ? "input" : "holding") + " registers " +
                     hex4(g.base) + ", " + std::to_string(g.words) + " registers";
  if (g.repeats > 1) text += ", stride " + std::to_string(g.words);
  return text;
}

TEST(ProtocolDocument, ListsExactlyTheRegistersOfTheHeader) {
  std::vector<std::string> documented, coded;
  for (const Row& row : document_rows()) {
    if (row.section.find(" registers 0x") == std::string::npos) continue;
    ASSERT_EQ(row.cells.size(), 5u) << row.cells[0];
    const std::string group = row.section.substr(0, row.section.find(':'));
    documented.push_back(row.cells[0] + " " + group + "." + row.cells[1] + " " + row.cells[2] + " " + row.cells[3]);
  }
  for (const Register& r : kRegisters)
    coded.push_back(hex4(r.address()) + " " + r.group.name + "." + r.name + " " + type_text(r) + " " + r.unit);
  EXPECT_EQ(documented, coded);
}

TEST(ProtocolDocument, HeadsEachGroupWithItsAddresses) {
  std::vector<std::string> headings;
  for (const std::string& line : document_lines()) {
    const std::regex heading(R"(### (\w+: (input|holding) registers 0x[0-9A-F]{4}, \d+ registers(, stride \d+)?).*)");
    std::smatch match;
    if (std::regex_match(line, match, heading)) headings.push_back(match[1]);
  }
  std::vector<std::string> expected;
  for (const Group& g : kGroups) expected.push_back(group_heading(g));
  // A stride is part of the longest match, so the comparison sees it.
  EXPECT_EQ(headings, expected);
}

template <std::size_t N>
void expect_codes(const std::string& section, const Code (&table)[N]) {
  std::vector<std::string> documented, coded;
  for (const Row& row : document_rows()) {
    if (row.section == section) documented.push_back(row.cells[0] + "|" + row.cells[1] + "|" + row.cells[2]);
  }
  for (const Code& code : table) coded.push_back(std::to_string(code.value) + "|" + code.name + "|" + code.meaning);
  EXPECT_EQ(documented, coded) << section;
}

TEST(ProtocolDocument, ListsExactlyTheCodesOfTheHeader) {
  expect_codes("4. Motion", kMotionStates);
  expect_codes("5. Lamp", kLampPatterns);
  expect_codes("6. Fault codes", kFaultCodes);
  expect_codes("7. Refusals", kRefusals);
}

TEST(ProtocolDocument, ListsExactlyTheUsbRequestsOfTheHeader) {
  std::vector<std::string> documented, coded;
  for (const Row& row : document_rows()) {
    if (row.section.rfind("Requests:", 0) != 0) continue;
    ASSERT_EQ(row.cells.size(), 4u);
    documented.push_back(row.cells[0] + "|" + row.cells[1] + "|" + row.cells[2] + "|" + row.cells[3]);
  }
#define CELADON_USB_ROW(name, value, direction, meaning) \
  coded.push_back(std::to_string(value) + "|" #name "|" direction "|" meaning);
  CELADON_USB_REQUESTS(CELADON_USB_ROW)
#undef CELADON_USB_ROW
  EXPECT_EQ(documented, coded);
}

template <std::size_t N>
void expect_record(const std::string& heading, const Register (&record)[N]) {
  std::vector<std::string> documented, coded;
  for (const Row& row : document_rows()) {
    if (row.section == heading) documented.push_back(row.cells[0] + " " + row.cells[1]);
  }
  for (const Register& r : record)
    coded.push_back(std::to_string(2 * usb::offset_of(record, r)) + " " + r.group.name + "." + r.name);
  EXPECT_EQ(documented, coded) << heading;
}

TEST(ProtocolDocument, ListsExactlyTheUsbRecordsOfTheHeader) {
  expect_record("Event: interrupt IN, " + std::to_string(usb::kEventBytes) + " bytes", usb::kEventRegisters);
  expect_record("Trace: bulk IN, whole records of " + std::to_string(usb::kTraceBytes) + " bytes",
                usb::kTraceRegisters);
}

TEST(ProtocolDocument, NamesTheVersionOfTheHeader) {
  EXPECT_EQ(document_lines().at(0),
            "# The device protocol, version " + std::to_string(kMajor) + "." + std::to_string(kMinor));
}

TEST(ProtocolDocument, SaysWhatIsNoSafetyFunction) {
  std::string all;
  for (const std::string& line : document_lines()) all += line + " ";
  EXPECT_NE(all.find("Nothing here is a safety function"), std::string::npos);
  EXPECT_NE(all.find("A reset never restarts"), std::string::npos);
  EXPECT_NE(all.find("never called emergency stop"), std::string::npos);
}

// ---- words and values ----

TEST(ProtocolWords, HighWordComesFirst) {
  std::uint16_t words[4];
  put_u32(words, 0x12345678);
  EXPECT_EQ(words[0], 0x1234);
  EXPECT_EQ(words[1], 0x5678);
  put_s32(words, -2);
  EXPECT_EQ(words[0], 0xFFFF);
  EXPECT_EQ(words[1], 0xFFFE);
  EXPECT_EQ(get_s32(words), -2);
  put_u64(words, 0x0123456789ABCDEF);
  EXPECT_EQ(words[0], 0x0123);
  EXPECT_EQ(words[3], 0xCDEF);
  EXPECT_EQ(get_u64(words), 0x0123456789ABCDEFu);
}

TEST(ProtocolWords, AnglesOverManyTurnsSplitAndJoin) {
  EXPECT_EQ(split_turns(0).turns, 0);
  EXPECT_EQ(split_turns(-1).turns, -1);
  EXPECT_EQ(split_turns(-1).angle_udeg, 359'999'999);
  EXPECT_EQ(split_turns(-360'000'000).turns, -1);
  EXPECT_EQ(split_turns(-360'000'000).angle_udeg, 0);
  EXPECT_EQ(split_turns(725'000'001).turns, 2);
  EXPECT_EQ(split_turns(725'000'001).angle_udeg, 5'000'001);
  EXPECT_EQ(join_turns(-90'000'000, 0), -90'000'000);
  EXPECT_EQ(join_turns(270'000'000, -1), -90'000'000);
  for (const std::int64_t position :
       std::initializer_list<std::int64_t>{-386'547'056'640'000'000, -5, 0, 359'999'999, 386'547'056'640'000'000}) {
    const SplitAngle s = split_turns(position);
    EXPECT_EQ(join_turns(s.angle_udeg, s.turns), position);
    EXPECT_GE(s.angle_udeg, 0);
    EXPECT_LT(s.angle_udeg, 360'000'000);
  }
}

// The light times of a pattern, from its printed text, against the function.
TEST(ProtocolLamp, BlinksAsPrinted) {
  for (const Code& code : kLampPatterns) {
    const auto pattern = static_cast<LampPattern>(code.value);
    const std::string text = code.meaning;
    if (text == "dark" || text == "steady") {
      for (std::uint64_t us = 0; us < 3'000'000; us += 7'000) EXPECT_EQ(lamp_lit(pattern, us), text == "steady");
      continue;
    }
    std::vector<std::pair<bool, std::uint64_t>> phases;
    std::uint64_t period_us = 0;
    const std::regex phase(R"((on|off) ([0-9.]+) s)");
    for (std::sregex_iterator it(text.begin(), text.end(), phase), end; it != end; ++it) {
      const auto us = static_cast<std::uint64_t>(std::llround(std::stod((*it)[2]) * 1e6));
      phases.emplace_back((*it)[1] == "on", us);
      period_us += us;
    }
    ASSERT_FALSE(phases.empty()) << text;
    for (std::uint64_t us = 500; us < 2 * period_us; us += 1'000) {
      std::uint64_t at = us % period_us;
      std::size_t i = 0;
      while (at >= phases[i].second) at -= phases[i++].second;
      ASSERT_EQ(lamp_lit(pattern, us), phases[i].first) << code.name << " at " << us << " us";
    }
  }
}

// ---- the device side needs no operating system ----

std::string output_of(const std::string& command, int& status) {
  std::string text;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  char buffer[256];
  while (pipe != nullptr && std::fgets(buffer, sizeof buffer, pipe) != nullptr) text += buffer;
  status = pipe != nullptr ? pclose(pipe) : -1;
  return text;
}

// No floating-point register may be touched, and nothing be called but the four that every compiler wants.
TEST(ControllerCoreBuild, CompilesFreestandingWithoutFloatingPoint) {
  for (const std::string name : {"controller_core", "controller_registers", "controller_usb"}) {
    const std::string object = testing::TempDir() + "celadon_" + name + "_" + std::to_string(getpid()) + ".o";
    int status = 0;
    const std::string compiled = output_of(
        std::string(CELADON_CXX) +
            " -std=c++20 -O2 -Wall -Wextra -Wconversion -Wshadow -Werror -ffreestanding -fno-exceptions -fno-rtti"
            " -mgeneral-regs-only -I" CELADON_SOURCE_DIR " -c " CELADON_SOURCE_DIR "/firmware_bridge/" +
            name + ".cpp -o " + object,
        status);
    ASSERT_EQ(status, 0) << compiled;
    std::istringstream symbols(output_of("nm -u -C " + object, status));
    ASSERT_EQ(status, 0);
    for (std::string line; std::getline(symbols, line);) {
      const std::string symbol = trimmed(line.substr(line.find('U') + 1));
      const bool known = symbol == "memcpy" || symbol == "memset" || symbol == "memmove" || symbol == "memcmp" ||
                         symbol.rfind("celadon::ControllerCore::", 0) == 0 ||
                         symbol.rfind("celadon::ControllerUsb::", 0) == 0;
      EXPECT_TRUE(known) << name << " needs " << symbol;
    }
    std::remove(object.c_str());
  }
}

}  // namespace
}  // namespace celadon::protocol
