#include "palpate/devices/plugins/plugin_link.h"

#include <algorithm>
#include <cctype>
#include <cstring>
#include <ctime>
#include <linux/futex.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "palpate/engine/loop/realtime.h"

namespace palpate {

std::string PluginMessage::text() const {
  std::string text(bytes.data(), std::min<std::size_t>(size, kMostBytes));
  for (char& c : text) {
    if (std::iscntrl(static_cast<unsigned char>(c)) != 0 && c != '\n') c = ' ';
  }
  return text;
}

bool sendPluginMessage(int socket, PluginMessage::Kind kind, std::span<const std::byte> bytes) {
  PluginMessage message;
  message.kind = kind;
  message.size =
      static_cast<std::uint32_t>(std::min<std::size_t>(bytes.size(), PluginMessage::kMostBytes));
  std::memcpy(message.bytes.data(), bytes.data(), message.size);
  const std::size_t size = PluginMessage::kHead + message.size;
  // If the program does not read, drops lines for the user, so that the plug-in does not block.
  const int how = MSG_NOSIGNAL | (kind == PluginMessage::kSay ? MSG_DONTWAIT : 0);
  return send(socket, &message, size, how) == static_cast<ssize_t>(size);
}

bool sendPluginMessage(int socket, PluginMessage::Kind kind, const std::string& text) {
  return sendPluginMessage(socket, kind, std::as_bytes(std::span(text)));
}

std::optional<PluginMessage> pluginMessageOf(std::span<const std::byte> bytes) {
  PluginMessage message;
  if (bytes.size() < PluginMessage::kHead || bytes.size() > sizeof(message)) return std::nullopt;
  std::memcpy(&message, bytes.data(), bytes.size());
  if (message.kind > PluginMessage::kFailed) return std::nullopt;
  if (message.size != bytes.size() - PluginMessage::kHead) return std::nullopt;
  return message;
}

void waitForWord(std::atomic<std::uint32_t>& word, std::uint32_t seen,
                 std::int64_t until) noexcept {
  constexpr std::int64_t kSecond = 1000000000;
  // Passes a relative time, because the kernel's clock for this call differs from that of nowNs().
  const std::int64_t wait = until - nowNs();
  if (wait <= 0) return;
  timespec time{};
  time.tv_sec = wait / kSecond;
  time.tv_nsec = wait % kSecond;
  syscall(SYS_futex, &word, FUTEX_WAIT, seen, &time, nullptr, 0);
}

void wakeWord(std::atomic<std::uint32_t>& word) noexcept {
  syscall(SYS_futex, &word, FUTEX_WAKE, 1, nullptr, nullptr, 0);
}

}  // namespace palpate
