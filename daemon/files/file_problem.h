#pragma once
// One sentence for an operator out of an errno: what failed, on which file, why, and what to do about it.

#include <filesystem>
#include <string>

namespace celadon {

/// For example file_problem("cannot open", "cup.ply", ENOENT) is
/// "cannot open cup.ply: No such file or directory; check the name and the folder".
std::string file_problem(const std::string& what, const std::filesystem::path& file, int errno_value);

/// 1234567 as "1 234 567".
std::string grouped(unsigned long long number);

}  // namespace celadon
