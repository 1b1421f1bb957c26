/// Private to devices: the memory that palpate and palpate-plugin share, and their messages while
/// an arm is opened.
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

/// Memory that the program and the plug-in's process share. Each part has one writer and pages of
/// its own. The program's pages are read-only in the plug-in's process. The program reads only
/// numbers from the other part.
// Each side writes cache lines of its own.
struct PluginLink {  // NOLINT(clang-analyzer-optin.performance.Padding)
  static constexpr std::uint32_t kMagic = 0x70616C70;
  std::uint32_t magic = kMagic;
  std::uint32_t size = sizeof(PluginLink);

  // Written by the program.
  alignas(64) Seqlock<PluginOrder> order;
  std::atomic<std::uint32_t> orders{0};    ///< Counts orders; used as a futex.
  std::atomic<std::int64_t> ticked_at{0};  ///< Time of the program's last read [ns]: its heartbeat.

  static constexpr std::size_t kPage = 65536;  ///< At least one page on every machine [bytes].
  std::array<std::byte, kPage> apart{};        ///< Separates the pages of the two parts.

  // Written by the plug-in's process.
  alignas(64) Seqlock<PluginNews> news;
  std::atomic<std::uint64_t> heart{0};  ///< Counts turns of that process' haptic thread.
};

/// File descriptors of a plug-in's process.
enum : int {
  kPluginControl = 3,  ///< Messages, both ways.
  kPluginMemory = 4,   ///< A PluginLink.
  kPluginZero = 5,     ///< Any message means zero force.
};

/// A message while an arm is opened. The socket keeps each message whole.
struct PluginMessage {
  enum Kind : std::uint32_t {
    kSay,     ///< A line for the user.
    kPlugin,  ///< Lines: the plug-in's purpose, version and licence.
    kFound,   ///< A palpate_plugin_found.
    kFacts,   ///< A palpate_plugin_facts, then a double: PluginPort::carries.
    kDone,    ///< The list is complete, or the arm is ready.
    kFailed,  ///< Lines: subject, reason and remedy of an error.
  };
  static constexpr std::size_t kMostBytes = 4096;
  std::uint32_t kind = kSay;
  std::uint32_t size = 0;
  std::array<char, kMostBytes> bytes{};

  static constexpr std::size_t kHead = 8;
  [[nodiscard]] std::string text() const;  ///< At most kMostBytes; no control characters but '\n'.
};

/// Sends a message, cut to kMostBytes. Returns false if the other side does not take it.
bool sendPluginMessage(int socket, PluginMessage::Kind kind, std::span<const std::byte> bytes);
bool sendPluginMessage(int socket, PluginMessage::Kind kind, const std::string& text);
/// Parses received bytes. Returns nullopt if they are not a message: too short, too long, of an
/// unknown kind.
[[nodiscard]] std::optional<PluginMessage> pluginMessageOf(std::span<const std::byte> bytes);

/// Waits until `word` differs from `seen`, at most until nowNs() reaches `until` [ns]. wakeWord()
/// wakes a waiter, also in another process. RT: a system call.
void waitForWord(std::atomic<std::uint32_t>& word, std::uint32_t seen, std::int64_t until) noexcept;
void wakeWord(std::atomic<std::uint32_t>& word) noexcept;

}  // namespace palpate
