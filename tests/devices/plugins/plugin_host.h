/// A host for tests of plug-ins: loads a plug-in, stores its messages, and gives it a clock that
/// the test sets.
#pragma once

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <dlfcn.h>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/devices/plugins/plugin.h"

namespace palpate::test {

class PluginHost {
 public:
  explicit PluginHost(const std::string& file) {
    now() = 1'000'000'000;
    ends() = false;
    said().clear();
    library_ = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
    INFO((library_ == nullptr ? dlerror() : ""));
    REQUIRE(library_ != nullptr);
    entry = static_cast<const palpate_plugin_entry*>(dlsym(library_, "palpate_plugin"));
    REQUIRE(entry != nullptr);
  }
  ~PluginHost() {
    if (arm != nullptr) arm->close(arm);
    if (arms != nullptr) entry->end();
    dlclose(library_);
  }
  PluginHost(const PluginHost&) = delete;
  PluginHost& operator=(const PluginHost&) = delete;

  static palpate_plugin_host whole() {
    return {sizeof(palpate_plugin_host), [](const char* words) { said().emplace_back(words); },
            [] { return ends() ? 1 : 0; }, []() -> std::int64_t { return now(); },
            [](const char*) -> const void* { return nullptr; }};
  }

  void begin() {
    host_ = whole();
    REQUIRE(entry->init(&host_) == 0);
    arms = static_cast<const palpate_plugin_factory*>(entry->factory(PALPATE_PLUGIN_ARMS));
    REQUIRE(arms != nullptr);
  }

  /// Opens an arm. Returns false on failure and stores the reason in `error`.
  bool open(const char* serial) {
    char line[256] = "";
    if (arms == nullptr) begin();
    arm = arms->open(serial, line, sizeof line);
    error = line;
    return arm != nullptr;
  }

  int prepare() {
    char line[256] = "";
    const int result = arm->prepare(arm, line, sizeof line);
    error = line;
    return result;
  }

  palpate_plugin_facts facts() const {
    palpate_plugin_facts f{};
    f.size = sizeof f;
    REQUIRE(arm->facts(arm, &f) == PALPATE_PLUGIN_OK);
    return f;
  }

  int read() {
    reading.size = sizeof reading;
    return arm->read(arm, &reading);
  }

  int write(double x, double y, double z) const {
    const palpate_plugin_force force = {sizeof force, 0, {x, y, z}, {}};
    return arm->write(arm, &force);
  }

  /// Returns true if the error is one line of less than 200 bytes that begins with `name` and a
  /// colon, and has a comma or semicolon, which precedes the remedy.
  bool errorIsALine(const std::string& name) const {
    return error.rfind(name + ": ", 0) == 0 && error.find('\n') == std::string::npos &&
           error.size() < 200 && error.find_first_of(",;") != std::string::npos;
  }

  static std::atomic<std::int64_t>& now() {
    static std::atomic<std::int64_t> time;
    return time;
  }
  static std::atomic<bool>& ends() {
    static std::atomic<bool> flag;
    return flag;
  }
  static std::vector<std::string>& said() {
    static std::vector<std::string> words;
    return words;
  }

  const palpate_plugin_entry* entry = nullptr;
  const palpate_plugin_factory* arms = nullptr;
  palpate_plugin_device* arm = nullptr;
  palpate_plugin_reading reading{};
  std::string error;

 private:
  void* library_ = nullptr;
  palpate_plugin_host host_{};
};

/// A struct of another palpate version, with `room` bytes. The bytes behind it must not change.
template <class T>
struct Other {
  explicit Other(std::size_t room) {
    std::memset(bytes, 0x5a, sizeof bytes);
    const auto size = static_cast<std::uint32_t>(room);
    std::memcpy(bytes, &size, sizeof size);
  }
  T* get() { return reinterpret_cast<T*>(bytes); }
  bool untouchedFrom(std::size_t begin) const {
    for (std::size_t i = begin; i < sizeof bytes; ++i) {
      if (bytes[i] != 0x5a) return false;
    }
    return true;
  }
  alignas(T) char bytes[sizeof(T) + 64];
};

}  // namespace palpate::test
