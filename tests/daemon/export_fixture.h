#pragma once
// Solids written to STEP and read back, or why they were refused.

#include <gtest/gtest.h>

#include <filesystem>
#include <span>
#include <stdexcept>
#include <string>

#include "daemon/export/cad_client.h"
#include "tests/daemon/step_reader.h"
#include "tests/temporary_folder.h"

namespace celadon::testing {

struct Written {
  CadResult result;
  StepFile step;
  std::string text;
};

class Export : public ::testing::Test {
 protected:
  Written write(const NurbsSurface& wall, const CadOptions& options = {}) { return write(single(wall), options); }
  Written write(std::span<const NurbsSurface> walls, const CadOptions& options = {}) {
    const auto file = scratch_.path() / "body.step";
    const auto result = write_step(walls, file, options);
    if (!result) {
      throw std::runtime_error(result.error());
    }
    Written written{*result, {}, read_file(file)};
    written.step = StepFile::parse(written.text);
    return written;
  }
  std::string refusal(const NurbsSurface& wall) { return refusal(single(wall)); }
  std::string refusal(std::span<const NurbsSurface> walls) {
    const auto file = scratch_.path() / "refused.step";
    const auto result = write_step(walls, file, {});
    EXPECT_FALSE(std::filesystem::exists(file));
    return result ? "written" : result.error();
  }
  TemporaryFolder scratch_;
};

inline StepSurface wall_of(const StepFile& step) {
  return StepSurface::of(step, step.only("B_SPLINE_SURFACE_WITH_KNOTS"));
}

}  // namespace celadon::testing
