#pragma once
// Records of text, one a line, of which three columns are wanted.

#include <array>
#include <string>
#include <vector>

#include "daemon/files/input_file.h"
#include "daemon/files/number_text.h"
#include "daemon/files/point_source.h"

namespace celadon {

struct TextLayout {
  std::uint64_t begin = 0;                        ///< offset of the first record's line
  std::uint64_t line = 1;                         ///< its number, counted from 1
  std::array<std::size_t, 3> column = {0, 1, 2};  ///< of the wanted numbers, counted from 0
  std::array<std::string, 3> name = {"x", "y", "z"};
  Separator separator = Separator::blank;
  bool comments = false;                  ///< lines that start with # are not records
  std::optional<std::uint64_t> promised;  ///< records after which reading ends
  /// For PLY: properties in order, true for lists (a number of items, then the items). Empty: no lists.
  std::vector<bool> lists;
};

class TextRecords : public PointSource {
 public:
  /// @pre file outlives the source
  TextRecords(const InputFile& file, TextLayout layout);
  void rewind() override;
  std::size_t read(std::size_t count, double* a, double* b, double* c) override;
  std::optional<std::uint64_t> promised() const override { return layout_.promised; }

 private:
  bool parse(std::string_view line, std::array<double, 3>& values);
  bool fail(const std::string& what);

  const InputFile& file_;
  TextLayout layout_;
  ByteCursor cursor_;
  std::uint64_t line_ = 0, records_ = 0;
  std::size_t last_column_ = 0;
};

}  // namespace celadon
