#pragma once
// Records of fixed size, of which three numbers are wanted.

#include <array>
#include <vector>

#include "daemon/files/input_file.h"
#include "daemon/files/point_source.h"
#include "daemon/files/scalar_type.h"

namespace celadon {

struct BinaryField {
  std::size_t offset = 0;  ///< in the record
  ScalarType type = ScalarType::f32;
};

struct BinaryLayout {
  std::uint64_t begin = 0;  ///< offset of the first record
  std::uint64_t count = 0;
  std::size_t stride = 0;
  std::array<BinaryField, 3> field;
  bool swapped = false;  ///< big-endian numbers
};

class BinaryRecords : public PointSource {
 public:
  /// @pre file outlives the source and holds all records
  BinaryRecords(const InputFile& file, const BinaryLayout& layout);
  void rewind() override;
  std::size_t read(std::size_t count, double* a, double* b, double* c) override;
  std::optional<std::uint64_t> promised() const override { return layout_.count; }
  bool restrict_to(std::uint64_t first, std::uint64_t count) override;

 private:
  const InputFile& file_;
  BinaryLayout layout_;
  ByteCursor cursor_;
  std::uint64_t left_ = 0;
};

}  // namespace celadon
