// celadon cameras: what the cameras of this computer offer.

#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include <CLI/CLI.hpp>

#include "acquisition/v4l2_address.h"
#include "acquisition/v4l2_devices.h"
#include "daemon/cli/commands.h"

namespace celadon::cli {
namespace {

using nlohmann::ordered_json;

ordered_json json_of(const V4l2Device& device, const std::string& address) {
  ordered_json out{{"path", device.path},      {"address", address}, {"name", device.name},
                   {"driver", device.driver},  {"bus", device.bus},  {"serial", device.serial},
                   {"problem", device.problem}};
  out["formats"] = ordered_json::array();
  for (const V4l2Format& format : device.formats) {
    ordered_json sizes = ordered_json::array();
    for (const V4l2Size& size : format.sizes)
      sizes.push_back(
          {{"width", size.width_px}, {"height", size.height_px}, {"frames_per_second", size.frames_per_second}});
    out["formats"].push_back({{"fourcc", fourcc_text(format.fourcc)},
                              {"description", format.description},
                              {"usable", format.usable},
                              {"preferred", &format == preferred_format(device)},
                              {"sizes", sizes}});
  }
  out["controls"] = ordered_json::array();
  for (const V4l2Control& control : device.controls)
    out["controls"].push_back({{"name", control.name},
                               {"id", control.id},
                               {"minimum", control.minimum},
                               {"maximum", control.maximum},
                               {"step", control.step},
                               {"default", control.standard},
                               {"value", control.value ? ordered_json(*control.value) : ordered_json(nullptr)},
                               {"inactive", control.inactive},
                               {"menu", control.menu}});
  return out;
}

void print(const V4l2Device& device, const std::string& address) {
  if (!device.problem.empty()) {
    std::printf("%s\n  problem     %s\n", device.path.c_str(), device.problem.c_str());
    return;
  }
  std::printf("%s  %s%s%s (%s, %s)\n", device.path.c_str(), device.name.c_str(), device.serial.empty() ? "" : " ",
              device.serial.c_str(), device.driver.c_str(), device.bus.c_str());
  std::printf("  address     %s\n", address.c_str());
  const V4l2Format* const preferred = preferred_format(device);
  for (const V4l2Format& format : device.formats) {
    std::printf("  format      %s  %s%s\n", fourcc_text(format.fourcc).c_str(), format.description.c_str(),
                &format == preferred ? ", taken unless another is named"
                : format.usable      ? ""
                                     : ", not used");
    for (const V4l2Size& size : format.sizes) {
      std::printf("              %u x %u px", size.width_px, size.height_px);
      for (std::size_t k = 0; k < size.frames_per_second.size(); ++k)
        std::printf("%s%.4g", k == 0 ? "  " : ", ", size.frames_per_second[k]);
      std::printf("%s\n", size.frames_per_second.empty() ? "" : " frames/s");
    }
  }
  for (const V4l2Control& control : device.controls) {
    std::printf("  control     %s: ", control.name.c_str());
    const auto index = static_cast<std::size_t>(control.value.value_or(-1));
    if (!control.value) {
      std::printf("cannot be read");
    } else if (index < control.menu.size()) {
      std::printf("%s", control.menu[index].c_str());
    } else {
      std::printf("%lld", static_cast<long long>(*control.value));
    }
    std::printf(" (%lld to %lld%s)\n", static_cast<long long>(control.minimum), static_cast<long long>(control.maximum),
                control.inactive ? ", held by another control" : "");
  }
  if (preferred == nullptr) {
    std::printf("  problem     it cannot be scanned with: it delivers none of %s\n", usable_formats().c_str());
  }
}

int cameras(bool as_json) {
  const auto devices = list_v4l2_devices();
  if (as_json) {
    ordered_json all = ordered_json::array();
    for (const V4l2Device& device : devices) all.push_back(json_of(device, address_of(device, devices)));
    std::printf("%s\n", all.dump(-1, ' ', false, ordered_json::error_handler_t::replace).c_str());
  } else {
    for (const V4l2Device& device : devices) print(device, address_of(device, devices));
  }
  if (devices.empty())
    return fail(1, "this computer shows no camera; connect one, and see whether the kernel names a /dev/videoN for it");
  return 0;
}

}  // namespace

void add_cameras_command(CLI::App& program, Run& run) {
  auto as_json = std::make_shared<bool>(false);
  auto* command = program.add_subcommand(
      "cameras", "The V4L2 cameras of this computer: formats, sizes, frame rates and controls as they stand.");
  command->add_flag("--json", *as_json, "as one line of JSON");
  command->callback([as_json, &run] { run = [as_json] { return cameras(*as_json); }; });
}

}  // namespace celadon::cli
