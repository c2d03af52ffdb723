// Asks for a STEP file from a folder where no celadon-cad lies beside it: prints the error, or "written".

#include <cstdio>
#include <cstdlib>

#include "daemon/export/cad_client.h"
#include "tests/daemon/closed_wall.h"

int main(int count, char** arguments) {
  if (count != 3) {
    return 2;
  }
  celadon::CadOptions options;
  options.time_limit_s = std::atoi(arguments[2]);
  const auto result =
      celadon::write_step(celadon::single(celadon::testing::cylinder(10, 20).surface()), arguments[1], options);
  std::puts(result ? "written" : result.error().c_str());
  return result ? 0 : 1;
}
