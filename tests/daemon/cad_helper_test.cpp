// What the client says of a helper that is missing, crashes, hangs, or speaks another language.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdio>
#include <filesystem>

#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

/// The probe's answer with a shell script as celadon-cad on its PATH (none if empty).
std::string answer_with(const std::string& script, const std::string& time_limit_s = "60") {
  const testing::TemporaryFolder scratch;
  std::filesystem::create_directory(scratch.path() / "bin");
  if (!script.empty()) {
    const auto helper = scratch.write("bin/celadon-cad", "#!/bin/sh\n" + script + "\n");
    ::chmod(helper.c_str(), 0755);
  }
  const std::string command = "PATH=" + (scratch.path() / "bin").string() + " '" CELADON_CAD_PROBE "' " +
                              (scratch.path() / "out.step").string() + " " + time_limit_s;
  std::FILE* probe = ::popen(command.c_str(), "r");
  std::string answer;
  char buffer[512];
  while (std::fgets(buffer, sizeof buffer, probe) != nullptr) {
    answer += buffer;
  }
  ::pclose(probe);
  EXPECT_FALSE(std::filesystem::exists(scratch.path() / "out.step"));
  return answer;
}

TEST(CadHelper, MissingIsSaidWithTheRemedy) {
  EXPECT_THAT(answer_with(""),
              AllOf(HasSubstr("celadon-cad is not installed"), HasSubstr("libocct-data-exchange-dev")));
}

TEST(CadHelper, CrashIsContainedAndNamed) {
  EXPECT_THAT(answer_with("read line; kill -SEGV $$"), HasSubstr("was ended by signal 11 (Segmentation fault)"));
  EXPECT_THAT(answer_with("kill -ABRT $$"), HasSubstr("signal 6"));
}

TEST(CadHelper, EndWithoutAnswerIsNamed) {
  EXPECT_THAT(answer_with("exit 3"), HasSubstr("ended with exit code 3 without an answer"));
  EXPECT_THAT(answer_with("printf 'CELADON-CAD 2 200 10\\n{'"), HasSubstr("without an answer"));
}

TEST(CadHelper, HangIsEndedAtTheTimeLimit) {
  EXPECT_THAT(answer_with("read line; while :; do :; done", "1"), HasSubstr("did not answer within 1 s and was ended"));
}

TEST(CadHelper, AnotherLanguageIsRefused) {
  EXPECT_THAT(answer_with("echo hello; read line"), HasSubstr("answer of another kind"));
  EXPECT_THAT(answer_with("printf 'CELADON-CAD 2 2 0\\n[]'; read line"), HasSubstr("answer of another kind"));
}

TEST(CadHelper, ItsOwnErrorIsPassedOn) {
  EXPECT_THAT(answer_with("printf 'CELADON-CAD 2 20 0\\n{\"error\":\"no luck.\"} '; read line"),
              AllOf(HasSubstr("out.step: no luck."), HasSubstr("nothing was written")));
}

}  // namespace
}  // namespace celadon
