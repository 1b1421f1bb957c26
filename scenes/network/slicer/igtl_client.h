/// Private to scenes/network/slicer: one connection of the server, and its counts.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <unistd.h>
#include <utility>

#include "palpate/scenes/network/slicer/igtl_server.h"

namespace palpate::cli {

struct IgtlServer::Counts {
  std::atomic<std::int64_t> connections{0};
  std::atomic<std::int64_t> refused{0};  ///< Connections that had to wait.
  std::atomic<std::int64_t> ended{0};    ///< Ended by the server, for bad data or for not reading.
  std::atomic<std::int64_t> sent{0};     ///< Rounds of messages, for each client.
  std::atomic<std::int64_t> skipped{
      0};  ///< Rounds not sent: the client had not taken the previous one.
  std::atomic<std::int64_t> received{0};
  std::atomic<std::int64_t> images{0};
};

struct IgtlServer::Client {
  enum class At : std::uint8_t { kHead, kBody, kSkip };
  static constexpr std::size_t kMostOut = 1U << 16U;  ///< Limit of data waiting for it [bytes].

  int socket = -1;  ///< -1: the client has gone.
  std::string peer;
  At at = At::kHead;
  std::array<std::uint8_t, kIgtlHead> head_bytes{};
  std::size_t head_count = 0;
  IgtlHead head;
  Bytes body;
  std::uint64_t left = 0;  ///< Bytes of the body, still to come.
  std::uint64_t crc = 0;
  IgtlCode answer = IgtlCode::kOk;  ///< For the complete message; with `why`.
  std::string why;
  bool answers = false;
  std::int64_t begun = 0;  ///< Start of the message [ns].
  Bytes out;
  std::size_t out_at = 0;
  std::int64_t took = 0;  ///< Time when it last took data [ns].
  bool wants_status = true;
  bool waits = false;  ///< All places are taken, so the server accepts only a cut from it.

  Client(int s, std::string p) : socket(s), peer(std::move(p)) {}
  ~Client() {
    if (socket >= 0) close(socket);
  }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  [[nodiscard]] bool within() const { return head_count > 0; }
  [[nodiscard]] bool isImage() const { return at == At::kBody && head.type == "IMAGE"; }
};

/// Returns the present time, for messages: since 1970 [ns].
[[nodiscard]] std::int64_t sinceEpoch();

}  // namespace palpate::cli
