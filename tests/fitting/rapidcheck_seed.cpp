// Property tests repeat: one seed unless RC_PARAMS says otherwise.
#include <cstdlib>

namespace {
[[maybe_unused]] const int kSeeded = setenv("RC_PARAMS", "seed=20020101", 0);
}  // namespace
