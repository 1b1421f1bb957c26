/// Bricks from remote stores that provide objects by name: a web server (http_store.h), a Ceph
/// cluster (rados_store.h), or a store of the user's own.
#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Limits for requests to a store.
struct StoreParams {
  int connections = 6;                        ///< At a time, 1 to 32; each carries one brick.
  std::chrono::milliseconds connect{2'000};   ///< Time to establish a connection.
  std::chrono::milliseconds stalled{2'000};   ///< Longest pause of a transfer.
  std::chrono::milliseconds longest{30'000};  ///< Longest transfer.
  std::chrono::milliseconds silent{2'000};    ///< isThere(): false if unanswered for this time.
  std::chrono::milliseconds opened{60'000};   ///< Limit for a blocking fetch, all tries together.
};

/// ObjectRequest::why if memory is short.
inline constexpr char kNoMemory[] = "the system has too little memory";

/// A request for an object, and its result. Reused with its memory.
struct ObjectRequest {
  virtual ~ObjectRequest() = default;

  // The request.
  std::size_t limit = 0;  ///< Most bytes to take of the object [bytes].
  bool part = false;      ///< Only the first `limit` bytes are requested.
  std::size_t least = 0;  ///< Least length of the object [bytes].
  // The result.
  std::vector<std::byte> body;                    ///< At most `limit`.
  BrickStatus status = BrickStatus::kUnreadable;  ///< kCut: its length is not the requested one.
  std::optional<std::size_t> announced;  ///< Length that the server stated, if that is wrong.
  const char* why = nullptr;             ///< For kUnreadable; stays valid.
  long code = 0;  ///< For kUnreadable: the server's status code; 0: not known.
  std::chrono::steady_clock::time_point last;  ///< When data arrived last, or the request began.

  /// Sets the request and clears the result.
  void ask(std::size_t at_least, std::size_t at_most, bool its_begin = false) noexcept {
    least = at_least;
    limit = at_most;
    part = its_begin;
    announced.reset();
    body.clear();
    fail(nullptr);
    last = std::chrono::steady_clock::now();
  }
  /// Sets the result to kUnreadable.
  void fail(const char* reason, long number = 0) noexcept {
    status = BrickStatus::kUnreadable;
    why = reason;
    code = number;
  }
};

/// Provides objects by name. Only one thread may call begin(), drop() and ended().
class ObjectStore {
 public:
  ObjectStore() = default;
  ObjectStore(const ObjectStore&) = delete;
  ObjectStore& operator=(const ObjectStore&) = delete;
  virtual ~ObjectStore() = default;  ///< Only while no request is in progress.

  /// Makes a request for this store. Any thread may call it.
  [[nodiscard]] virtual std::unique_ptr<ObjectRequest> make() = 0;
  /// Fetches an object and waits for the end. Any thread may call it, with requests that are never
  /// passed to begin().
  virtual void get(const std::string& name, ObjectRequest& request) noexcept = 0;
  /// Starts a request; ended() returns the request when it has ended. Returns false if the request
  /// failed at once; `request` has the reason.
  [[nodiscard]] virtual bool begin(const std::string& name, ObjectRequest& request) noexcept = 0;
  /// Drops a request in progress: ended() never returns it, and the store does not write to it.
  virtual void drop(ObjectRequest& request) noexcept = 0;
  /// Returns a request that has ended; null after `patience`, or if wake() was called.
  [[nodiscard]] virtual ObjectRequest* ended(std::chrono::milliseconds patience) noexcept = 0;
  virtual void wake() noexcept = 0;  ///< Any thread may call it.
};

/// A folder of bricks in a store. A thread of its own requests the objects; the caller of next()
/// decompresses and checks them. A faulty server can withhold bricks, but cannot pass wrong ones.
/// No object is accepted that is longer than the manifest says or a brick can be. Objects are
/// checked as files are.
class FarBricks final : public BrickSource {
 public:
  /// Fetches the manifest. Throws VolumeError if the store does not answer or has no manifest.
  /// @param address  Address of the folder, for messages.
  FarBricks(const std::string& address, std::unique_ptr<ObjectStore> store,
            const StoreParams& params = {});
  ~FarBricks() override;  ///< Stops transfers in progress.

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// Returns the store's last answer about the manifest, and requests a new one. Does not wait. At
  /// worst it reports the state of StoreParams::silent ago.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;
  [[nodiscard]] std::chrono::duration<double> delay() const override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace palpate
