#include "daemon/files/mesh_reader.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <bit>
#include <cstring>

#include "tests/temporary_folder.h"

namespace celadon {
namespace {

using testing::TemporaryFolder;

TriangleMesh pyramid() {
  TriangleMesh mesh;
  mesh.vertices_mm = {{0, 0, 0}, {4, 0, 0}, {4, 4, 0}, {0, 4, 0}, {2, 2, 3.5}};
  mesh.triangles = {{0, 2, 1}, {0, 3, 2}, {0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
  return mesh;
}

double volume_of(const TriangleMesh& mesh) {
  double six = 0;
  for (const auto& t : mesh.triangles) {
    six += mesh.vertices_mm[t[0]].dot(mesh.vertices_mm[t[1]].cross(mesh.vertices_mm[t[2]]));
  }
  return six / 6;
}

class MeshReader : public ::testing::Test {
 protected:
  tl::expected<TriangleMesh, std::string> read(std::string_view bytes) {
    return read_mesh(folder_.write("mesh", bytes));
  }
  void expect_pyramid(std::string_view bytes) {
    const auto mesh = read(bytes);
    ASSERT_TRUE(mesh) << mesh.error();
    EXPECT_EQ(mesh->vertices_mm.size(), 5u);
    EXPECT_EQ(mesh->triangles.size(), 6u);
    EXPECT_NEAR(volume_of(*mesh), 16 * 3.5 / 3, 1e-6);
  }
  void expect_refused(std::string_view bytes, const std::string& word) {
    const auto mesh = read(bytes);
    ASSERT_FALSE(mesh);
    EXPECT_NE(mesh.error().find(word), std::string::npos) << mesh.error();
  }
  TemporaryFolder folder_;
};

constexpr const char* kTextPly =
    "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 5\nproperty float nx\nproperty double x\n"
    "property double y\nproperty double z\nelement face 5\nproperty uchar flags\n"
    "property list uchar int vertex_indices\nend_header\n"
    "0 0 0 0\n0 4 0 0\n0 4 4 0\n0 0 4 0\n0 2 2 3.5\n7 4 0 3 2 1\n7 3 0 1 4\n7 3 1 2 4\n7 3 2 3 4\n7 3 3 0 4\n";

TEST_F(MeshReader, ReadsWhatTheWriterWrites) {
  expect_pyramid(binary_stl(pyramid(), "a pyramid"));
  expect_pyramid(binary_stl(pyramid(), "solid in the first word of a binary file"));
  expect_pyramid(binary_ply(pyramid(), "a pyramid"));
}

TEST_F(MeshReader, ReadsTextAndPolygons) {
  expect_pyramid(kTextPly);
  const TriangleMesh body = pyramid();
  std::string stl = "solid pyramid\n";
  for (const auto& t : body.triangles) {
    stl += " facet normal 0 0 0\n  outer loop\n";
    for (const auto corner : t) {
      const auto& v = body.vertices_mm[corner];
      stl += "   vertex " + std::to_string(v.x()) + " " + std::to_string(v.y()) + "\t" + std::to_string(v.z()) + "\r\n";
    }
    stl += "  endloop\n endfacet\n";
  }
  expect_pyramid(stl + "endsolid pyramid\n");
}

TEST_F(MeshReader, ReadsBigEndian) {
  std::string ply =
      "ply\nformat binary_big_endian 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 6\nproperty list uchar ushort vertex_index\nend_header\n";
  const auto put = [&](std::uint64_t bits, int bytes) {
    for (int i = bytes - 1; i >= 0; --i) ply += static_cast<char>(bits >> (8 * i) & 0xff);
  };
  for (const auto& v : pyramid().vertices_mm) {
    for (const double c : {v.x(), v.y(), v.z()}) put(std::bit_cast<std::uint32_t>(static_cast<float>(c)), 4);
  }
  for (const auto& t : pyramid().triangles) {
    put(3, 1);
    for (const auto corner : t) put(corner, 2);
  }
  expect_pyramid(ply);
}

TEST_F(MeshReader, SaysWhatIsWrong) {
  expect_refused("hello", "neither STL nor PLY");
  const std::string ply = kTextPly, stl = binary_stl(pyramid(), "x");
  expect_refused(ply.substr(0, ply.size() - 4), "\"face\" 4");
  std::string far = ply;
  far.replace(far.find("3 3 0 4"), 7, "3 3 0 5");
  expect_refused(far, "face 4 names a vertex");
  std::string many = ply;
  many.replace(many.find("element face 5"), 14, "element face 99999999");
  expect_refused(many, "99 999 999");
  std::string empty = ply;
  empty.replace(empty.find("2 2 3.5"), 7, "2 2 nan");
  expect_refused(empty, "vertex 4");
  expect_refused(stl.substr(0, stl.size() - 1), "neither");
  std::string infinite = stl;
  const float inf = std::numeric_limits<float>::infinity();
  std::memcpy(&infinite[84 + 50 + 12], &inf, sizeof inf);
  expect_refused(infinite, "triangle 1");
  expect_refused("solid\nvertex 1 2\n", "line 2");
  expect_refused("solid\nvertex 1 2 3\n", "inside a triangle");
  expect_refused("solid\nendsolid\n", "no triangles");
}

}  // namespace
}  // namespace celadon
