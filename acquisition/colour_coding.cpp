#include "acquisition/colour_coding.h"

namespace celadon {

LinearColour colour_of(const ColourCoding& coding, float y, float u, float v) {
  const bool bt601 = coding.weights == LumaWeights::bt601;
  const float red = bt601 ? 0.299F : 0.2126F, blue = bt601 ? 0.114F : 0.0722F, green = 1 - red - blue;
  u -= 128;
  v -= 128;
  if (coding.limited_range) {
    y = (y - 16) * (255.F / 219);
    u *= 255.F / 224;
    v *= 255.F / 224;
  }
  LinearColour out;
  out.red = y + 2 * (1 - red) * v;
  out.blue = y + 2 * (1 - blue) * u;
  out.green = (y - red * out.red - blue * out.blue) / green;
  return out;
}

}  // namespace celadon
