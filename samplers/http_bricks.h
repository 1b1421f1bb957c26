/// Bricks from a web server or an object store: nginx, Ceph's gateway, anything that gives an
/// object by its name.
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "palpate/samplers/bricks.h"

namespace palpate {

/// How a server is asked.
struct HttpParams {
  int connections = 6;                        ///< At a time, 1 to 32; each carries one brick.
  std::chrono::milliseconds connect{2'000};   ///< A connection has to stand within this.
  std::chrono::milliseconds stalled{2'000};   ///< A transfer has to go on within this,
  std::chrono::milliseconds longest{30'000};  ///< and to end within this.
  std::chrono::milliseconds silent{2'000};    ///< isThere(): no answer for so long is none.
};

/// What a server has given.
struct HttpState {
  std::uint64_t objects = 0;  ///< That have come whole.
  std::uint64_t bytes = 0;    ///< Of these.
  std::uint64_t failed = 0;   ///< That have not.
  double delay = 0.0;         ///< From its request to a brick's last byte, lately [s].
};

/// The folder of bricks at an address. A thread of its own holds the connections; who calls next()
/// decompresses and checks.
///
/// Of the protocol it takes HTTP GET and HEAD alone: it follows no redirection, keeps no cookie,
/// reads no password file, and no object longer than the manifest says or a brick can be. Whoever
/// answers can give bricks that do not arrive, not ones that are wrong: they are checked as files
/// are.
class HttpBricks final : public BrickSource {
 public:
  /// @param address  http://host[:port]/folder or https://...
  /// Fetches the manifest. Throws VolumeError: no such address, no answer, no manifest.
  explicit HttpBricks(const std::string& address, const HttpParams& params = {});
  ~HttpBricks() override;  ///< Ends what is on its way.

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// By the server's last answer about the manifest, asked for anew each time: it takes no time,
  /// and says what was HttpParams::silent ago at worst.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;
  [[nodiscard]] std::chrono::duration<double> delay() const override;

  [[nodiscard]] HttpState state() const;  ///< As it is now. Takes a lock.

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// True for what HttpBricks takes as an address: a host, no user, no question.
[[nodiscard]] bool isAddress(std::string_view name) noexcept;

}  // namespace palpate
