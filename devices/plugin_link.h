/// Private to devices: what palpate and palpate-plugin share: memory, and messages of the opening.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "palpate/devices/plugin_port.h"
#include "palpate/devices/seqlock.h"

namespace palpate {

/// Memory that both have. Each part has one writer, and pages of its own: those of the program are
/// read-only in the plug-in's process. The program reads only numbers from the other part.
// Each side writes cache lines of its own.
struct PluginLink {  // NOLINT(clang-analyzer-optin.performance.Padding)
  static constexpr std::uint32_t kMagic = 0x70616C70;
  std::uint32_t magic = kMagic;
  std::uint32_t size = sizeof(PluginLink);

  // The program's.
  alignas(64) Seqlock<PluginOrder> order;
  std::atomic<std::uint32_t> orders{0};    ///< Counts orders; a futex.
  std::atomic<std::int64_t> ticked_at{0};  ///< When the program read last [ns]; its heartbeat.

  static constexpr std::size_t kPage = 65536;  ///< At least a page of any machine [bytes].
  std::array<std::byte, kPage> apart{};        ///< Separates the pages of the two parts.

  // The plug-in's process'.
  alignas(64) Seqlock<PluginNews> news;
  std::atomic<std::uint64_t> heart{0};  ///< Counts turns of its haptic thread.
};

/// Descriptors of a plug-in's process.
enum : int {
  kPluginControl = 3,  ///< Messages, both ways.
  kPluginMemory = 4,   ///< A PluginLink.
  kPluginZero = 5,     ///< Whatever comes means zero force.
};

/// A message of the opening. A socket keeps each whole.
struct PluginMessage {
  enum Kind : std::uint32_t {
    kSay,     ///< A line for the user.
    kPlugin,  ///< What it is for, its version and licence, lines.
    kFound,   ///< A palpate_plugin_found.
    kFacts,   ///< A palpate_plugin_facts, behind it 1 byte: it carries its weight.
    kDone,    ///< All has been said: the list, or the arm is ready.
    kFailed,  ///< What, why and remedy, lines.
  };
  static constexpr std::size_t kMostBytes = 4096;
  std::uint32_t kind = kSay;
  std::uint32_t size = 0;
  std::array<char, kMostBytes> bytes{};

  static constexpr std::size_t kHead = 8;
  [[nodiscard]] std::string text() const;  ///< Without what is no text; at most kMostBytes.
};

/// Sends one; what is too long is cut. False: nobody listens.
bool sendPluginMessage(int socket, PluginMessage::Kind kind, std::span<const std::byte> bytes);
bool sendPluginMessage(int socket, PluginMessage::Kind kind, const std::string& text);
/// What has come as a message; nothing where it is none: too short, too long, of no kind.
[[nodiscard]] std::optional<PluginMessage> pluginMessageOf(std::span<const std::byte> bytes);

/// Waits until a word is another one, at most until nowNs() reaches `until` [ns]. Wakes those in
/// other processes. RT: a system call.
void waitForWord(std::atomic<std::uint32_t>& word, std::uint32_t seen, std::int64_t until) noexcept;
void wakeWord(std::atomic<std::uint32_t>& word) noexcept;

}  // namespace palpate
