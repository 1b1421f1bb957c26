/// Private to devices: processes of palpate-plugin, and the messages that they send while an arm is
/// opened.
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

inline constexpr int kPluginPoll = 10;  ///< [ms] between two checks of a process.
inline constexpr const char* kPluginProgram = "palpate-plugin";

/// Owns a file descriptor; the destructor closes it.
class OwnedDescriptor {
 public:
  OwnedDescriptor() = default;
  /// Owns this descriptor, and moves it above the numbers that a child process gets.
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

/// Returns the two ends of a socket that preserves message boundaries. Throws DeviceError.
[[nodiscard]] std::pair<OwnedDescriptor, OwnedDescriptor> pluginSocketPair();

/// Returns the path of palpate-plugin in this program's folder.
[[nodiscard]] std::filesystem::path programBeside();

/// A process of palpate-plugin.
class PluginChild {
 public:
  /// @param given  Descriptors that the process receives as 3, 4, ...
  PluginChild(const std::filesystem::path& program, const std::vector<std::string>& words,
              std::initializer_list<int> given);
  PluginChild(const PluginChild&) = delete;
  PluginChild& operator=(const PluginChild&) = delete;
  ~PluginChild() { end(0.0); }

  /// Returns true while the process lives.
  [[nodiscard]] bool lives();
  /// Returns true once after the process was stopped and lives() has let it continue.
  [[nodiscard]] bool wasStopped() noexcept { return std::exchange(stopped_, false); }
  /// Waits at most `patience` [s] for the process to end, then kills it. Gives up if the kernel
  /// does not end it.
  void end(double patience);

 private:
  pid_t process_ = -1;
  bool stopped_ = false;
};

/// Returns the first three lines of a message; missing lines are empty.
[[nodiscard]] std::vector<std::string> pluginLinesOf(const PluginMessage& message);

/// Returns the error in a message of the kind kFailed.
[[nodiscard]] DeviceError pluginErrorOf(const PluginMessage& message);

/// Result of receiving one message.
enum class PluginReceived : std::uint8_t {
  kMessage,
  kNothing,  ///< No message is waiting.
  kEnd,      ///< The other side has closed the socket.
};
/// Receives one waiting message. `message` is empty if none is waiting, or if the message is
/// invalid.
[[nodiscard]] PluginReceived receivePluginMessage(int control,
                                                  std::optional<PluginMessage>& message);

/// Result of receiving all messages of a process.
enum class PluginAnswer : std::uint8_t {
  kAll,      ///< The process has sent all its messages.
  kLate,     ///< The time `patience` has passed.
  kEnded,    ///< The process has ended.
  kStopped,  ///< `stop` has returned true.
};
/// Receives the messages of a process. Returns when the process has sent all or has ended, when
/// `patience` [s] (0: no limit) has passed, or when `stop` (may be empty) returns true. Calls
/// `take` with each message except kDone, and `stop` at least every kPluginPoll.
[[nodiscard]] PluginAnswer receivePluginMessages(
    int control, PluginChild& child, double patience, const std::function<bool()>& stop,
    const std::function<void(const PluginMessage&)>& take);

/// Facts as the process has sent them, not yet checked.
struct SentPluginFacts {
  palpate_plugin_facts facts;
  double carries;  ///< PluginPort::carries [N].
};
/// Returns the facts of a message; nullopt if they are incomplete.
[[nodiscard]] std::optional<SentPluginFacts> pluginFactsIn(const PluginMessage& message);

/// Returns the found arm of a message; nullopt if the message is of another kind or incomplete.
[[nodiscard]] std::optional<palpate_plugin_found> pluginFoundIn(const PluginMessage& message);

}  // namespace palpate
