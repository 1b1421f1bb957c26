/// Private to devices: a plug-in's library, loaded: the host's side of devices/plugin.h.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/plugin.h"

namespace palpate {

/// Folders that plug-ins are looked for in, in this order: those of PALPATE_PLUGINS (colons
/// between), the user's own ($XDG_DATA_HOME/palpate/plugins or ~/.local/share/palpate/plugins), and
/// ../lib/palpate/plugins of the program.
[[nodiscard]] std::vector<std::filesystem::path> pluginFolders();
/// Names of the plug-ins there, sorted; of two of one name the first folder's counts.
[[nodiscard]] std::vector<std::string> pluginNames();
/// The file of a name. Throws DeviceError: there is none, and what there is; or anybody may write
/// it.
[[nodiscard]] std::filesystem::path pluginFile(const std::string& name);

/// What a plug-in may ask its host for.
struct PluginHost {
  std::function<void(const std::string&)> say = nullptr;  ///< May be empty.
  std::function<bool()> ends = nullptr;                   ///< May be empty.
};

class PluginDevice;

/// A plug-in in this process. All of it on one thread, and each file once.
class PluginLibrary {
 public:
  /// Loads it and calls its init. Throws DeviceError: it is none, or of another version.
  PluginLibrary(const std::filesystem::path& file, PluginHost host);
  ~PluginLibrary();
  PluginLibrary(const PluginLibrary&) = delete;
  PluginLibrary& operator=(const PluginLibrary&) = delete;

  [[nodiscard]] std::string what() const;     ///< palpate_plugin_entry::name.
  [[nodiscard]] std::string version() const;  ///< Its own.
  [[nodiscard]] std::string licence() const;  ///< May be empty.
  /// Those that are plugged in, at most kMostFound. Throws DeviceError: it cannot know.
  [[nodiscard]] std::vector<palpate_plugin_found> find() const;
  static constexpr std::size_t kMostFound = 32;
  /// The serial number of the one arm that is there, or of the one that `serial` names; empty where
  /// it has none that find() tells. Throws DeviceError where none is named: there is none, or
  /// several, which ones.
  [[nodiscard]] std::string only(const std::string& serial) const;
  /// Opens one. Throws DeviceError, in the plug-in's words.
  [[nodiscard]] PluginDevice open(const std::string& serial) const;

 private:
  void* handle_ = nullptr;
  const palpate_plugin_entry* entry_ = nullptr;
  const palpate_plugin_factory* factory_ = nullptr;
  std::string name_;
};

/// An arm of a plug-in, open; closed at its end. Threads as devices/plugin.h says.
class PluginDevice {
 public:
  explicit PluginDevice(palpate_plugin_device* device, std::string name);
  PluginDevice(PluginDevice&& other) noexcept;
  PluginDevice(const PluginDevice&) = delete;
  PluginDevice& operator=(const PluginDevice&) = delete;
  PluginDevice& operator=(PluginDevice&&) = delete;
  ~PluginDevice();

  /// Throws DeviceError where it does not say.
  [[nodiscard]] palpate_plugin_facts facts() const;
  /// Throws DeviceError, in the plug-in's words.
  void prepare() const;
  /// The most of its weight that it carries [N]; 0: none.
  [[nodiscard]] double carries() const noexcept { return weight_ != nullptr ? weight_->most : 0.0; }

  // RT, as far as the plug-in is.
  /// `reading` is as it was where nothing has come, whatever the plug-in has written there.
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
