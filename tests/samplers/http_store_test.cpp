#include "palpate/samplers/bricks/http_store.h"

#include <arpa/inet.h>
#include <array>
#include <chrono>
#include <netinet/in.h>
#include <poll.h>
#include <string>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>
#include <utility>

#include <catch2/catch.hpp>

namespace palpate::http_store_test {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// A server that answers one connection with a given text, and waits until the client closes the
/// connection, or for kPatience.
class HeaderServer {
 public:
  static constexpr auto kPatience = 5s;

  explicit HeaderServer(std::string header)
      : listener_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)), header_(std::move(header)) {
    sockaddr_in any{};
    any.sin_family = AF_INET;
    any.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof any;
    auto* address = reinterpret_cast<sockaddr*>(&any);
    REQUIRE(bind(listener_, address, size) == 0);
    REQUIRE(listen(listener_, 1) == 0);
    REQUIRE(getsockname(listener_, address, &size) == 0);
    port_ = ntohs(any.sin_port);
    thread_ = std::thread([this] { serve(); });
  }
  HeaderServer(const HeaderServer&) = delete;
  HeaderServer& operator=(const HeaderServer&) = delete;
  ~HeaderServer() {
    thread_.join();
    close(listener_);
  }

  [[nodiscard]] std::string address() const {
    return "http://127.0.0.1:" + std::to_string(port_) + "/bowl";
  }

 private:
  /// Waits for data, at most kPatience. Returns true if data arrived.
  static bool arrives(int at) {
    pollfd one{at, POLLIN, 0};
    return poll(&one, 1, static_cast<int>(std::chrono::milliseconds(kPatience).count())) > 0;
  }

  void serve() const {
    if (!arrives(listener_)) return;
    const int client = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    std::string asked;
    std::array<char, 4096> piece{};
    while (asked.find("\r\n\r\n") == std::string::npos && arrives(client)) {
      const ssize_t got = recv(client, piece.data(), piece.size(), 0);
      if (got <= 0) break;
      asked.append(piece.data(), static_cast<std::size_t>(got));
    }
    (void)send(client, header_.data(), header_.size(), MSG_NOSIGNAL);
    (void)arrives(client);
    close(client);
  }

  int listener_;
  int port_ = 0;
  std::string header_;
  std::thread thread_;
};

}  // namespace

TEST_CASE("an HTTP answer whose header states a wrong length is refused before its body is read",
          "[bricks][http]") {
  struct Answer {
    const char* header;
    std::size_t announced;
    bool part = false;
  };
  const auto answer = GENERATE(
      Answer{"HTTP/1.1 200 OK\r\nContent-Length: 999\r\n\r\n", 999},
      Answer{"HTTP/1.1 200 OK\r\ncontent-length:   1001\r\n\r\n", 1001},
      Answer{"HTTP/1.1 200 OK\r\nContent-Length: 99999999999999\r\n\r\n", 99999999999999},
      Answer{"HTTP/1.1 206 Partial Content\r\nContent-Length: 999\r\n\r\n", 999, true},
      Answer{"HTTP/1.1 206 Partial Content\r\nContent-Range: bytes 0-1000/9999\r\n\r\n", 1001,
             true},
      Answer{"HTTP/1.1 206 Partial Content\r\nContent-Range: bytes 1-1000/9999\r\n\r\n", 0, true});
  const bool waits = GENERATE(true, false);
  CAPTURE(answer.header, waits);

  StoreParams params;
  params.stalled = 60s;
  const HeaderServer server(answer.header);
  const auto store = makeHttpStore(server.address(), params);
  const auto request = store->make();
  request->ask(1000, 1000, answer.part);
  const Clock::time_point begun = Clock::now();
  if (waits) {
    store->get("0/0", *request);
  } else {
    REQUIRE(store->begin("0/0", *request));
    while (store->ended(100ms) == nullptr && Clock::now() - begun < 2 * HeaderServer::kPatience) {
    }
  }
  CHECK(Clock::now() - begun < HeaderServer::kPatience);
  CHECK(request->status == BrickStatus::kCut);
  CHECK(request->announced.value_or(1000) == answer.announced);
  CHECK(request->body.empty());
}

TEST_CASE("an HTTP answer that does not end fails at its deadline", "[bricks][http]") {
  StoreParams params;
  params.stalled = 60s;
  params.opened = 1s;
  const HeaderServer server("HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nx");
  const auto store = makeHttpStore(server.address(), params);
  const auto request = store->make();
  request->ask(0, 1000);
  const Clock::time_point begun = Clock::now();
  store->get("palpate.bricks", *request);
  CHECK(Clock::now() - begun < HeaderServer::kPatience);
  CHECK(request->status == BrickStatus::kUnreadable);
}

TEST_CASE("an HTTP answer of the stated length is received", "[bricks][http]") {
  const std::string body(1000, 'x');
  const auto fetch = [&](const std::string& header) {
    const HeaderServer server(header + body);
    const auto store = makeHttpStore(server.address());
    const auto request = store->make();
    request->ask(1000, 1000);
    store->get("0/0", *request);
    CHECK(request->status == BrickStatus::kArrived);
    return request->body.size();
  };
  CHECK(fetch("HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n") == 1000);
  // The client must ignore the content length of a preliminary answer.
  CHECK(fetch("HTTP/1.1 103 Early Hints\r\nContent-Length: 7\r\n\r\n"
              "HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n") == 1000);
}

}  // namespace palpate::http_store_test
