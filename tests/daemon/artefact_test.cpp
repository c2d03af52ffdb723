#include "daemon/checks/artefact.h"

#include <gtest/gtest.h>

namespace celadon {
namespace {

const std::string kHead = "format = \"celadon-artefact\"\nversion = \"1.0\"\nname = \"plate\"\n";
const std::string kBalls =
    "[[sphere]]\nname = \"A\"\ncentre_mm = [40, 0, 30]\ndiameter = { value = 30.001, u = 0.0005 }\nform_mm = 0.0002\n"
    "[[sphere]]\nname = \"B\"\ncentre_mm = [-40, 0, 30]\ndiameter = { value = 25, u = 0 }\n";
const std::string kSpacing = "[[spacing]]\nbetween = [\"A\", \"B\"]\ndistance = { value = 80.01, u = 0.001 }\n";

std::string error_of(const std::string& text) {
  const auto parsed = parse_artefact(text, "artefact test");
  return parsed ? "no error" : parsed.error();
}

TEST(Artefact, AFileIsReadAsWritten) {
  const auto artefact = parse_artefact(kHead + "certificate = \"X 12\"\n" + kBalls + kSpacing +
                                           "[flat]\ncentre_mm = [0, 40, 30]\nnormal = [0, 1, 0]\nwidth_mm = 20\n"
                                           "height_mm = 30\nform_mm = 0.001\n[permissible]\nsize_mm = 0.05\n",
                                       "artefact test");
  ASSERT_TRUE(artefact) << artefact.error();
  EXPECT_EQ(artefact->name, "plate");
  EXPECT_EQ(artefact->certificate, "X 12");
  ASSERT_EQ(artefact->spheres.size(), 2u);
  EXPECT_EQ(artefact->spheres[0].diameter, (Measured{30.001, 0.0005}));
  EXPECT_EQ(artefact->spheres[0].form_mm, 0.0002);
  EXPECT_EQ(artefact->spheres[1].form_mm, 0);
  ASSERT_EQ(artefact->spacings.size(), 1u);
  EXPECT_EQ(artefact->spacings[0].second, 1u);
  EXPECT_EQ(artefact->spacings[0].distance, (Measured{80.01, 0.001}));
  EXPECT_EQ(artefact->flat->height_mm, 30);
  EXPECT_EQ(artefact->permissible.of(Characteristic::size), 0.05);
  EXPECT_FALSE(artefact->permissible.of(Characteristic::form));
}

// Each error has the line, the field, what is wrong and what to do.
TEST(Artefact, WrongFilesAreNamedByLineAndRemedy) {
  const auto with = [](std::string text, const std::string& what, const std::string& by) {
    text.replace(text.find(what), what.size(), by);
    return text;
  };
  const std::string good = kHead + kBalls + kSpacing;
  EXPECT_EQ(error_of(good), "no error");
  const std::pair<std::string, std::vector<const char*>> cases[] = {
      {with(good, "celadon-artefact", "celadon-calibration"), {"line 1", "format", "give the file of an artefact"}},
      {with(good, "\"1.0\"", "\"2.0\""), {"line 2", "version", "2.0"}},
      {with(good, "u = 0.0005", "u = -0.0005"), {"line 7", "u", "negative"}},
      {with(good, "30.001", "0.3"), {"line 7", "diameter", "1 to 1000 mm"}},
      {with(good, "form_mm = 0.0002", "form_mm = -1.0"), {"line 8", "form_mm", "-1", "0 mm or more"}},
      {with(good, "form_mm", "from_mm"), {"line 8", "from_mm", "spelling"}},
      {with(good, "name = \"B\"", "name = \"A\""), {"line 10", "name", "earlier sphere"}},
      {with(good, "[\"A\", \"B\"]", "[\"A\", \"C\"]"), {"line 14", "between", "\"C\"", "correct the name"}},
      {with(good, "[\"A\", \"B\"]", "[\"A\", \"A\"]"), {"line 14", "two different spheres"}},
      {with(good, "80.01", "85"), {"line 15", "85", "80.0 mm apart"}},
      {good + kSpacing, {"line 17", "between", "earlier spacing"}},
      {good + "[permissible]\nsize_mm = 0\n", {"line 17", "size_mm", "above 0"}},
      {good + "[flat]\ncentre_mm = [0, 40, 30]\nnormal = [0, 2, 0]\nwidth_mm = 20\nheight_mm = 30\n",
       {"line 18", "normal", "2.0"}},
      {good + "[flat]\ncentre_mm = [0, 40, 30]\nnormal = [0, 1, 0]\nwidth_mm = 20\n", {"height_mm", "ARTEFACT.md"}},
      {kHead + kBalls.substr(0, kBalls.find("[[sphere]]", 3)), {"1 spheres", "2 to 32"}},
      {kHead + "sphere = 3\n", {"line 4", "[[sphere]]"}},
      {kHead + "name = \n", {"line 4"}},
  };
  for (const auto& [text, words] : cases) {
    const std::string error = error_of(text);
    for (const char* word : words) EXPECT_NE(error.find(word), std::string::npos) << error << " lacks " << word;
  }
  EXPECT_NE(read_artefact("/no/such/file").error().find("/no/such/file"), std::string::npos);
}

TEST(Artefact, ANewerMinorVersionMayHaveMoreKeys) {
  std::string text = kHead + kBalls;
  text.replace(text.find("1.0"), 3, "1.7");
  EXPECT_TRUE(parse_artefact(text + "[[cone]]\nangle = 3\n", "artefact test"));
  EXPECT_FALSE(parse_artefact(kHead + kBalls + "[[cone]]\nangle = 3\n", "artefact test"));
}

TEST(Artefact, PermissibleErrorsAreRead) {
  PermissibleErrors permissible;
  permissible.of(Characteristic::size) = 1;
  ASSERT_TRUE(parse_permissible("size=0.05,flatness95=0.2", permissible));
  EXPECT_EQ(permissible.of(Characteristic::size), 0.05);
  EXPECT_EQ(permissible.of(Characteristic::flatness95), 0.2);
  EXPECT_FALSE(permissible.of(Characteristic::spacing));
  for (const char* wrong : {"", "size", "size=", "size=0", "size=-1", "size=a", "size=1x", "length=1", "size=1,size=2",
                            "size=1,", "size=inf"}) {
    EXPECT_FALSE(parse_permissible(wrong, permissible)) << wrong;
  }
}

}  // namespace
}  // namespace celadon
