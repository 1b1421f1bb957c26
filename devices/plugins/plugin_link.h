/// Private to devices: shared memory and messages between palpate and palpate-plugin.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "palpate/devices/plugins/plugin_port.h"
#include "palpate/devices/plugins/seqlock.h"

namespace palpate {

/// Memory that the program and the plug-in's process share: two parts, each with one writer and
/// with its own memory pages and cache lines. The program's pages are read-only in the plug-in's
/// process. The program reads only numbers from the other part.
struct PluginLink {  // NOLINT(clang-analyzer-optin.performance.Padding)
  static constexpr std::uint32_t kMagic = 0x70616C70;
  std::uint32_t magic = kMagic;
  std::uint32_t size = sizeof(PluginLink);

  // Written by the program.
  alignas(64) Seqlock<PluginOrder> order;
  /// Counts orders; also a futex on which the plug-in's process waits.
  std::atomic<std::uint32_t> orders{0};
  std::atomic<std::int64_t> ticked_at{0};  ///< Time of the program's last read [ns], a heartbeat.

  /// At least as large as a memory page on x86-64 and arm64 [bytes].
  static constexpr std::size_t kPage = 65536;
  std::array<std::byte, kPage> apart{};  ///< Puts the two parts on different pages.

  // Written by the plug-in's process.
  alignas(64) Seqlock<PluginNews> news;
  /// Incremented by the haptic thread of the plug-in's process in each pass: a heartbeat.
  std::atomic<std::uint64_t> heart{0};
};

/// File descriptors that the plug-in's process inherits.
enum : int {
  kPluginControl = 3,  ///< Socket for messages in both directions.
  kPluginMemory = 4,   ///< Shared memory with the PluginLink.
  kPluginZero = 5,     ///< Socket of the guardian: any message means zero force.
};

/// A message of the plug-in's process: kSay at any time, the others while arms are listed or
/// opened. The socket preserves message boundaries.
struct PluginMessage {
  enum Kind : std::uint32_t {
    kSay,     ///< A line for the user.
    kPlugin,  ///< Three lines: the plug-in's purpose, version and licence.
    kFound,   ///< A palpate_plugin_found.
    kFacts,   ///< A palpate_plugin_facts, then a double: PluginPort::carries.
    kDone,    ///< All arms are listed, or the arm is ready.
    kFailed,  ///< An error as three lines: subject, reason and remedy.
  };
  static constexpr std::size_t kMostBytes = 4096;
  std::uint32_t kind = kSay;
  std::uint32_t size = 0;
  std::array<char, kMostBytes> bytes{};

  static constexpr std::size_t kHead = 8;
  /// Returns the bytes as text: at most kMostBytes, without control characters except '\n'.
  [[nodiscard]] std::string text() const;
};

/// Sends a message, cut to kMostBytes. Returns false if it could not be sent.
bool sendPluginMessage(int socket, PluginMessage::Kind kind, std::span<const std::byte> bytes);
bool sendPluginMessage(int socket, PluginMessage::Kind kind, const std::string& text);
/// Parses received bytes. Returns nullopt if they are too short, too long or of an unknown kind.
[[nodiscard]] std::optional<PluginMessage> pluginMessageOf(std::span<const std::byte> bytes);

/// Waits until `word` differs from `seen`, but at most until nowNs() reaches `until` [ns]; may
/// return earlier. wakeWord() wakes one waiting thread, also of another process. RT: a system call.
void waitForWord(std::atomic<std::uint32_t>& word, std::uint32_t seen, std::int64_t until) noexcept;
void wakeWord(std::atomic<std::uint32_t>& word) noexcept;

}  // namespace palpate
