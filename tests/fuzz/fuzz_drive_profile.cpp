// libFuzzer target: any bytes as the profile of a drive or of an I/O device. Build and run: README.md of this folder.
// What is read must be usable: every count of every register survives its words, every action fits.

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "daemon/drive_profile_reader.h"

using namespace celadon;

namespace {

void check(bool good) {
  if (!good) std::abort();
}

void check_registers(const std::vector<DriveRegister>& registers, WordOrder order) {
  for (const DriveRegister& r : registers) {
    const std::array<std::uint16_t, 2> words = {0x8001, 0x7FFE};
    const std::int64_t count = get_count(r, order, words);
    check(in_range(r, count));
    std::array<std::uint16_t, 2> back = words;
    put_count(r, order, count, back);
    check(back == words);
    (void)count_of(r, quantity_of(r, count, 1000), 1000);
  }
}

void check_io(const std::string& text) {
  if (const auto io = parse_io_profile(text, "profile")) {
    check_registers(io->registers, io->word_order);
    check(!io->lasers.empty());
    (void)unconfirmed_for_safety(*io);
  } else {
    check(io.error().rfind("profile", 0) == 0);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  if (text.find("celadon-io") != std::string::npos) {
    check_io(text);
  } else if (const auto drive = parse_drive_profile(text, "profile")) {
    check_registers(drive->registers, drive->word_order);
    for (const DriveAction* action : {&drive->home, &drive->move, &drive->stop, &drive->mark, &drive->enable}) {
      for (const DriveWrite& write : *action) {
        check(write.reg < drive->registers.size());
        check(write.what != DriveWrite::What::constant || in_range(drive->registers[write.reg], write.constant));
      }
    }
    std::size_t polled = 0;
    for (const RegisterBlock& block : blocks_of(drive->registers, polled_registers(*drive))) {
      check(block.words <= 64);
      polled += block.registers.size();
    }
    check(polled == polled_registers(*drive).size());
    (void)unconfirmed_for_motion(*drive);
  } else {
    check(drive.error().rfind("profile", 0) == 0);
  }
  return 0;
}
