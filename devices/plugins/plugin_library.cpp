#include "palpate/devices/plugins/plugin_library.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <dlfcn.h>
#include <mutex>
#include <set>
#include <sstream>
#include <sys/stat.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "palpate/devices/arm/user_folder.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {
namespace {

constexpr std::size_t kErrorRoom = 1024;
constexpr const char* kEnding = ".so";

/// Host of the plug-in that was loaded last; the C functions below use it.
PluginHost& hostNow() {
  static PluginHost host;
  return host;
}

extern "C" void sayToUser(const char* words) {
  if (words != nullptr && hostNow().say) hostNow().say(words);
}
extern "C" int askWhetherEnds() {
  return hostNow().ends && hostNow().ends() ? 1 : 0;
}
extern "C" int64_t tellTime() {
  return nowNs();
}
extern "C" const void* tellExtension(const char* /*name*/) {
  return nullptr;
}

constexpr palpate_plugin_host kHost{sizeof(palpate_plugin_host), sayToUser, askWhetherEnds,
                                    tellTime, tellExtension};

class Loaded {
 public:
  static bool add(const std::string& name) {
    const std::lock_guard lock(mutex());
    return names().insert(name).second;
  }
  static void remove(const std::string& name) {
    const std::lock_guard lock(mutex());
    names().erase(name);
  }

 private:
  static std::mutex& mutex() {
    static std::mutex own;
    return own;
  }
  static std::set<std::string>& names() {
    static std::set<std::string> own;
    return own;
  }
};

/// Returns true if a struct is large enough for the member that ends at `end`.
template <class Struct>
bool reaches(const Struct* what, std::size_t end) {
  return what != nullptr && what->size >= end;
}
#define PALPATE_REACHES(what, type, member) \
  reaches(what, offsetof(type, member) + sizeof(type::member))

/// Stops and closes an arm with an incomplete struct. Skips a function that the struct lacks.
void closeIncomplete(palpate_plugin_device* device) {
  if (PALPATE_REACHES(device, palpate_plugin_device, stop) && device->stop != nullptr) {
    device->stop(device);
  }
  if (PALPATE_REACHES(device, palpate_plugin_device, close) && device->close != nullptr) {
    device->close(device);
  }
}

std::string orNone(const char* text) {
  return text != nullptr ? text : "";
}

/// Returns true for 1 to 64 letters, digits, _ and -, without a - in front. So the name cannot be a
/// path or an option.
bool plain(const std::string& name) {
  return !name.empty() && name.size() <= 64 && name[0] != '-' &&
         std::all_of(name.begin(), name.end(),
                     [](unsigned char c) { return std::isalnum(c) != 0 || c == '_' || c == '-'; });
}

}  // namespace

std::vector<std::filesystem::path> pluginFolders() {
  std::vector<std::filesystem::path> folders;
  if (const char* given = secure_getenv("PALPATE_PLUGINS")) {
    std::istringstream parts(given);
    for (std::string part; std::getline(parts, part, ':');) {
      if (part[0] == '/') folders.emplace_back(part);
    }
  }
  folders.push_back(userFolder("XDG_DATA_HOME", ".local/share") / "palpate/plugins");
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  if (!error) folders.push_back(self.parent_path().parent_path() / "lib/palpate/plugins");
  return folders;
}

std::vector<std::string> pluginNames() {
  std::vector<std::string> names;
  for (const auto& folder : pluginFolders()) {
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
      if (entry.path().extension() != kEnding) continue;
      const std::string name = entry.path().stem();
      if (plain(name)) names.push_back(name);
    }
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

std::filesystem::path pluginFile(const std::string& name) {
  if (!plain(name)) {
    throw DeviceError("plugin:" + name, "it is not the name of a plug-in",
                      "give 1 to 64 letters, digits, _ and -, such as the name of its file "
                      "without .so");
  }
  for (const auto& folder : pluginFolders()) {
    const std::filesystem::path file = folder / (name + kEnding);
    std::error_code error;
    if (!std::filesystem::is_regular_file(file, error)) continue;
    // Resolves links, because the target of a link is the file that is loaded.
    std::filesystem::path real = std::filesystem::canonical(file, error);
    for (const auto& what : {real, real.parent_path()}) {
      struct stat facts {};
      const bool known = !error && stat(what.c_str(), &facts) == 0;
      const bool ours = known && (facts.st_uid == geteuid() || facts.st_uid == 0);
      if (!ours || (facts.st_mode & (S_IWOTH | S_IWGRP)) != 0) {
        throw DeviceError("plugin:" + name, "other users can write " + what.string(),
                          "make it your own: chown, chmod go-w " + what.string());
      }
    }
    return real;
  }
  std::string there;
  for (const std::string& one : pluginNames()) there += (there.empty() ? "" : ", ") + one;
  std::string where;
  for (const auto& folder : pluginFolders())
    where += (where.empty() ? "" : " or ") + folder.string();
  throw DeviceError("plugin:" + name, "this plug-in is not installed",
                    (there.empty() ? "" : "use " + there + ", or ") + "put it into " + where);
}

PluginLibrary::PluginLibrary(const std::filesystem::path& file, PluginHost host)
    : name_("plugin:" + file.stem().string()) {
  if (!Loaded::add(name_)) {
    throw DeviceError(name_, "another hand already runs this plug-in inside this program",
                      "use " + name_ + " for this hand: it then runs in a process of its own");
  }
  try {
    handle_ = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (handle_ == nullptr) {
      throw DeviceError(name_, orNone(dlerror()), "install what it needs, or build it again");
    }
    entry_ = static_cast<const palpate_plugin_entry*>(dlsym(handle_, "palpate_plugin"));
    if (entry_ == nullptr) {
      throw DeviceError(name_, file.string() + " is not a plug-in: it has no symbol palpate_plugin",
                        "see docs/plugins.md");
    }
    if (!PALPATE_REACHES(entry_, palpate_plugin_entry, factory)) {
      throw DeviceError(name_,
                        "the size in its palpate_plugin_entry is " + std::to_string(entry_->size) +
                            " bytes, which is too small",
                        "set size to sizeof(palpate_plugin_entry)");
    }
    if (entry_->major != PALPATE_PLUGIN_MAJOR || entry_->minor > PALPATE_PLUGIN_MINOR) {
      throw DeviceError(name_,
                        "it was built with version " + std::to_string(entry_->major) + "." +
                            std::to_string(entry_->minor) + " of plugin.h, and this program has " +
                            std::to_string(PALPATE_PLUGIN_MAJOR) + "." +
                            std::to_string(PALPATE_PLUGIN_MINOR),
                        "build it again with the plugin.h of this program");
    }
    hostNow() = std::move(host);
    if (entry_->init == nullptr) {
      throw DeviceError(name_, "the function init of its palpate_plugin_entry is missing",
                        "set this function in the plug-in");
    }
    if (entry_->init(&kHost) != 0) {
      throw DeviceError(name_, "its function init failed", "read the messages of the plug-in");
    }
    const void* factory =
        entry_->factory != nullptr ? entry_->factory(PALPATE_PLUGIN_ARMS) : nullptr;
    factory_ = static_cast<const palpate_plugin_factory*>(factory);
    if (!PALPATE_REACHES(factory_, palpate_plugin_factory, open) || factory_->find == nullptr ||
        factory_->open == nullptr) {
      if (entry_->end != nullptr) entry_->end();
      throw DeviceError(name_, "it does not provide arms", "see docs/plugins.md");
    }
  } catch (...) {
    if (handle_ != nullptr) dlclose(handle_);
    hostNow() = {};
    Loaded::remove(name_);
    throw;
  }
}

PluginLibrary::~PluginLibrary() {
  if (entry_->end != nullptr) entry_->end();
  dlclose(handle_);
  hostNow() = {};
  Loaded::remove(name_);
}

std::string PluginLibrary::what() const {
  return orNone(entry_->name);
}
std::string PluginLibrary::version() const {
  return orNone(entry_->version);
}
std::string PluginLibrary::licence() const {
  return orNone(entry_->licence);
}

std::vector<palpate_plugin_found> PluginLibrary::find() const {
  std::vector<palpate_plugin_found> found(kMostFound);
  for (palpate_plugin_found& one : found) one = {sizeof(palpate_plugin_found), {}, {}};
  const int count = factory_->find(found.data(), static_cast<int>(kMostFound));
  if (count < 0)
    throw DeviceError(name_, "its search for arms failed", "read the messages of the plug-in");
  found.resize(std::min(static_cast<std::size_t>(count), kMostFound));
  for (palpate_plugin_found& one : found) {
    one.serial[sizeof(one.serial) - 1] = one.model[sizeof(one.model) - 1] = '\0';
  }
  return found;
}

std::string PluginLibrary::only(const std::string& serial) const {
  const std::vector<palpate_plugin_found> found = find();
  std::string which;
  for (const palpate_plugin_found& one : found) {
    if (!serial.empty() && serial == one.serial) return serial;
    which += (which.empty() ? "" : ", ") + name_ + "@" + one.serial;
  }
  // The plug-in's open() may accept a serial number that find() does not list.
  if (!serial.empty()) return {};
  if (found.empty())
    throw DeviceError(name_, "it finds no arm", "plug the arm in, and switch it on");
  if (found.size() > 1) throw DeviceError(name_, "several arms match", "name one of " + which);
  return found[0].serial;
}

PluginDevice PluginLibrary::open(const std::string& serial) const {
  std::array<char, kErrorRoom> error{};
  palpate_plugin_device* device = factory_->open(serial.c_str(), error.data(), error.size() - 1);
  const std::string arm = name_ + (serial.empty() ? "" : "@" + serial);
  if (device == nullptr) {
    throw DeviceError(arm, error[0] != '\0' ? error.data() : "it does not open",
                      "check the plug-in's requirements");
  }
  // The arm is open already, and its motors may have power.
  const auto refuse = [&](const std::string& why, const std::string& remedy) {
    closeIncomplete(device);
    throw DeviceError(arm, why, remedy);
  };
  if (!PALPATE_REACHES(device, palpate_plugin_device, extension)) {
    refuse("the size in its palpate_plugin_device is " + std::to_string(device->size) +
               " bytes, which is too small",
           "set size to sizeof(palpate_plugin_device)");
  }
  const std::pair<const char*, bool> functions[] = {
      {"facts", device->facts != nullptr}, {"prepare", device->prepare != nullptr},
      {"read", device->read != nullptr},   {"write", device->write != nullptr},
      {"stop", device->stop != nullptr},   {"close", device->close != nullptr}};
  for (const auto& [function, given] : functions) {
    if (given) continue;
    refuse("the function " + std::string(function) + " of its palpate_plugin_device is missing",
           "set this function in the plug-in");
  }
  return PluginDevice(device, arm);
}

PluginDevice::PluginDevice(palpate_plugin_device* device, std::string name)
    : device_(device), name_(std::move(name)) {
  if (device_->extension == nullptr) return;
  const auto* weight =
      static_cast<const palpate_plugin_weight*>(device_->extension(device_, PALPATE_PLUGIN_WEIGHT));
  const auto* heat =
      static_cast<const palpate_plugin_heat*>(device_->extension(device_, PALPATE_PLUGIN_HEAT));
  if (PALPATE_REACHES(weight, palpate_plugin_weight, most) && weight->carry != nullptr) {
    weight_ = weight;
  }
  if (PALPATE_REACHES(heat, palpate_plugin_heat, given) && heat->given != nullptr) heat_ = heat;
}

PluginDevice::PluginDevice(PluginDevice&& other) noexcept
    : device_(std::exchange(other.device_, nullptr)),
      name_(std::move(other.name_)),
      weight_(other.weight_),
      heat_(other.heat_) {}

PluginDevice::~PluginDevice() {
  if (device_ == nullptr) return;
  device_->stop(device_);
  device_->close(device_);
}

palpate_plugin_facts PluginDevice::facts() const {
  palpate_plugin_facts facts{};
  facts.size = sizeof(facts);
  if (device_->facts(device_, &facts) != PALPATE_PLUGIN_OK) {
    throw DeviceError(name_, "it does not report its properties",
                      "read the messages of the plug-in");
  }
  facts.size = sizeof(facts);
  facts.source[sizeof(facts.source) - 1] = '\0';
  for (auto& name : facts.button) name[sizeof(name) - 1] = '\0';
  return facts;
}

void PluginDevice::prepare() const {
  std::array<char, kErrorRoom> error{};
  if (device_->prepare(device_, error.data(), error.size() - 1) != PALPATE_PLUGIN_OK) {
    throw DeviceError(name_, error[0] != '\0' ? error.data() : "it cannot be prepared",
                      "check the plug-in's requirements");
  }
}

}  // namespace palpate
