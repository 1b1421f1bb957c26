/// Private to devices: a loaded plug-in library, that is, the host's side of
/// devices/plugins/plugin.h.
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
/// Returns the sorted names of the plug-ins in these folders. If a name occurs in two folders, the
/// file in the first of them is used.
[[nodiscard]] std::vector<std::string> pluginNames();
/// Returns the file of a plug-in by its name. Throws DeviceError if the file does not exist or if
/// other users may write it. For a missing file, the error lists the existing plug-ins.
[[nodiscard]] std::filesystem::path pluginFile(const std::string& name);

/// Functions of the host that a plug-in may call.
struct PluginHost {
  /// Prints a line for the user. May be empty.
  std::function<void(const std::string&)> say = nullptr;
  /// Returns true if the user has ended the program. May be empty.
  std::function<bool()> ends = nullptr;
};

class PluginDevice;

/// A plug-in in this process. Use each object on one thread only. A file can be loaded only once at
/// a time.
class PluginLibrary {
 public:
  /// Loads the library and calls its init. Throws DeviceError if the file is not a plug-in, or is
  /// one of another version.
  PluginLibrary(const std::filesystem::path& file, PluginHost host);
  ~PluginLibrary();
  PluginLibrary(const PluginLibrary&) = delete;
  PluginLibrary& operator=(const PluginLibrary&) = delete;

  [[nodiscard]] std::string what() const;     ///< Returns palpate_plugin_entry::name.
  [[nodiscard]] std::string version() const;  ///< Returns the version of the plug-in.
  [[nodiscard]] std::string licence() const;  ///< Returns the licence; may be empty.
  /// Returns the arms that are plugged in, at most kMostFound. Throws DeviceError if the plug-in
  /// cannot list them.
  [[nodiscard]] std::vector<palpate_plugin_found> find() const;
  static constexpr std::size_t kMostFound = 32;
  /// If `serial` is empty, returns the serial number of the only arm that is plugged in. Otherwise
  /// returns `serial` if find() lists it, else an empty text. If `serial` is empty and find() gives
  /// no arm or several, throws DeviceError that names the arms.
  [[nodiscard]] std::string only(const std::string& serial) const;
  /// Opens an arm. On failure throws DeviceError with the plug-in's message.
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

  /// Returns the arm's facts. Throws DeviceError if the plug-in does not give them.
  [[nodiscard]] palpate_plugin_facts facts() const;
  /// Makes the arm ready. On failure throws DeviceError with the plug-in's message.
  void prepare() const;
  /// Returns the largest weight that the arm's motors can carry [N]; 0: they carry no weight.
  [[nodiscard]] double carries() const noexcept { return weight_ != nullptr ? weight_->most : 0.0; }

  // RT, if the plug-in's function is.
  // If no new reading has come, `reading` stays unchanged, even if the plug-in has written into it.
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
