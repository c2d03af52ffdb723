// Clouds of coloured samples, read back by two other readers: one of the test's own, and that of clouds to be fitted.
#include "daemon/files/sample_cloud.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <random>

#include "daemon/files/cloud_files.h"
#include "tests/daemon/ply_points.h"
#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::read_file;
using testing::read_ply_points;
using testing::TemporaryFolder;

class Profiles final : public ProfileStream {
 public:
  void rewind() override { next_ = 0; }
  const Profile* next() override { return next_ < profiles.size() ? &profiles[next_++] : nullptr; }
  std::vector<Profile> profiles;

 private:
  std::size_t next_ = 0;
};

Profiles random_profiles(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> r(5, 60), theta(0, 6.28), z(0, 120);
  std::uniform_int_distribution<int> level(0, 255), size(0, 40);
  Profiles out;
  for (int i = 0; i < 30; ++i) {
    Profile p;
    const int n = size(random);
    for (int k = 0; k < n; ++k) {
      p.r_mm.push_back(r(random));
      p.theta_rad.push_back(theta(random));
      p.z_mm.push_back(z(random));
      const auto draw = [&] { return static_cast<std::uint8_t>(level(random)); };
      if (i % 4 != 0) p.colour.push_back(k % 5 == 0 ? SampleColour() : SampleColour{draw(), draw(), draw()});
    }
    out.profiles.push_back(std::move(p));
  }
  return out;
}

TEST(SampleCloud, ComesBackPointByPoint) {
  for (unsigned seed = 1; seed < 20; ++seed) {
    const TemporaryFolder folder;
    Profiles samples = random_profiles(seed);
    const auto cloud = write_coloured_samples(samples, "SIMULATED of a test", folder / "a.ply");
    ASSERT_TRUE(cloud) << cloud.error().message;
    const std::string bytes = read_file(folder / "a.ply");
    EXPECT_NE(bytes.find("comment SIMULATED of a test\n"), std::string::npos);
    const auto columns = read_ply_points(bytes);
    std::size_t at = 0, coloured = 0;
    for (const Profile& p : samples.profiles) {
      for (std::size_t k = 0; k < p.size(); ++k, ++at) {
        ASSERT_NEAR(columns.at("x").at(at), p.r_mm[k] * std::cos(p.theta_rad[k]), 1e-5);
        ASSERT_NEAR(columns.at("y").at(at), p.r_mm[k] * std::sin(p.theta_rad[k]), 1e-5);
        ASSERT_NEAR(columns.at("z").at(at), p.z_mm[k], 1e-5);
        const SampleColour colour = p.colour.empty() ? SampleColour() : p.colour[k];
        ASSERT_EQ(columns.at("red").at(at), colour.red);
        ASSERT_EQ(columns.at("green").at(at), colour.green);
        ASSERT_EQ(columns.at("blue").at(at), colour.blue);
        coloured += colour.known();
      }
    }
    EXPECT_EQ(columns.at("x").size(), at);
    EXPECT_EQ(cloud->points, at);
    EXPECT_EQ(cloud->coloured, coloured);

    auto other = open_cloud(folder / "a.ply", {});
    ASSERT_TRUE(other) << other.error().message;
    std::size_t points = 0;
    while (const Profile* p = (*other)->next()) points += p->size();
    EXPECT_EQ(points, at);
  }
}

TEST(SampleCloud, WithoutAnyColourThereIsNoFile) {
  const TemporaryFolder folder;
  Profiles samples = random_profiles(3);
  for (Profile& p : samples.profiles) p.colour.assign(p.colour.size(), {});
  const auto cloud = write_coloured_samples(samples, "", folder / "a.ply");
  ASSERT_TRUE(cloud);
  EXPECT_EQ(cloud->coloured, 0u);
  EXPECT_GT(cloud->points, 0u);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

TEST(SampleCloud, AFolderThatIsNotThereIsNamed) {
  const TemporaryFolder folder;
  Profiles samples = random_profiles(4);
  const auto cloud = write_coloured_samples(samples, "", folder / "absent" / "a.ply");
  ASSERT_FALSE(cloud);
  EXPECT_EQ(cloud.error().errno_value, ENOENT);
  EXPECT_NE(cloud.error().message.find("absent"), std::string::npos);
}

}  // namespace
}  // namespace celadon
