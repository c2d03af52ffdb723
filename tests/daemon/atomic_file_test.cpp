#include "daemon/files/atomic_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <thread>
#include <vector>

#include "daemon/files/file_problem.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using ::testing::HasSubstr;

std::size_t entries(const std::filesystem::path& folder) {
  return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder), {}));
}

TEST(AtomicFile, WritesAndReplacesWhole) {
  const testing::TemporaryFolder scratch;
  const auto file = scratch.path() / "a.bin";
  const std::string first(3'000'000, 'x');
  ASSERT_TRUE(write_file_atomically(file, first));
  EXPECT_EQ(testing::read_file(file), first);
  ASSERT_TRUE(write_file_atomically(file, ""));
  EXPECT_EQ(testing::read_file(file), "");
  EXPECT_EQ(entries(scratch.path()), 1U);
}

TEST(AtomicFile, HasTheUsualPermissions) {
  const testing::TemporaryFolder scratch;
  const mode_t mask = ::umask(027);
  ASSERT_TRUE(write_file_atomically(scratch.path() / "a", "x"));
  ::umask(mask);
  struct stat status {};
  ASSERT_EQ(::stat((scratch.path() / "a").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777U, 0640U);
}

TEST(AtomicFile, NamesFolderAndRemedy) {
  const testing::TemporaryFolder scratch;
  const auto missing = write_file_atomically(scratch.path() / "no" / "a", "x");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().errno_value, ENOENT);
  EXPECT_THAT(missing.error().message, HasSubstr("no/a: No such file or directory; check the name and the folder"));
  const auto folder = write_file_atomically(scratch.path(), "x");
  ASSERT_FALSE(folder);
  EXPECT_EQ(folder.error().errno_value, EISDIR);
  EXPECT_EQ(write_file_atomically("/proc/none", "x").error().errno_value, ENOENT);
}

/// A write that fails in the middle, in a process of its own because the limit cannot be lifted again.
TEST(AtomicFile, AWriteThatFailsLeavesTheOldFileAndNothingElse) {
  const testing::TemporaryFolder scratch;
  const auto file = scratch.write("a", "old");
  const pid_t child = ::fork();
  if (child == 0) {
    ::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{100'000, 100'000};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    const auto written = write_file_atomically(file, std::string(200'000, 'x'));
    const bool said = !written && written.error().errno_value == EFBIG &&
                      written.error().message.find("ulimit -f") != std::string::npos;
    ::_exit(said ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  EXPECT_EQ(testing::read_file(file), "old");
  EXPECT_EQ(entries(scratch.path()), 1U);
}

TEST(AtomicFile, ReadersSeeOneOrTheOther) {
  const testing::TemporaryFolder scratch;
  const auto file = scratch.path() / "a";
  const std::string one(100'000, '1');
  const std::string two(100'000, '2');
  ASSERT_TRUE(write_file_atomically(file, one));
  std::atomic<bool> done{false};
  std::vector<std::thread> writers;
  for (const std::string* content : {&one, &two}) {
    writers.emplace_back([&, content] {
      for (int i = 0; i < 20; ++i) {
        ASSERT_TRUE(write_file_atomically(file, *content));
      }
      done = true;
    });
  }
  while (!done) {
    const std::string seen = testing::read_file(file);
    ASSERT_TRUE(seen == one || seen == two);
  }
  for (std::thread& writer : writers) {
    writer.join();
  }
  EXPECT_EQ(entries(scratch.path()), 1U);
}

TEST(FileProblem, SaysCauseAndRemedy) {
  EXPECT_EQ(
      file_problem("cannot write", "a.step", ENOSPC),
      "cannot write a.step: No space left on device; free some space or choose another disk; nothing was left under "
      "the final name");
  EXPECT_THAT(file_problem("cannot open", "a", EACCES), HasSubstr("check its permissions"));
}

TEST(FileProblem, GroupsDigits) {
  EXPECT_EQ(grouped(0), "0");
  EXPECT_EQ(grouped(999), "999");
  EXPECT_EQ(grouped(1000), "1 000");
  EXPECT_EQ(grouped(1000000000000), "1 000 000 000 000");
}

}  // namespace
}  // namespace celadon
