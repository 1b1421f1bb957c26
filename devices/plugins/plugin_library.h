/// Private to devices: a loaded plug-in library: the host's side of devices/plugins/plugin.h.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/plugins/plugin.h"

namespace palpate {

/// Returns the folders of plug-ins, in search order: those of PALPATE_PLUGINS (separated by
/// colons), the user's own ($XDG_DATA_HOME/palpate/plugins or ~/.local/share/palpate/plugins), and
/// ../lib/palpate/plugins of the program.
[[nodiscard]] std::vector<std::filesystem::path> pluginFolders();
/// Returns the names of the plug-ins there, sorted. If two have the same name, the one in the first
/// folder is used.
[[nodiscard]] std::vector<std::string> pluginNames();
/// Returns the file of a plug-in by its name. Throws DeviceError if the file does not exist (with a
/// list of the plug-ins that do), or if other users may write it.
[[nodiscard]] std::filesystem::path pluginFile(const std::string& name);

/// Functions of the host that a plug-in may call.
struct PluginHost {
  std::function<void(const std::string&)> say = nullptr;  ///< May be empty.
  std::function<bool()> ends = nullptr;                   ///< May be empty.
};

class PluginDevice;

/// A plug-in in this process. Use each object on one thread only; each file can be loaded once at a
/// time.
class PluginLibrary {
 public:
  /// Loads the library and calls its init. Throws DeviceError if it is not a plug-in, or of another
  /// version.
  PluginLibrary(const std::filesystem::path& file, PluginHost host);
  ~PluginLibrary();
  PluginLibrary(const PluginLibrary&) = delete;
  PluginLibrary& operator=(const PluginLibrary&) = delete;

  [[nodiscard]] std::string what() const;     ///< palpate_plugin_entry::name.
  [[nodiscard]] std::string version() const;  ///< Version of the plug-in.
  [[nodiscard]] std::string licence() const;  ///< May be empty.
  /// Returns the arms that are plugged in, at most kMostFound. Throws DeviceError if the plug-in
  /// cannot find out.
  [[nodiscard]] std::vector<palpate_plugin_found> find() const;
  static constexpr std::size_t kMostFound = 32;
  /// Returns the serial number of the only arm that is plugged in, or of the arm that `serial`
  /// names; empty if find() does not list it. Throws DeviceError if `serial` is empty and find()
  /// gives no arm or several; the error names them.
  [[nodiscard]] std::string only(const std::string& serial) const;
  /// Opens an arm. Throws DeviceError with the plug-in's message.
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

  /// Throws DeviceError if the plug-in does not give its facts.
  [[nodiscard]] palpate_plugin_facts facts() const;
  /// Throws DeviceError with the plug-in's message.
  void prepare() const;
  /// Returns the largest weight that the arm's motors carry [N]; 0: they carry no weight.
  [[nodiscard]] double carries() const noexcept { return weight_ != nullptr ? weight_->most : 0.0; }

  // RT, as far as the plug-in is.
  /// Keeps `reading` as it was if no new one has come, even if the plug-in has written into it.
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
