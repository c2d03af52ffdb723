// celadon board, as a user runs it.
#include <gtest/gtest.h>

#include "tests/integration/process.h"
#include "tests/temporary_folder.h"

namespace celadon::testing {
namespace {

TEST(BoardCommand, WritesSheetsAndRefusesWhatIsNone) {
  const TemporaryFolder folder;
  for (const auto& [name, begin] : {std::pair{"board.svg", "<svg "}, {"board.pdf", "%PDF-1.4"}}) {
    const Outcome outcome = run({"celadon", "board", "tags:10x7x12", "-o", (folder / name).string()});
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_NE(outcome.out.find("on A4, 297 x 210 mm"), std::string::npos) << outcome.out;
    EXPECT_EQ(read_file(folder / name).rfind(begin, 0), 0u);
  }
  for (const auto& [board, file, words] : {std::tuple{"chessboard:11x9x8", "a.svg", "upside down"},
                                           {"chessboard:12x9x100", "a.pdf", "1200 x 900 mm"},
                                           {"tags:10x7x12", "a.png", ".svg or .pdf"}}) {
    const Outcome outcome = run({"celadon", "board", board, "-o", (folder / file).string()});
    EXPECT_EQ(outcome.exit_code, 2);
    EXPECT_NE(outcome.err.find(words), std::string::npos) << outcome.err;
    EXPECT_FALSE(std::filesystem::exists(folder / file));
  }
  EXPECT_EQ(run({"celadon", "board", "tags:10x7x12", "-o", (folder / "none" / "a.svg").string()}).exit_code, 4);
}

}  // namespace
}  // namespace celadon::testing
