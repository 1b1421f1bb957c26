/// Private to scenes/network/slicer: a client's connection, and counters of the traffic.
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
  /// Number of clients that had to wait, because the largest number of clients was connected.
  std::atomic<std::int64_t> refused{0};
  /// Number of connections that the server has ended, because of invalid data, a late message,
  /// unread messages or a lack of memory.
  std::atomic<std::int64_t> ended{0};
  /// Number of sets of messages that were sent, summed over all clients.
  std::atomic<std::int64_t> sent{0};
  std::atomic<std::int64_t> skipped{
      0};  ///< Number of sets not sent, because the client had not read the previous set.
  std::atomic<std::int64_t> received{0};
  std::atomic<std::int64_t> images{0};
};

struct IgtlServer::Client {
  enum class At : std::uint8_t { kHead, kBody, kSkip };
  /// If this much data waits to be sent, the client gets no further answers [bytes].
  static constexpr std::size_t kMostOut = 1U << 16U;

  std::uint64_t number = 0;  ///< Identifies the client; unique in the run.
  int socket = -1;           ///< -1: the connection has ended.
  std::string peer;
  At at = At::kHead;
  std::array<std::uint8_t, kIgtlHead> head_bytes{};
  std::size_t head_count = 0;
  IgtlHead head;
  Bytes body;
  std::uint64_t left = 0;
  std::uint64_t crc = 0;
  /// Answer to send when the message is complete; `why` is the reason.
  IgtlCode answer = IgtlCode::kOk;
  std::string why;
  bool answers = false;
  std::int64_t begun = 0;  ///< Time at which the present message began [ns].
  Bytes out;
  std::size_t out_at = 0;
  std::int64_t took = 0;  ///< Time at which the client last read data [ns].
  bool wants_status = true;
  /// True if too many clients are connected: the server then accepts only a cut from this client.
  bool waits = false;

  Client(int s, std::string p) : socket(s), peer(std::move(p)) {}
  ~Client() {
    if (socket >= 0) close(socket);
  }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  [[nodiscard]] bool within() const { return head_count > 0; }
  [[nodiscard]] bool isImage() const { return at == At::kBody && head.type == "IMAGE"; }
};

/// Returns the present time [ns since 1970].
[[nodiscard]] std::int64_t sinceEpoch();

}  // namespace palpate::cli
