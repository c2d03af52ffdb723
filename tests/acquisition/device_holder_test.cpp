#include "acquisition/device_holder.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/temporary_folder.h"

namespace celadon {
namespace {

TEST(DeviceHolder, NamesTheProcessThatHasItOpenAndNoOther) {
  const testing::TemporaryFolder folder;
  const std::string file = folder.write("device", "");
  const int mine = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  EXPECT_EQ(holders_of(file), "") << "this process does not count";
  int ready[2], over[2];
  ASSERT_EQ(::pipe2(ready, O_CLOEXEC) | ::pipe2(over, O_CLOEXEC), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    char byte = 0;
    ::close(over[1]);
    const bool good = ::open(file.c_str(), O_RDONLY) >= 0 && ::write(ready[1], &byte, 1) == 1;
    static_cast<void>(::read(over[0], &byte, 1) == 0);  // until the parent is done
    ::_exit(good ? 0 : 1);
  }
  char byte = 0;
  ASSERT_EQ(::read(ready[0], &byte, 1), 1);
  const std::string holders = holders_of(file);
  EXPECT_TRUE(holders.starts_with("process " + std::to_string(child) + " (")) << holders;
  EXPECT_EQ(holders_of(folder / "nothing"), "");
  ::close(over[1]);
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(holders_of(file), "");
  ::close(mine);
}

}  // namespace
}  // namespace celadon
