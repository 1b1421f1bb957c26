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

inline constexpr int kPluginPoll = 10;  ///< [ms] between checks of a process.
inline constexpr const char* kPluginProgram = "palpate-plugin";

/// A descriptor; the destructor closes it.
class OwnedDescriptor {
 public:
  OwnedDescriptor() = default;
  /// Moves the descriptor above the numbers that a child gets.
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

/// Returns the two ends of a socket that keeps each message whole. Throws DeviceError.
[[nodiscard]] std::pair<OwnedDescriptor, OwnedDescriptor> pluginSocketPair();

/// Returns the path of palpate-plugin in this program's folder.
[[nodiscard]] std::filesystem::path programBeside();

/// A process of palpate-plugin.
class PluginChild {
 public:
  /// @param given  Descriptors that the process gets as 3, 4, ...
  PluginChild(const std::filesystem::path& program, const std::vector<std::string>& words,
              std::initializer_list<int> given);
  PluginChild(const PluginChild&) = delete;
  PluginChild& operator=(const PluginChild&) = delete;
  ~PluginChild() { end(0.0); }

  /// Returns true while the process lives.
  [[nodiscard]] bool lives();
  /// Returns true once after the process was stopped; lives() has let it continue.
  [[nodiscard]] bool wasStopped() noexcept { return std::exchange(stopped_, false); }
  /// Waits for the process to end, and kills it after `patience` [s]. If the kernel does not end
  /// it, leaves it.
  void end(double patience);

 private:
  pid_t process_ = -1;
  bool stopped_ = false;
};

/// Returns the first three lines of a message; those that it does not have are empty.
[[nodiscard]] std::vector<std::string> pluginLinesOf(const PluginMessage& message);

/// Returns the error of a message of the kind kFailed.
[[nodiscard]] DeviceError pluginErrorOf(const PluginMessage& message);

/// Result of receiving one message.
enum class PluginReceived : std::uint8_t {
  kMessage,
  kNothing,  ///< No message waits.
  kEnd,      ///< The other side has closed the socket.
};
/// Receives one waiting message. `message` is empty if no message waits, or if the message is
/// invalid.
[[nodiscard]] PluginReceived receivePluginMessage(int control,
                                                  std::optional<PluginMessage>& message);

/// Result of receiving all messages of a process.
enum class PluginAnswer : std::uint8_t {
  kAll,      ///< The process has sent all.
  kLate,     ///< `patience` is over.
  kEnded,    ///< The process has ended.
  kStopped,  ///< `stop` has returned true.
};
/// Receives the messages of a process until it has sent all, `patience` [s] are over (0: no limit),
/// or it has ended. Calls `take` with each message except kDone. Asks `stop` (may be empty) at
/// least every kPluginPoll.
[[nodiscard]] PluginAnswer receivePluginMessages(
    int control, PluginChild& child, double patience, const std::function<bool()>& stop,
    const std::function<void(const PluginMessage&)>& take);

/// Facts as the process has sent them, unchecked.
struct SentPluginFacts {
  palpate_plugin_facts facts;
  double carries;  ///< PluginPort::carries [N].
};
/// Returns the facts of a message; nullopt if they are incomplete.
[[nodiscard]] std::optional<SentPluginFacts> pluginFactsIn(const PluginMessage& message);

/// Returns the found arm of a message; nullopt if the message is another one or incomplete.
[[nodiscard]] std::optional<palpate_plugin_found> pluginFoundIn(const PluginMessage& message);

}  // namespace palpate
