/// Opens plug-ins: in a process of their own, or in this one.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/open_arm.h"
#include "palpate/devices/plugin_arm.h"

namespace palpate {

/// `plugin:NAME`, `plugin:NAME@SERIAL`, or with `plugin-inside`, taken apart.
struct PluginName {
  std::string name;     ///< Of the file NAME.so.
  std::string serial;   ///< Empty: any arm.
  bool inside = false;  ///< In the program's own process.
};
/// Nothing where it names no plug-in.
[[nodiscard]] std::optional<PluginName> parsePluginName(const std::string& name);

/// An arm that a plug-in has found.
struct FoundPluginArm {
  std::string serial;                         ///< May be empty.
  std::string model;                          ///< Words.
  std::optional<palpate_plugin_facts> facts;  ///< Where it could be opened.
  double carries = 0.0;                       ///< PluginPort::carries.
  std::string trouble;                        ///< Why not, in a line.
};
/// A plug-in that is installed, and what it has found.
struct FoundPlugin {
  std::string name;                  ///< As `plugin:NAME`.
  std::filesystem::path file;        ///< What is loaded.
  std::string what;                  ///< What it is for,
  std::string version;               ///< which it is,
  std::string licence;               ///< and by what licence, in its own words.
  std::vector<FoundPluginArm> arms;  ///< Those that are plugged in.
  std::string trouble;               ///< Why it cannot be used, in a line; empty: it can.
};
/// All that are installed, each asked in a process of its own, and given up after `patience` [s].
/// An arm that a program has is not opened.
[[nodiscard]] std::vector<FoundPlugin> findPlugins(double patience = 5.0);

/// Opens an arm of a plug-in that is not loaded into this process but into palpate-plugin, beside
/// this program: where it crashes or hangs its force is taken off, and it is started anew. Throws
/// DeviceError: what is wrong, in a line. May take minutes: an arm may home itself.
///
/// @param program  palpate-plugin; empty: the one beside this program.
[[nodiscard]] std::unique_ptr<PluginPort> openPluginProcess(
    const std::filesystem::path& file, const std::string& serial, const ArmHost& host,
    const std::filesystem::path& program = {});

/// Opens one in this process: what it does wrong the program does wrong, and nobody takes its force
/// off when the program dies. Throws DeviceError, also where the arm has no watchdog of its own
/// that does that within kLongestWatchdog.
[[nodiscard]] std::unique_ptr<PluginPort> openPluginInside(const std::filesystem::path& file,
                                                           const std::string& serial,
                                                           const ArmHost& host);
inline constexpr double kLongestWatchdog = 0.05;  ///< [s]

/// An arm by its name, tested or not, as openArm. Throws DeviceError.
[[nodiscard]] OpenedArm openPluginArm(const std::string& name, const ArmHost& host);

}  // namespace palpate
