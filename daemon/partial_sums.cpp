#include "daemon/partial_sums.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <optional>
#include <set>
#include <stdexcept>
#include <system_error>
#include <utility>

#include <nlohmann/json.hpp>

#include "daemon/crc32c.h"
#include "daemon/json_field.h"

namespace celadon {
namespace {

static_assert(std::endian::native == std::endian::little, "part files are little-endian");

constexpr std::string_view kMagic(
    "\x89"
    "CES\r\n\x1a\n",
    8);
constexpr std::uint16_t kMajor = 1, kMinor = 0;
constexpr std::size_t kPreamble = 16, kHead = 24;
constexpr std::uintmax_t kLargestPart = 256u << 20;
constexpr const char* kSections[] = {"grid", "origin", "counts", "cells", "rims", "sample"};
constexpr std::size_t kSectionCount = std::size(kSections);

template <class T>
void put(std::string& out, const T& value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof value);
}

void put_section(std::string& out, std::uint32_t type, const std::string& payload) {
  const std::size_t head = out.size();
  put(out, type);
  put(out, std::uint32_t{0});
  put(out, std::uint64_t{payload.size()});
  put(out, crc32c(payload.data(), payload.size()));
  put(out, crc32c(out.data() + head, kHead - 4));
  out += payload;
  out.append((8 - payload.size() % 8) % 8, '\0');
}

struct PartProblem {
  std::string text;
};

// Numbers of a payload, one after the other; the whole of it has to be read.
class Payload {
 public:
  Payload(std::string_view bytes, const char* section) : bytes_(bytes), section_(section) {}
  template <class T>
  T next() {
    if (bytes_.size() - at_ < sizeof(T)) fail("ends too early");
    T value;
    std::memcpy(&value, bytes_.data() + at_, sizeof value);
    at_ += sizeof value;
    return value;
  }
  double finite() {
    const auto x = next<double>();
    if (!std::isfinite(x)) fail("has a number that is not finite");
    return x;
  }
  void zero() {
    if (next<std::uint32_t>() != 0) fail("has something where zeros belong");
  }
  /// A count of records of so many bytes, which must be there.
  std::uint64_t count(std::size_t record_bytes) {
    const auto n = next<std::uint64_t>();
    if (n != (bytes_.size() - at_) / record_bytes || (bytes_.size() - at_) % record_bytes != 0)
      fail("does not hold the " + std::to_string(n) + " records that it announces");
    return n;
  }
  void end() const {
    if (at_ != bytes_.size()) fail("is longer than its content");
  }
  [[noreturn]] void fail(const std::string& what) const {
    throw PartProblem{"its section '" + std::string(section_) + "' " + what};
  }

 private:
  std::string_view bytes_;
  const char* section_;
  std::size_t at_ = 0;
};

// The payloads of all sections.
std::vector<std::string_view> sections_of(std::string_view bytes) {
  if (bytes.size() < kPreamble || bytes.substr(0, 8) != kMagic) throw PartProblem{"it is no part of partial sums"};
  Payload preamble(bytes.substr(8, kPreamble - 8), "preamble");
  const auto major = preamble.next<std::uint16_t>();
  (void)preamble.next<std::uint16_t>();
  if (major != kMajor)
    throw PartProblem{"it has version " + std::to_string(major) + "; this program reads version " +
                      std::to_string(kMajor)};
  if (const auto n = preamble.next<std::uint32_t>(); n != kSectionCount)
    throw PartProblem{"it has " + std::to_string(n) + " sections instead of " + std::to_string(kSectionCount)};
  std::vector<std::string_view> payloads;
  std::size_t at = kPreamble;
  for (std::size_t k = 0; k < kSectionCount; ++k) {
    const std::string name = std::string("its section '") + kSections[k] + "'";
    if (bytes.size() - at < kHead)
      throw PartProblem{"it is truncated: it ends after " + std::to_string(bytes.size()) + " bytes, before " + name};
    Payload head(bytes.substr(at, kHead), kSections[k]);
    const auto type = head.next<std::uint32_t>();
    head.zero();
    const auto length = head.next<std::uint64_t>();
    const auto crc = head.next<std::uint32_t>();
    if (head.next<std::uint32_t>() != crc32c(bytes.data() + at, kHead - 4) || type != k + 1)
      throw PartProblem{name + " is damaged at byte " + std::to_string(at)};
    at += kHead;
    if (length > bytes.size() - at)
      throw PartProblem{"it is truncated: it has " + std::to_string(bytes.size()) + " bytes, and " + name +
                        " ends at " + std::to_string(at + length)};
    const std::string_view payload = bytes.substr(at, static_cast<std::size_t>(length));
    if (crc32c(payload.data(), payload.size()) != crc)
      throw PartProblem{name + " is damaged after byte " + std::to_string(at)};
    at += payload.size();
    const std::size_t padding = (8 - payload.size() % 8) % 8;
    if (bytes.size() - at < padding)
      throw PartProblem{"it is truncated after " + std::to_string(bytes.size()) + " bytes"};
    for (std::size_t i = 0; i < padding; ++i, ++at)
      if (bytes[at] != '\0') throw PartProblem{name + " is not padded by zeros"};
    payloads.push_back(payload);
  }
  if (at != bytes.size())
    throw PartProblem{"it has " + std::to_string(bytes.size() - at) + " bytes after its end at byte " +
                      std::to_string(at)};
  return payloads;
}

std::vector<std::string> read_inputs(std::string_view payload) {
  try {
    const auto json = nlohmann::json::parse(payload);
    const JsonField list = JsonField(json, "").at("inputs");
    std::vector<std::string> inputs;
    for (std::size_t k = 0; k < list.size(); ++k) inputs.push_back(list.at(k).text());
    return inputs;
  } catch (const JsonProblem& p) {
    throw PartProblem{"in its section 'origin' " + p.text};
  } catch (const nlohmann::json::exception&) {
    throw PartProblem{"its section 'origin' is not JSON"};
  }
}

void read_cells(Payload payload, MomentGrid& sums) {
  const std::size_t numbers = sums.packed_size();
  const auto along = static_cast<std::uint64_t>(sums.z_cells()),
             all = along * static_cast<std::uint64_t>(sums.v_cells());
  std::vector<double> packed(numbers);
  std::uint64_t before = 0;
  const auto n = payload.count(8 + 8 * numbers);
  for (std::uint64_t k = 0; k < n; ++k) {
    const auto cell = payload.next<std::uint64_t>();
    if (cell >= all || (k > 0 && cell <= before))
      payload.fail("names the cell " + std::to_string(cell) + " out of order");
    before = cell;
    for (double& x : packed) x = payload.finite();
    if (!(packed[0] > 0)) payload.fail("has a cell without samples");
    sums.add_packed(static_cast<int>(cell % along), static_cast<int>(cell / along), packed.data());
  }
  payload.end();
}

SectorExtents read_rims(Payload payload, const MomentGrid& sums) {
  SectorExtents rims(sums);
  const auto places = static_cast<std::size_t>(sums.z_cells() * SectorExtents::kSectors);
  std::vector<double> low(places), high(places);
  for (auto* list : {&low, &high})
    for (double& x : *list) {
      x = payload.next<double>();
      if (std::isnan(x)) payload.fail("has a number that is none");
    }
  payload.end();
  for (int i = 0; i < sums.z_cells(); ++i)
    for (int s = 0; s < SectorExtents::kSectors; ++s) {
      const auto at = static_cast<std::size_t>(i * SectorExtents::kSectors + s);
      rims.set(i, s, low[at], high[at]);
    }
  return rims;
}

EvenSample<SamplePoint> read_sample(Payload payload, const GridSpecification& grid) {
  const auto bound = payload.next<std::uint32_t>();
  payload.zero();
  const auto n = payload.count(32);
  if (n > FirstLook::kSamples) payload.fail("has more than " + std::to_string(FirstLook::kSamples) + " samples");
  std::vector<SamplePoint> values;
  std::vector<std::uint32_t> hashes;
  for (std::uint64_t k = 0; k < n; ++k) {
    hashes.push_back(payload.next<std::uint32_t>());
    payload.zero();
    const double r = payload.finite(), v = payload.finite(), z = payload.finite();
    if (!(r > 0 && v >= 0 && v <= grid.arcs.count() && z >= grid.z_start_mm && z <= grid.z_end_mm))
      payload.fail("has a sample outside the grid");
    values.push_back({r, v, z});
  }
  payload.end();
  EvenSample<SamplePoint> sample(FirstLook::kSamples);
  try {
    sample.restore(std::move(values), std::move(hashes), bound);
  } catch (const std::invalid_argument&) {
    payload.fail("is no even sample of its bound");
  }
  return sample;
}

}  // namespace

std::string format_part(const PartialSums& part) {
  const MomentGrid& sums = part.samples.sums;
  const FirstLook& look = part.samples.look;
  std::string out(kMagic);
  put(out, kMajor);
  put(out, kMinor);
  put(out, static_cast<std::uint32_t>(kSectionCount));
  put_section(out, 1, format_grid(part.grid));
  nlohmann::ordered_json origin;
  origin["inputs"] = part.inputs;
  origin["writer"] = "celadon";
  put_section(out, 2, origin.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));

  std::string payload;
  const MomentGrid::Counts counts = sums.counts();
  for (const std::size_t n : {counts.samples, counts.on_axis, counts.not_finite, counts.outside, look.points()})
    put(payload, std::uint64_t{n});
  put_section(out, 3, payload);

  payload.clear();
  std::vector<double> packed(sums.packed_size());
  std::uint64_t cells = 0;
  put(payload, cells);
  for (int j = 0; j < sums.v_cells(); ++j)
    for (int i = 0; i < sums.z_cells(); ++i) {
      if (!(sums.cell_weight(i, j) > 0)) continue;
      ++cells;
      put(payload,
          static_cast<std::uint64_t>(j) * static_cast<std::uint64_t>(sums.z_cells()) + static_cast<std::uint64_t>(i));
      sums.pack(i, j, packed.data());
      for (const double x : packed) put(payload, x);
    }
  std::memcpy(payload.data(), &cells, sizeof cells);
  put_section(out, 4, payload);

  payload.clear();
  for (const bool high : {false, true})
    for (int i = 0; i < sums.z_cells(); ++i)
      for (int s = 0; s < SectorExtents::kSectors; ++s)
        put(payload, high ? look.extents().highest(i, s) : look.extents().lowest(i, s));
  put_section(out, 5, payload);

  payload.clear();
  put(payload, look.sample().bound());
  put(payload, std::uint32_t{0});
  put(payload, std::uint64_t{look.samples().size()});
  for (std::size_t k = 0; k < look.samples().size(); ++k) {
    const SamplePoint& s = look.samples()[k];
    put(payload, look.sample().hashes()[k]);
    put(payload, std::uint32_t{0});
    for (const double x : {s.r_mm, s.v, s.z_mm}) put(payload, x);
  }
  put_section(out, 6, payload);
  return out;
}

tl::expected<PartialSums, std::string> parse_part(std::string_view bytes, const std::string& source) {
  const auto problem = [&](const std::string& what) {
    return tl::make_unexpected(source + ": " + what +
                               "; make the part again with celadon fit --partial, or copy it again.");
  };
  try {
    const auto sections = sections_of(bytes);
    auto grid = parse_grid(std::string(sections[0]), source + ", section 'grid'");
    if (!grid) return tl::make_unexpected(grid.error());
    MomentGrid sums(grid->cells, grid->weights);
    Payload counts(sections[2], kSections[2]);
    MomentGrid::Counts of_sums;
    for (std::size_t* n : {&of_sums.samples, &of_sums.on_axis, &of_sums.not_finite, &of_sums.outside})
      *n = static_cast<std::size_t>(counts.next<std::uint64_t>());
    const auto points = static_cast<std::size_t>(counts.next<std::uint64_t>());
    counts.end();
    sums.add_counts(of_sums);
    read_cells(Payload(sections[3], kSections[3]), sums);
    SectorExtents rims = read_rims(Payload(sections[4], kSections[4]), sums);
    auto sample = read_sample(Payload(sections[5], kSections[5]), grid->cells);
    if (sample.values().size() > of_sums.samples || sums.samples() + sums.rejected() != points)
      throw PartProblem{"its counts contradict its samples"};
    FirstLook look(sums, std::move(sample), std::move(rims), points);
    return PartialSums{*grid, {std::move(sums), std::move(look)}, read_inputs(sections[1])};
  } catch (const PartProblem& p) {
    return problem(p.text);
  }
}

tl::expected<NamedPart, std::string> read_part(const std::filesystem::path& file) {
  std::error_code code;
  const auto size = std::filesystem::file_size(file, code);
  if (code)
    return tl::make_unexpected(file.string() + " cannot be read: " + code.message() + "; give an existing part.");
  if (size > kLargestPart)
    return tl::make_unexpected(file.string() + " has " + std::to_string(size) + " bytes; parts have at most " +
                               std::to_string(kLargestPart) + ".");
  std::ifstream in(file, std::ios::binary);
  std::string bytes(static_cast<std::size_t>(size), '\0');
  if (!in.read(bytes.data(), static_cast<std::streamsize>(size)))
    return tl::make_unexpected(file.string() + " cannot be read: " + std::strerror(errno) +
                               "; check its permissions and the disk.");
  auto part = parse_part(bytes, file.string());
  if (!part) return tl::make_unexpected(part.error());
  return NamedPart{file.string(), crc32c(bytes.data(), bytes.size()), std::move(*part)};
}

tl::expected<PartialSums, std::string> merge_parts(std::vector<NamedPart> parts) {
  std::sort(parts.begin(), parts.end(), [](const auto& a, const auto& b) { return a.checksum < b.checksum; });
  PartialSums all = std::move(parts.front().sums);
  for (std::size_t k = 1; k < parts.size(); ++k) {
    const NamedPart& part = parts[k];
    if (const auto differs = difference(all.grid, parts.front().name, part.sums.grid, part.name))
      return tl::make_unexpected(*differs + "; make all parts with one grid file.");
    if (part.checksum == parts[k - 1].checksum)
      return tl::make_unexpected(parts[k - 1].name + " and " + part.name +
                                 " are the same part; its samples would count twice. Leave one out.");
    merge(all.samples, part.sums.samples);
    all.inputs.insert(all.inputs.end(), part.sums.inputs.begin(), part.sums.inputs.end());
  }
  std::sort(all.inputs.begin(), all.inputs.end());
  return all;
}

}  // namespace celadon
