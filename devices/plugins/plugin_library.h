/// Private to devices: the host's side of devices/plugins/plugin.h.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/plugins/plugin.h"

namespace palpate {

/// Returns the folders of plug-ins, in search order: those of PALPATE_PLUGINS (absolute paths,
/// separated by colons), the user's own ($XDG_DATA_HOME/palpate/plugins or
/// ~/.local/share/palpate/plugins), and ../lib/palpate/plugins of the program.
[[nodiscard]] std::vector<std::filesystem::path> pluginFolders();
/// Returns the sorted names of the plug-ins. Of files with equal names, pluginFile() returns the
/// first in the search order.
[[nodiscard]] std::vector<std::string> pluginNames();
/// Returns the plug-in's file. Throws DeviceError if the name is not valid, if the file does not
/// exist (the error lists the existing plug-ins), or if other users may write the file or its
/// folder.
[[nodiscard]] std::filesystem::path pluginFile(const std::string& name);

struct PluginHost {
  /// Prints a line for the user. May be empty.
  std::function<void(const std::string&)> say = nullptr;
  /// Returns true if the user has ended the program. May be empty.
  std::function<bool()> ends = nullptr;
};

class PluginDevice;

/// A plug-in that is loaded into this process. Use each object on one thread; load a file only once
/// at a time.
class PluginLibrary {
 public:
  /// Loads and initialises the plug-in. Throws DeviceError if the file is not a plug-in, is of
  /// another version, is loaded already, or fails.
  PluginLibrary(const std::filesystem::path& file, PluginHost host);
  ~PluginLibrary();
  PluginLibrary(const PluginLibrary&) = delete;
  PluginLibrary& operator=(const PluginLibrary&) = delete;

  [[nodiscard]] std::string what() const;  ///< Returns palpate_plugin_entry::name.
  [[nodiscard]] std::string version() const;
  [[nodiscard]] std::string licence() const;
  /// Returns the plugged-in arms, at most kMostFound. Throws DeviceError if it cannot list them.
  [[nodiscard]] std::vector<palpate_plugin_found> find() const;
  static constexpr std::size_t kMostFound = 32;
  /// Returns `serial` if find() lists it, else an empty text. For an empty `serial` returns the
  /// serial number of the only arm; throws DeviceError for several arms, or without an arm.
  [[nodiscard]] std::string only(const std::string& serial) const;
  [[nodiscard]] PluginDevice open(const std::string& serial) const;

 private:
  void* handle_ = nullptr;
  const palpate_plugin_entry* entry_ = nullptr;
  const palpate_plugin_factory* factory_ = nullptr;
  std::string name_;
};

/// An open arm of a plug-in; the destructor closes it. Threads as in devices/plugins/plugin.h.
class PluginDevice {
 public:
  explicit PluginDevice(palpate_plugin_device* device, std::string name);
  PluginDevice(PluginDevice&& other) noexcept;
  PluginDevice(const PluginDevice&) = delete;
  PluginDevice& operator=(const PluginDevice&) = delete;
  PluginDevice& operator=(PluginDevice&&) = delete;
  ~PluginDevice();

  [[nodiscard]] palpate_plugin_facts facts() const;
  void prepare() const;
  /// Returns the largest weight that the motors can carry [N], or 0.
  [[nodiscard]] double carries() const noexcept { return weight_ != nullptr ? weight_->most : 0.0; }

  // The next four functions: RT, if the plug-in's functions are.

  /// Reads the newest reading. Unless a new reading has come, `reading` stays unchanged, even if
  /// the plug-in has written into it.
  [[nodiscard]] int read(palpate_plugin_reading& reading) const noexcept {
    palpate_plugin_reading next = reading;
    next.size = sizeof(next);
    const int got = device_->read(device_, &next);
    if (got == PALPATE_PLUGIN_OK) reading = next;
    return got > PALPATE_PLUGIN_OK ? PALPATE_PLUGIN_NOTHING : got;
  }
  [[nodiscard]] int write(const palpate_plugin_force& force) const noexcept {
    return device_->write(device_, &force);
  }
  void carry(double share) const noexcept {
    if (weight_ != nullptr) weight_->carry(device_, share);
  }
  [[nodiscard]] double given() const noexcept {
    return heat_ != nullptr ? heat_->given(device_) : 1.0;
  }
  void stop() const noexcept { device_->stop(device_); }

 private:
  palpate_plugin_device* device_;
  std::string name_;
  const palpate_plugin_weight* weight_ = nullptr;
  const palpate_plugin_heat* heat_ = nullptr;
};

}  // namespace palpate
