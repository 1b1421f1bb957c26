/// Opens plug-ins, in their own process or in this one.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/plugins/plugin_arm.h"

namespace palpate {

/// The parts of `plugin:NAME`, `plugin-inside:NAME`, and of both with `@SERIAL`.
struct PluginName {
  std::string name;     ///< NAME; the plug-in's file is NAME.so.
  std::string serial;   ///< Empty: any arm.
  bool inside = false;  ///< The plug-in runs in the program's own process.
};
/// Parses a device's name. Returns nullopt if the name is not that of a plug-in's arm.
[[nodiscard]] std::optional<PluginName> parsePluginName(const std::string& name);

/// An arm that a plug-in has found.
struct FoundPluginArm {
  std::string serial;                         ///< Serial number; may be empty.
  std::string model;                          ///< Model, as text for the user.
  std::optional<palpate_plugin_facts> facts;  ///< Facts; missing if the arm could not be opened.
  double carries = 0.0;                       ///< PluginPort::carries.
  std::string trouble;                        ///< Why the arm could not be opened, in one line.
};
/// An installed plug-in, and the arms that it has found.
struct FoundPlugin {
  std::string name;                  ///< NAME in `plugin:NAME`.
  std::filesystem::path file;        ///< File that is loaded.
  std::string what;                  ///< Purpose, in the plug-in's words.
  std::string version;               ///< Version, in the plug-in's words.
  std::string licence;               ///< Licence, in the plug-in's words.
  std::vector<FoundPluginArm> arms;  ///< Arms that are plugged in.
  /// Why the plug-in cannot be used, in one line; empty if it can.
  std::string trouble;
};
/// Queries all plug-ins, each in its own process for at most `patience` [s]. Lists arms that are in
/// use without their facts.
[[nodiscard]] std::vector<FoundPlugin> findPlugins(double patience = 5.0);

/// Opens an arm of a plug-in, in a process of palpate-plugin. If the plug-in crashes or hangs, the
/// force is taken off and the process is restarted. Throws DeviceError. May take minutes, because
/// an arm may home itself. `program` is the file of palpate-plugin; if empty, palpate-plugin in
/// this program's folder.
[[nodiscard]] std::unique_ptr<PluginPort> openPluginProcess(
    const std::filesystem::path& file, const std::string& serial, const ArmHost& host,
    const std::filesystem::path& program = {});

/// Opens an arm in this process. If the plug-in fails, the program fails, and no other process
/// takes the force off. Throws DeviceError, also for an arm with motors but without a watchdog of
/// at most kLongestWatchdog.
[[nodiscard]] std::unique_ptr<PluginPort> openPluginInside(const std::filesystem::path& file,
                                                           const std::string& serial,
                                                           const ArmHost& host);
inline constexpr double kLongestWatchdog = 0.05;  ///< [s]

/// Opens an arm by its name, like openArm. Throws DeviceError.
[[nodiscard]] OpenedArm openPluginArm(const std::string& name, const ArmHost& host);

}  // namespace palpate
