#pragma once
// What profiles of drives and of I/O devices have in common: head, registers, conditions and actions, checked.

#include <optional>
#include <string>
#include <vector>

#include "acquisition/toml_section.h"
#include "firmware_bridge/drive_profile.h"

namespace celadon {

bool is_speed(DriveUnit unit);

/// One file under reading. Everything here refuses by checked_toml::Refusal, with file, line, field and remedy.
class ProfileFile {
 public:
  using Section = checked_toml::Section;
  static constexpr const char* kRemedy = "add it as DRIVE_PROFILES.md describes";

  /// @param format  that the file must be of
  ProfileFile(const toml::table& table, const std::string& name, const char* format);

  Section& root() { return root_; }
  /// At most 200 printable characters of ASCII.
  static std::string text(Section& section, const std::string& key);
  WordOrder word_order();
  /// All of them; what follows refers to them.
  std::vector<DriveRegister> registers();
  std::optional<std::size_t> host_watchdog();

  /// The register that a text of the section names.
  std::size_t index(Section& section, const std::string& key) const;
  DriveCondition condition(Section& within, const std::string& key) const;
  std::optional<DriveCondition> maybe(Section& within, const std::string& key) const;
  DriveCondition condition_of(Section& section) const;
  /// Empty where there is none.
  DriveAction action(Section& within, const std::string& key) const;

  /// Every table of an array, each as a section of its own.
  template <class Take>
  void each(Section& within, const std::string& key, std::size_t most, Take take) const {
    const toml::node& found = within.node(key);
    const auto* list = found.as_array();
    if (list == nullptr || list->size() > most)
      within.refuse(found, key, "must be an array of at most " + std::to_string(most) + " entries");
    for (std::size_t i = 0; i < list->size(); ++i) {
      const toml::node& entry = *list->get(i);
      const std::string place = key + "[" + std::to_string(i) + "]";
      if (!entry.is_table()) within.refuse(entry, place, "must be a table in braces");
      Section section(*entry.as_table(), name_, place, false, kRemedy);
      take(section);
      section.finish();
    }
  }

 private:
  static DriveRegister register_of(Section& section, const std::string& name);
  DriveWrite write_of(Section& section) const;

  std::string name_;
  Section root_;
  std::vector<DriveRegister> registers_;
};

}  // namespace celadon
