#pragma once
// Numbers and fields of text clouds.

#include <optional>
#include <string>
#include <string_view>

namespace celadon {

/// What stands between two fields. Blanks around a comma or semicolon belong to neither field.
enum class Separator : char { blank = ' ', comma = ',', semicolon = ';' };

/// A semicolon anywhere decides, then a comma; else blanks and tabs.
Separator separator_of(std::string_view line);

/// Takes the next field off the front of `rest`; nullopt when none is left. Blanks and tabs around it are dropped.
std::optional<std::string_view> take_field(std::string_view& rest, Separator separator);

/// A whole field as a number, independent of the locale; nan and inf in the spellings of C and of Microsoft's library
/// count as numbers. Values out of the range of a double are infinite or 0.
std::optional<double> parse_number(std::string_view field);

/// The field for an error message: cut and made printable.
std::string in_quotes(std::string_view field);

}  // namespace celadon
