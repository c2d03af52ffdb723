#include "daemon/export/step_characters.h"

#include <gtest/gtest.h>

#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <random>

#include "tests/daemon/step_reader.h"

namespace celadon {
namespace {

std::string shortest(const std::string& data) {
  return with_shortest_reals(data, "@N@", "it''s");
}

TEST(StepCharacters, RealsBecomeTheShortestThatReadBack) {
  EXPECT_EQ(shortest("#1=A((1.0000000000000001E-01,-2.5000000000000000E+00,\n  3.,0.,-0.,4.2000000000000000E+20));"),
            "#1=A((0.1,-2.5,\n  3.,0.,0.,4.2E+20));");
  EXPECT_EQ(shortest("A(1.E-07,9.9999999999999995E-08)"), "A(1.E-07,1.E-07)");
}

TEST(StepCharacters, IntegersReferencesAndStringsStay) {
  const std::string data = "#12 = B('1.500 -2.000',#34,5,(-6,7),.T.,$,*,'it''s 1.500',A2.5B);";
  EXPECT_EQ(shortest(data), data);
}

TEST(StepCharacters, MarkersInStringsAreReplaced) {
  EXPECT_EQ(shortest("P('@N@','x @N@',@N@,1.50)"), "P('it''s','x it''s',@N@,1.5)");
}

TEST(StepCharacters, EveryDoubleSurvives) {
  std::mt19937_64 engine(3);
  for (int i = 0; i < 100000; ++i) {
    const std::uint64_t bits = engine();
    double value = 0;
    std::memcpy(&value, &bits, sizeof value);
    if (!std::isfinite(value)) {
      continue;
    }
    char text[40];
    std::snprintf(text, sizeof text, "(%.16E)", value);
    const std::string written = shortest(text);
    double back = 0;
    const auto parsed = std::from_chars(written.data() + 1, written.data() + written.size(), back);
    ASSERT_EQ(*parsed.ptr, ')') << written;
    ASSERT_EQ(back, value) << written;
    ASSERT_NE(written.find('.'), std::string::npos) << written;
  }
}

TEST(StepCharacters, StringsUseTheBasicAlphabet) {
  EXPECT_EQ(step_string("plain (1)"), "plain (1)");
  EXPECT_EQ(step_string("it's a \\"), "it''s a \\\\");
  EXPECT_EQ(step_string("\xC3\xA9\n"), "\\X2\\00E9\\X0\\\\X2\\000A\\X0\\");
  EXPECT_EQ(step_string("\xF0\x9F\x8F\xBA"), "\\X4\\0001F3FA\\X0\\");
  EXPECT_EQ(step_string("a\xFF"
                        "b\xC3"),
            "a\\X2\\FFFD\\X0\\b\\X2\\FFFD\\X0\\");
}

/// The reader of the tests must be able to say no.
TEST(StepReader, RefusesWhatIsNotStep) {
  using testing::StepFile;
  const std::string head = "ISO-10303-21;\nHEADER;\nFILE_NAME('a''b\\X2\\00E9\\X0\\');\nENDSEC;\nDATA;\n";
  const std::string tail = "ENDSEC;\nEND-ISO-10303-21;\n";
  const StepFile good =
      StepFile::parse(head + "#1=(A(1.)B(#2,.T.));\n#2=C('x',(1,-2.5E-3),$,*,D(4.)); /* note */\n" + tail);
  EXPECT_EQ(good.header.at("FILE_NAME").arguments.at(0).string(), "a'b\xC3\xA9");
  EXPECT_EQ(good.at(1).record("B").arguments.at(0).id(), 2);
  EXPECT_EQ(good.at(2).records[0].arguments.at(1).list().at(1).real(), -2.5e-3);
  EXPECT_THROW(good.at(2).records[0].arguments.at(1).list().at(0).real(), std::runtime_error);
  for (const char* bad : {"#1=A(#9);\n", "#1=A(1);\n#1=A(2);\n", "#1=A(1\n", "#1=A(1.E);\n", "#1=A(.T);\n",
                          "#1=A('x);\n", "#1=A(1e5);\n", "#1=A(.5);\n", "#1=A('\xC3\xA9');\n"}) {
    EXPECT_THROW(StepFile::parse(head + bad + tail), std::runtime_error) << bad;
  }
}

}  // namespace
}  // namespace celadon
