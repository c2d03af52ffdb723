#include "daemon/checks/artefact.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <set>

#include "acquisition/toml_section.h"

namespace celadon {
namespace {

using checked_toml::excerpt;
using checked_toml::number_text;
using checked_toml::Refusal;
using checked_toml::Section;
using checked_toml::value_text;

constexpr const char* kFormat = "celadon-artefact";
constexpr int kMajor = 1, kMinor = 0;
constexpr const char* kRemedy = "add it as ARTEFACT.md describes";
constexpr std::size_t kLargestFile = 1 << 20, kMostSpheres = 32;
constexpr double kSmallest_mm = 1, kLargest_mm = 1000;
constexpr double kRoughly_mm = 3;  // centres are to be known to a millimetre

void check_size(const Section& section, const toml::node& where, const std::string& field, double value_mm) {
  if (value_mm >= kSmallest_mm && value_mm <= kLargest_mm) return;
  section.refuse(where, field,
                 "is " + number_text(value_mm) + " and must be a length of 1 to 1000 mm; correct the number");
}

Measured length_of(Section& section, const std::string& key) {
  const Measured length = section.positive(key);
  check_size(section, section.node(key), key, length.value);
  return length;
}

double side_of(Section& section, const std::string& key) {
  const double side_mm = section.number(key);
  check_size(section, section.node(key), key, side_mm);
  return side_mm;
}

double certified_form_of(Section& section) {
  if (!section.has("form_mm")) return 0;
  const double form_mm = section.number("form_mm");
  if (!(form_mm >= 0 && form_mm <= kLargest_mm)) {
    section.refuse(section.node("form_mm"), "form_mm",
                   "is " + number_text(form_mm) + " and must be a deviation of 0 mm or more; correct the number");
  }
  return form_mm;
}

/// The tables of an array; none if it is not there.
std::vector<Section> tables_of(Section& root, const std::string& key, const std::string& file, bool newer) {
  std::vector<Section> out;
  if (!root.has(key)) return out;
  const toml::node& found = root.node(key);
  const toml::array* const list = found.as_array();
  if (list == nullptr || !list->is_homogeneous(toml::node_type::table)) {
    root.refuse(found, key, "is " + value_text(found) + " and must be tables [[" + key + "]]; write each as one");
  }
  for (std::size_t i = 0; i < list->size(); ++i) {
    out.emplace_back(*list->get(i)->as_table(), file, key + "[" + std::to_string(i) + "]", newer, kRemedy);
  }
  return out;
}

CertifiedSphere sphere_of(Section& section) {
  CertifiedSphere sphere;
  sphere.name = section.text("name");
  sphere.centre_mm = section.vector("centre_mm");
  sphere.diameter = length_of(section, "diameter");
  sphere.form_mm = certified_form_of(section);
  section.finish();
  if (sphere.centre_mm.cwiseAbs().maxCoeff() > kLargest_mm) {
    section.refuse(section.node("centre_mm"), "centre_mm", "lies more than 1000 mm away; correct the numbers");
  }
  return sphere;
}

CertifiedSpacing spacing_of(Section& section, const std::vector<CertifiedSphere>& spheres) {
  const std::vector<std::string> between = section.texts("between");
  const toml::node& where = section.node("between");
  if (between.size() != 2 || between[0] == between[1]) {
    section.refuse(where, "between", "must name two different spheres, as [\"A\", \"B\"]");
  }
  const auto number_of = [&](const std::string& name) {
    const auto found =
        std::find_if(spheres.begin(), spheres.end(), [&](const CertifiedSphere& s) { return s.name == name; });
    if (found == spheres.end()) {
      section.refuse(where, "between",
                     "names " + excerpt(name) + ", which is no sphere of this file; correct the name");
    }
    return static_cast<std::size_t>(found - spheres.begin());
  };
  CertifiedSpacing spacing{number_of(between[0]), number_of(between[1]), length_of(section, "distance")};
  section.finish();
  const double apart_mm = (spheres[spacing.first].centre_mm - spheres[spacing.second].centre_mm).norm();
  if (std::abs(apart_mm - spacing.distance.value) > kRoughly_mm) {
    section.refuse(section.node("distance"), "distance",
                   "is " + number_text(spacing.distance.value) + ", but the centres of " + between[0] + " and " +
                       between[1] + " lie " + number_text(std::round(apart_mm * 1000) / 1000) +
                       " mm apart; correct centre_mm or the distance");
  }
  return spacing;
}

CertifiedFlat flat_of(Section section) {
  CertifiedFlat flat;
  flat.centre_mm = section.vector("centre_mm");
  flat.normal = section.vector("normal");
  flat.width_mm = side_of(section, "width_mm");
  flat.height_mm = side_of(section, "height_mm");
  flat.form_mm = certified_form_of(section);
  section.finish();
  constexpr double kUnit = 1e-3;
  const double length = flat.normal.norm();
  if (!(std::abs(length - 1) < kUnit)) {
    section.refuse(section.node("normal"), "normal",
                   "has the length " + number_text(length) + " and must have 1; divide it by that");
  }
  flat.normal /= length;
  return flat;
}

PermissibleErrors permissible_of(Section section) {
  PermissibleErrors out;
  for (const Characteristic c : kCharacteristics) {
    const std::string key = std::string(to_string(c)) + "_mm";
    if (!section.has(key)) continue;
    const double value = section.number(key);
    if (!(value > 0)) section.refuse(section.node(key), key, "must be above 0; leave it out where nothing is stated");
    out.of(c) = value;
  }
  section.finish();
  return out;
}

/// Whether the version is a newer minor one, whose keys may be unknown.
bool is_newer(Section& root) {
  if (const std::string format = root.text("format"); format != kFormat) {
    root.refuse(root.node("format"), "format",
                "is " + excerpt(format) + " and must be \"celadon-artefact\"; give the file of an artefact");
  }
  const std::string version = root.text("version");
  int major = 0, minor = 0;
  char rest = 0;
  if (std::sscanf(version.c_str(), "%d.%d%c", &major, &minor, &rest) != 2 || major != kMajor || minor < 0) {
    root.refuse(root.node("version"), "version",
                "is " + excerpt(version) + " and must be \"1.0\"; this program reads versions 1 alone");
  }
  return minor > kMinor;
}

Artefact artefact_of(const toml::table& table, const std::string& file) {
  Section root(table, file, "", false, kRemedy);
  const bool newer = is_newer(root);
  root.set_newer(newer);
  Artefact out;
  out.name = root.text("name");
  if (root.has("certificate")) out.certificate = root.text("certificate");
  std::set<std::string> names;
  for (Section& section : tables_of(root, "sphere", file, newer)) {
    out.spheres.push_back(sphere_of(section));
    if (!names.insert(out.spheres.back().name).second) {
      section.refuse(section.node("name"), "name", "is that of an earlier sphere; give each a name of its own");
    }
  }
  if (out.spheres.size() < 2 || out.spheres.size() > kMostSpheres) {
    root.refuse(
        table, "sphere",
        "there are " + std::to_string(out.spheres.size()) + " spheres and must be 2 to 32; one alone shows no length");
  }
  std::set<std::set<std::size_t>> pairs;
  for (Section& section : tables_of(root, "spacing", file, newer)) {
    out.spacings.push_back(spacing_of(section, out.spheres));
    if (!pairs.insert({out.spacings.back().first, out.spacings.back().second}).second) {
      section.refuse(section.node("between"), "between", "are those of an earlier spacing; leave one of them out");
    }
  }
  if (root.has("flat")) out.flat = flat_of(root.section("flat"));
  if (root.has("permissible")) out.permissible = permissible_of(root.section("permissible"));
  root.finish();
  return out;
}

}  // namespace

const char* to_string(Characteristic characteristic) {
  switch (characteristic) {
    case Characteristic::form:
      return "form";
    case Characteristic::form95:
      return "form95";
    case Characteristic::size:
      return "size";
    case Characteristic::spacing:
      return "spacing";
    case Characteristic::flatness:
      return "flatness";
    case Characteristic::flatness95:
      break;
  }
  return "flatness95";
}

tl::expected<Artefact, std::string> parse_artefact(const std::string& text, const std::string& name) {
  if (text.size() > kLargestFile) {
    return tl::unexpected(name + " is longer than 1 MiB and cannot be an artefact's file; give the right file");
  }
  const auto parsed = checked_toml::parse_ascii(text);
  if (!parsed) return tl::unexpected(name + ", " + parsed.error());
  try {
    return artefact_of(*parsed, name);
  } catch (const Refusal& refusal) {
    return tl::unexpected(refusal.message);
  }
}

tl::expected<Artefact, std::string> read_artefact(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::error_code error;
  if (!in || std::filesystem::is_directory(file, error)) {
    return tl::unexpected("artefact '" + file.string() + "' cannot be opened; give a file as ARTEFACT.md describes");
  }
  return parse_artefact(std::string(std::istreambuf_iterator<char>(in), {}), "artefact " + file.string());
}

tl::expected<void, std::string> parse_permissible(const std::string& text, PermissibleErrors& permissible) {
  std::set<std::string> given;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    const std::string field = text.substr(at, end - at);
    at = end + 1;
    const std::string name = field.substr(0, field.find('='));
    const auto known = std::find_if(kCharacteristics.begin(), kCharacteristics.end(),
                                    [&](Characteristic c) { return name == to_string(c); });
    double value = 0;
    const char* const digits = field.data() + std::min(name.size() + 1, field.size());
    const auto [rest, problem] = std::from_chars(digits, field.data() + field.size(), value);
    const bool number = problem == std::errc() && rest == field.data() + field.size();
    if (known == kCharacteristics.end() || !number || !(value > 0) || !std::isfinite(value)) {
      return tl::unexpected("the maximum permissible error '" + field +
                            "' is none; write form=0.1,form95=0.05,size=0.05,spacing=0.05,flatness=0.1,flatness95=0.05 "
                            "or some of them, in mm");
    }
    if (!given.insert(name).second) {
      return tl::unexpected("the maximum permissible error of " + name + " is given twice; leave one out");
    }
    permissible.of(*known) = value;
  }
  return {};
}

}  // namespace celadon
