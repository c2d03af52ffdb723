#include "tests/daemon/step_reader.h"

#include <charconv>
#include <fstream>
#include <iterator>
#include <stdexcept>

namespace celadon::testing {
namespace {

using Kind = StepValue::Kind;

[[noreturn]] void fail(const std::string& what) {
  throw std::runtime_error("STEP: " + what);
}

void append_utf8(std::string& text, unsigned long code) {
  if (code < 0x80) {
    text += static_cast<char>(code);
  } else if (code < 0x800) {
    text += static_cast<char>(0xC0 | (code >> 6));
    text += static_cast<char>(0x80 | (code & 0x3F));
  } else if (code < 0x10000) {
    text += static_cast<char>(0xE0 | (code >> 12));
    text += static_cast<char>(0x80 | ((code >> 6) & 0x3F));
    text += static_cast<char>(0x80 | (code & 0x3F));
  } else {
    text += static_cast<char>(0xF0 | (code >> 18));
    text += static_cast<char>(0x80 | ((code >> 12) & 0x3F));
    text += static_cast<char>(0x80 | ((code >> 6) & 0x3F));
    text += static_cast<char>(0x80 | (code & 0x3F));
  }
}

class Parser {
 public:
  explicit Parser(std::string_view text) : text_(text) {}

  StepFile file() {
    StepFile file;
    expect("ISO-10303-21;");
    expect("HEADER;");
    while (!accept("ENDSEC;")) {
      StepRecord record = this->record();
      expect(";");
      file.header[record.type] = std::move(record);
    }
    expect("DATA;");
    while (!accept("ENDSEC;")) {
      expect("#");
      const int id = static_cast<int>(unsigned_number());
      expect("=");
      StepEntity entity;
      if (accept("(")) {
        while (!accept(")")) {
          entity.records.push_back(record());
        }
      } else {
        entity.records.push_back(record());
      }
      expect(";");
      if (!file.entities.emplace(id, std::move(entity)).second) {
        wrong("#" + std::to_string(id) + " is defined twice");
      }
    }
    expect("END-ISO-10303-21;");
    skip_blank();
    if (at_ != text_.size()) {
      wrong("text after the end");
    }
    return file;
  }

 private:
  [[noreturn]] void wrong(const std::string& what) const { fail(what + " at offset " + std::to_string(at_)); }

  void skip_blank() {
    for (;;) {
      while (at_ < text_.size() &&
             (text_[at_] == ' ' || text_[at_] == '\n' || text_[at_] == '\r' || text_[at_] == '\t')) {
        ++at_;
      }
      if (text_.substr(at_, 2) != "/*") {
        return;
      }
      const std::size_t end = text_.find("*/", at_ + 2);
      if (end == std::string_view::npos) {
        wrong("comment without end");
      }
      at_ = end + 2;
    }
  }

  bool accept(std::string_view token) {
    skip_blank();
    if (text_.substr(at_, token.size()) != token) {
      return false;
    }
    at_ += token.size();
    return true;
  }

  void expect(std::string_view token) {
    if (!accept(token)) {
      wrong("'" + std::string(token) + "' expected, '" + std::string(text_.substr(at_, 20)) + "' found");
    }
  }

  char peek() {
    skip_blank();
    return at_ < text_.size() ? text_[at_] : '\0';
  }

  static bool upper(char c) { return (c >= 'A' && c <= 'Z') || c == '_'; }
  static bool digit(char c) { return c >= '0' && c <= '9'; }

  std::string keyword() {
    skip_blank();
    const std::size_t start = at_;
    while (at_ < text_.size() && (upper(text_[at_]) || (at_ > start && digit(text_[at_])))) {
      ++at_;
    }
    if (start == at_) {
      wrong("keyword expected");
    }
    return std::string(text_.substr(start, at_ - start));
  }

  StepRecord record() {
    StepRecord record;
    record.type = keyword();
    record.arguments = list();
    return record;
  }

  std::vector<StepValue> list() {
    expect("(");
    std::vector<StepValue> items;
    if (accept(")")) {
      return items;
    }
    do {
      items.push_back(value());
    } while (accept(","));
    expect(")");
    return items;
  }

  unsigned long unsigned_number() {
    const std::size_t start = at_;
    while (at_ < text_.size() && digit(text_[at_])) {
      ++at_;
    }
    unsigned long number = 0;
    if (std::from_chars(text_.data() + start, text_.data() + at_, number).ec != std::errc()) {
      wrong("number expected");
    }
    return number;
  }

  StepValue value() {
    StepValue value;
    const char c = peek();
    if (c == '$' || c == '*') {
      ++at_;
      value.kind = c == '$' ? Kind::omitted : Kind::derived;
    } else if (c == '#') {
      ++at_;
      value.kind = Kind::reference;
      value.number = static_cast<double>(unsigned_number());
    } else if (c == '(') {
      value.kind = Kind::list;
      value.items = list();
    } else if (c == '\'') {
      value.kind = Kind::string;
      value.text = string();
    } else if (c == '.') {
      ++at_;
      value.kind = Kind::enumeration;
      value.text = keyword();
      if (at_ >= text_.size() || text_[at_++] != '.') {
        wrong("enumeration without end");
      }
    } else if (upper(c)) {
      value.kind = Kind::typed;
      value.text = keyword();
      value.items = list();
    } else {
      number(value);
    }
    return value;
  }

  /// integer = [sign] digit+;  real = [sign] digit+ "." digit* ["E" [sign] digit+]
  void number(StepValue& value) {
    std::size_t start = at_;
    if (at_ < text_.size() && (text_[at_] == '+' || text_[at_] == '-')) {
      start += text_[at_] == '+';
      ++at_;
    }
    const auto digits = [this] {
      const std::size_t first = at_;
      while (at_ < text_.size() && digit(text_[at_])) {
        ++at_;
      }
      return at_ > first;
    };
    if (!digits()) {
      wrong("value expected");
    }
    value.kind = Kind::integer;
    if (at_ < text_.size() && text_[at_] == '.') {
      value.kind = Kind::real;
      ++at_;
      digits();
      if (at_ < text_.size() && text_[at_] == 'E') {
        ++at_;
        if (at_ < text_.size() && (text_[at_] == '+' || text_[at_] == '-')) {
          ++at_;
        }
        if (!digits()) {
          wrong("exponent without digits");
        }
      }
    }
    const auto parsed = std::from_chars(text_.data() + start, text_.data() + at_, value.number);
    if (parsed.ec != std::errc() || parsed.ptr != text_.data() + at_) {
      wrong("number out of range");
    }
  }

  unsigned long hexadecimal(std::size_t digits) {
    unsigned long code = 0;
    const std::string_view token = text_.substr(at_, digits);
    const auto parsed = std::from_chars(token.data(), token.data() + token.size(), code, 16);
    if (parsed.ptr != token.data() + digits) {
      wrong("hexadecimal digits expected");
    }
    at_ += digits;
    return code;
  }

  std::string string() {
    std::string decoded;
    for (++at_;;) {
      if (at_ >= text_.size()) {
        wrong("string without end");
      }
      const char c = text_[at_];
      if (c == '\'') {
        ++at_;
        if (at_ >= text_.size() || text_[at_] != '\'') {
          return decoded;
        }
        decoded += '\'';
        ++at_;
      } else if (c == '\\') {
        const std::string_view directive = text_.substr(at_, 4);
        if (text_.substr(at_, 2) == "\\\\") {
          decoded += '\\';
          at_ += 2;
        } else if (directive == "\\X2\\" || directive == "\\X4\\") {
          const std::size_t digits = directive[2] == '2' ? 4 : 8;
          at_ += 4;
          while (text_.substr(at_, 4) != "\\X0\\") {
            append_utf8(decoded, hexadecimal(digits));
          }
          at_ += 4;
        } else {
          wrong("directive of another kind in a string");
        }
      } else if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) > 0x7E) {
        wrong("character outside of the basic alphabet in a string");
      } else {
        decoded += c;
        ++at_;
      }
    }
  }

  std::string_view text_;
  std::size_t at_ = 0;
};

void check_references(const StepFile& file, const std::vector<StepValue>& values) {
  for (const StepValue& value : values) {
    if (value.kind == Kind::reference) {
      file.at(value.id());
    }
    check_references(file, value.items);
  }
}

std::vector<double> written_out(const StepValue& knots, const StepValue& multiplicities) {
  std::vector<double> all;
  if (knots.list().size() != multiplicities.list().size()) {
    fail("knots and multiplicities differ in number");
  }
  for (std::size_t i = 0; i < knots.items.size(); ++i) {
    if (i > 0 && !(knots.items[i].real() > knots.items[i - 1].real())) {
      fail("knots do not ascend");
    }
    all.insert(all.end(), static_cast<std::size_t>(multiplicities.items[i].integer()), knots.items[i].real());
  }
  return all;
}

/// De Boor's algorithm on homogeneous points.
Eigen::Vector4d de_boor(int degree, const std::vector<double>& knots, const std::vector<Eigen::Vector4d>& points,
                        double t) {
  int span = degree;
  const int last = static_cast<int>(points.size()) - 1;
  while (span < last && t >= knots[static_cast<std::size_t>(span) + 1]) {
    ++span;
  }
  std::vector<Eigen::Vector4d> d(points.begin() + (span - degree), points.begin() + span + 1);
  for (int level = 1; level <= degree; ++level) {
    for (int k = degree; k >= level; --k) {
      const auto left = static_cast<std::size_t>(span - degree + k);
      const auto right = static_cast<std::size_t>(span + 1 + k - level);
      const double a = (t - knots[left]) / (knots[right] - knots[left]);
      const auto at = static_cast<std::size_t>(k);
      d[at] = (1 - a) * d[at - 1] + a * d[at];
    }
  }
  return d.back();
}

Eigen::Vector3d projected(const Eigen::Vector4d& homogeneous) {
  return homogeneous.head<3>() / homogeneous.w();
}

Eigen::Vector4d homogeneous(const Eigen::Vector4d& point_and_weight) {
  Eigen::Vector4d result = point_and_weight * point_and_weight.w();
  result.w() = point_and_weight.w();
  return result;
}

}  // namespace

int StepValue::id() const {
  if (kind != Kind::reference) {
    fail("reference expected");
  }
  return static_cast<int>(number);
}

double StepValue::real() const {
  if (kind != Kind::real) {
    fail("real expected");
  }
  return number;
}

int StepValue::integer() const {
  if (kind != Kind::integer) {
    fail("integer expected");
  }
  return static_cast<int>(number);
}

bool StepValue::boolean() const {
  if (kind != Kind::enumeration || (text != "T" && text != "F")) {
    fail("boolean expected");
  }
  return text == "T";
}

const std::string& StepValue::string() const {
  if (kind != Kind::string) {
    fail("string expected");
  }
  return text;
}

const std::vector<StepValue>& StepValue::list() const {
  if (kind != Kind::list) {
    fail("list expected");
  }
  return items;
}

const StepRecord& StepEntity::record(const std::string& type) const {
  for (const StepRecord& record : records) {
    if (record.type == type) {
      return record;
    }
  }
  fail("no record " + type);
}

bool StepEntity::is(const std::string& type) const {
  for (const StepRecord& record : records) {
    if (record.type == type) {
      return true;
    }
  }
  return false;
}

StepFile StepFile::parse(std::string_view text) {
  StepFile file = Parser(text).file();
  for (const auto& [id, entity] : file.entities) {
    for (const StepRecord& record : entity.records) {
      check_references(file, record.arguments);
    }
  }
  return file;
}

StepFile StepFile::read(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) {
    fail("cannot open " + path);
  }
  return parse(std::string(std::istreambuf_iterator<char>(stream), {}));
}

const StepEntity& StepFile::at(int id) const {
  const auto found = entities.find(id);
  if (found == entities.end()) {
    fail("#" + std::to_string(id) + " is not defined");
  }
  return found->second;
}

std::vector<int> StepFile::all(const std::string& type) const {
  std::vector<int> ids;
  for (const auto& [id, entity] : entities) {
    if (entity.is(type)) {
      ids.push_back(id);
    }
  }
  return ids;
}

int StepFile::only(const std::string& type) const {
  const auto ids = all(type);
  if (ids.size() != 1) {
    fail(std::to_string(ids.size()) + " entities " + type + " in place of one");
  }
  return ids.front();
}

Eigen::Vector3d StepFile::triple(int id) const {
  const StepRecord& record = at(id).records.front();
  if (record.type != "CARTESIAN_POINT" && record.type != "DIRECTION") {
    fail("#" + std::to_string(id) + " is a " + record.type + ", not a point or direction");
  }
  const auto& values = record.arguments.at(1).list();
  return {values.at(0).real(), values.at(1).real(), values.at(2).real()};
}

StepSurface StepSurface::of(const StepFile& file, int id) {
  const StepEntity& entity = file.at(id);
  StepSurface surface;
  const bool simple = entity.is("B_SPLINE_SURFACE_WITH_KNOTS") && entity.records.size() == 1;
  // A simple instance holds the name and all inherited attributes in one list, a complex one spreads them.
  const auto& base = simple ? entity.records.front().arguments : entity.record("B_SPLINE_SURFACE").arguments;
  const auto& knots = entity.record("B_SPLINE_SURFACE_WITH_KNOTS").arguments;
  const std::size_t b = simple ? 1 : 0;
  const std::size_t k = simple ? 8 : 0;
  surface.degree_u = base.at(b).integer();
  surface.degree_v = base.at(b + 1).integer();
  const auto& rows = base.at(b + 2).list();
  surface.count_u = static_cast<int>(rows.size());
  surface.count_v = static_cast<int>(rows.at(0).list().size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (std::size_t j = 0; j < static_cast<std::size_t>(surface.count_v); ++j) {
      Eigen::Vector4d point = Eigen::Vector4d::Ones();
      point.head<3>() = file.triple(rows[i].list().at(j).id());
      if (!simple) {
        const auto& weights = entity.record("RATIONAL_B_SPLINE_SURFACE").arguments.at(0).list();
        point.w() = weights.at(i).list().at(j).real();
      }
      surface.points.push_back(point);
    }
  }
  surface.knots_u = written_out(knots.at(k + 2), knots.at(k));
  surface.knots_v = written_out(knots.at(k + 3), knots.at(k + 1));
  if (static_cast<int>(surface.knots_u.size()) != surface.count_u + surface.degree_u + 1 ||
      static_cast<int>(surface.knots_v.size()) != surface.count_v + surface.degree_v + 1) {
    fail("knots do not fit the control points");
  }
  return surface;
}

Eigen::Vector3d StepSurface::evaluate(double u, double v) const {
  std::vector<Eigen::Vector4d> column;
  for (int i = 0; i < count_u; ++i) {
    std::vector<Eigen::Vector4d> row;
    for (int j = 0; j < count_v; ++j) {
      row.push_back(homogeneous(points[static_cast<std::size_t>(i * count_v + j)]));
    }
    column.push_back(de_boor(degree_v, knots_v, row, v));
  }
  return projected(de_boor(degree_u, knots_u, column, u));
}

StepCurve StepCurve::of(const StepFile& file, int id) {
  const StepEntity& entity = file.at(id);
  StepCurve curve;
  const bool simple = entity.records.size() == 1;
  const auto& base = simple ? entity.records.front().arguments : entity.record("B_SPLINE_CURVE").arguments;
  const auto& knots = entity.record("B_SPLINE_CURVE_WITH_KNOTS").arguments;
  const std::size_t b = simple ? 1 : 0;
  const std::size_t k = simple ? 6 : 0;
  curve.degree = base.at(b).integer();
  const auto& points = base.at(b + 1).list();
  for (std::size_t i = 0; i < points.size(); ++i) {
    Eigen::Vector4d point = Eigen::Vector4d::Ones();
    point.head<3>() = file.triple(points[i].id());
    if (!simple) {
      point.w() = entity.record("RATIONAL_B_SPLINE_CURVE").arguments.at(0).list().at(i).real();
    }
    curve.points.push_back(point);
  }
  curve.knots = written_out(knots.at(k + 1), knots.at(k));
  if (curve.knots.size() != curve.points.size() + static_cast<std::size_t>(curve.degree) + 1) {
    fail("knots do not fit the control points of a curve");
  }
  return curve;
}

Eigen::Vector3d StepCurve::evaluate(double t) const {
  std::vector<Eigen::Vector4d> row;
  for (const Eigen::Vector4d& point : points) {
    row.push_back(homogeneous(point));
  }
  return projected(de_boor(degree, knots, row, t));
}

}  // namespace celadon::testing
