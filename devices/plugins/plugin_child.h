/// Private to devices: processes of palpate-plugin, and their messages while an arm is opened.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <optional>
#include <string>
#include <sys/types.h>
#include <utility>
#include <vector>

#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/error.h"

namespace palpate {

inline constexpr int kPluginPoll = 10;  ///< Time between two checks of a process [ms].
inline constexpr const char* kPluginProgram = "palpate-plugin";

class OwnedDescriptor {
 public:
  OwnedDescriptor() = default;
  /// Moves the descriptor `own` above the numbers that a child process gets. Throws DeviceError if
  /// `own` is negative or cannot be moved.
  explicit OwnedDescriptor(int own);
  OwnedDescriptor(OwnedDescriptor&& other) noexcept : own_(std::exchange(other.own_, -1)) {}
  OwnedDescriptor& operator=(OwnedDescriptor&& other) noexcept {
    std::swap(own_, other.own_);
    return *this;
  }
  OwnedDescriptor(const OwnedDescriptor&) = delete;
  OwnedDescriptor& operator=(const OwnedDescriptor&) = delete;
  ~OwnedDescriptor();
  [[nodiscard]] int get() const noexcept { return own_; }

 private:
  int own_ = -1;
};

/// Returns two connected sockets, which preserve message boundaries. Throws DeviceError.
[[nodiscard]] std::pair<OwnedDescriptor, OwnedDescriptor> pluginSocketPair();

[[nodiscard]] std::filesystem::path programBeside();

class PluginChild {
 public:
  /// @param given  Descriptors for the process, which get the numbers 3, 4, ...
  PluginChild(const std::filesystem::path& program, const std::vector<std::string>& words,
              std::initializer_list<int> given);
  PluginChild(const PluginChild&) = delete;
  PluginChild& operator=(const PluginChild&) = delete;
  ~PluginChild() { end(0.0); }

  [[nodiscard]] bool lives();
  /// Returns true once after the process was stopped and lives() has let it continue.
  [[nodiscard]] bool wasStopped() noexcept { return std::exchange(stopped_, false); }
  /// Waits at most `patience` [s] for the process to end, then kills it, and waits at most 1 s
  /// more.
  void end(double patience);

 private:
  pid_t process_ = -1;
  bool stopped_ = false;
};

/// Returns the first three lines of a message; missing lines are empty.
[[nodiscard]] std::vector<std::string> pluginLinesOf(const PluginMessage& message);

[[nodiscard]] DeviceError pluginErrorOf(const PluginMessage& message);

enum class PluginReceived : std::uint8_t {
  kMessage,
  kNothing,
  kEnd,  ///< The other side has closed the socket, or the socket fails.
};
/// Receives a message, which is empty if the socket is empty or the message is invalid.
[[nodiscard]] PluginReceived receivePluginMessage(int control,
                                                  std::optional<PluginMessage>& message);

enum class PluginAnswer : std::uint8_t {
  kAll,   ///< The process has sent all its messages.
  kLate,  ///< The time limit `patience` has passed.
  kEnded,
  kStopped,  ///< `stop` has returned true.
};
/// Calls `take` with each message except kDone, and `stop` (may be empty) at least every
/// kPluginPoll. `patience` [s]; 0: no limit.
[[nodiscard]] PluginAnswer receivePluginMessages(
    int control, PluginChild& child, double patience, const std::function<bool()>& stop,
    const std::function<void(const PluginMessage&)>& take);

/// Facts as the process has sent them, not yet checked.
struct SentPluginFacts {
  palpate_plugin_facts facts;
  double carries;  ///< PluginPort::carries [N].
};
[[nodiscard]] std::optional<SentPluginFacts> pluginFactsIn(const PluginMessage& message);

[[nodiscard]] std::optional<palpate_plugin_found> pluginFoundIn(const PluginMessage& message);

}  // namespace palpate
