#include "daemon/files/binary_records.h"

#include <algorithm>

#include "daemon/files/file_problem.h"

namespace celadon {
namespace {

constexpr std::size_t kBufferBytes = 1U << 18;

std::uint64_t end_of(const BinaryLayout& layout) {
  return layout.begin + layout.count * layout.stride;
}

}  // namespace

BinaryRecords::BinaryRecords(const InputFile& file, const BinaryLayout& layout)
    : file_(file),
      layout_(layout),
      cursor_(file, layout.begin, end_of(layout), std::max(kBufferBytes, layout.stride)),
      left_(layout.count) {}

void BinaryRecords::rewind() {
  cursor_.seek(layout_.begin);
  left_ = layout_.count;
  error_.clear();
}

bool BinaryRecords::restrict_to(std::uint64_t first, std::uint64_t count) {
  layout_.begin += first * layout_.stride;
  layout_.count = count;
  cursor_ = ByteCursor(file_, layout_.begin, end_of(layout_), std::max(kBufferBytes, layout_.stride));
  rewind();
  return true;
}

std::size_t BinaryRecords::read(std::size_t count, double* a, double* b, double* c) {
  const std::size_t fit = std::max(kBufferBytes, layout_.stride) / layout_.stride;
  const auto piece = static_cast<std::size_t>(std::min<std::uint64_t>({count, fit, left_}));
  if (piece == 0 || !error_.empty()) {
    return 0;
  }
  const std::uint64_t offset = cursor_.offset();
  const std::string_view bytes = cursor_.peek(piece * layout_.stride);
  if (bytes.size() < piece * layout_.stride) {
    error_ = !file_.error().empty()
                 ? file_.error()
                 : file_.path().string() + " ends inside the record at byte " + grouped(offset) + "; copy it again";
    return 0;
  }
  double* const columns[] = {a, b, c};
  for (std::size_t k = 0; k < 3; ++k) {
    decode_column(layout_.field[k].type, layout_.swapped, bytes.data() + layout_.field[k].offset, layout_.stride, piece,
                  columns[k]);
  }
  cursor_.skip(piece * layout_.stride);
  left_ -= piece;
  return piece;
}

}  // namespace celadon
