#pragma once
// A reference object as its certificate describes it.

#include <cstdint>
#include <string>

#include <tl/expected.hpp>

namespace celadon {

enum class ReferenceShape : std::uint8_t { cylinder, sphere };
/// "cylinder", "sphere"
const char* to_string(ReferenceShape shape);

struct Reference {
  ReferenceShape shape = ReferenceShape::cylinder;
  double diameter_mm = 0;                          ///< certified, at 20 degrees Celsius
  double u_mm = 0;                                 ///< its standard uncertainty
  double form_mm = 0;                              ///< certified deviation of its form, peak to valley
  double expansion_per_K = 0;                      ///< coefficient of thermal expansion
  double temperature_C = 20, temperature_u_K = 0;  ///< of the object while it is scanned

  double diameter_then_mm() const { return diameter_mm * (1 + expansion_per_K * (temperature_C - 20)); }
  /// Standard uncertainty of diameter_then_mm().
  double u_then_mm() const;
};

/// reference = ( "cylinder" / "sphere" ) ":" field *( "," field ), each field once, D and one of u and U required:
///   D=MM      certified diameter at 20 degrees Celsius       a=PER_K   coefficient of thermal expansion
///   u=MM      its standard uncertainty                       T=C       temperature of the object, with a only
///   U=MM      its expanded uncertainty, k = 2                uT=K      standard uncertainty of T
///   form=MM   certified form deviation, peak to valley
/// Errors: one sentence with the field, its value and what may stand there.
tl::expected<Reference, std::string> parse_reference(const std::string& text);

}  // namespace celadon
