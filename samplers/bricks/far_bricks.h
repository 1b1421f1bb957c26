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

/// Limits of the requests to a store.
struct StoreParams {
  /// Number of simultaneous connections, 1 to 32. Each transfers one brick at a time.
  int connections = 6;
  std::chrono::milliseconds connect{2'000};   ///< Longest time to establish a connection.
  std::chrono::milliseconds stalled{2'000};   ///< Longest pause within a transfer.
  std::chrono::milliseconds longest{30'000};  ///< Longest duration of a transfer.

  /// isThere() returns false if the store has not answered for this time.
  std::chrono::milliseconds silent{2'000};
  /// Longest duration of a blocking fetch, including all its tries.
  std::chrono::milliseconds opened{60'000};
};

/// Value of ObjectRequest::why if memory is short.
inline constexpr char kNoMemory[] = "the system has too little memory";

/// A request for an object of the store, and its result. The caller may use an ObjectRequest again.
struct ObjectRequest {
  virtual ~ObjectRequest() = default;

  // Members that describe the request.
  std::size_t limit = 0;  ///< Largest number of bytes of the object to transfer [bytes].
  bool part = false;      ///< True if only the first `limit` bytes of the object are requested.
  std::size_t least = 0;  ///< Smallest valid length of the object [bytes].
  // Members that contain the result.
  std::vector<std::byte> body;  ///< Received bytes, at most `limit`.

  /// Result of the request. kCut means that the object's length is not within `least` and `limit`.
  BrickStatus status = BrickStatus::kUnreadable;
  /// Length of the object that the server stated [bytes]; set only if that length is invalid.
  std::optional<std::size_t> announced;
  const char* why = nullptr;  ///< Reason for kUnreadable. The text stays valid.
  long code = 0;              ///< Status code of the server for kUnreadable; 0 if unknown.
  /// Time at which the last data arrived, or else at which the request began.
  std::chrono::steady_clock::time_point last;

  /// Sets the members that describe a request, and clears the result.
  void ask(std::size_t at_least, std::size_t at_most, bool its_begin = false) noexcept {
    least = at_least;
    limit = at_most;
    part = its_begin;
    announced.reset();
    body.clear();
    fail(nullptr);
    last = std::chrono::steady_clock::now();
  }
  /// Sets the result to kUnreadable, with a reason and the server's status code.
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
  /// The store may be destroyed only while no request is in progress.
  virtual ~ObjectStore() = default;

  /// Makes a request object for this store. Any thread may call it.
  [[nodiscard]] virtual std::unique_ptr<ObjectRequest> make() = 0;
  /// Fetches an object and waits for the result. Any thread may call it, but not with a request
  /// that is ever passed to begin().
  virtual void get(const std::string& name, ObjectRequest& request) noexcept = 0;
  /// Starts a request. When the request has ended, ended() returns it. If the request cannot be
  /// started, begin() returns false, and `request` contains the reason.
  [[nodiscard]] virtual bool begin(const std::string& name, ObjectRequest& request) noexcept = 0;
  /// Drops a request in progress. The store neither writes to it nor returns it from ended().
  virtual void drop(ObjectRequest& request) noexcept = 0;
  /// Waits for the end of a request and returns it. Returns null after `patience` or wake().
  [[nodiscard]] virtual ObjectRequest* ended(std::chrono::milliseconds patience) noexcept = 0;
  virtual void wake() noexcept = 0;  ///< Ends the wait of ended(). Any thread may call it.
};

/// A folder of bricks in a store. A thread of this object requests objects from the store. The
/// thread that calls next() decompresses and checks them like files, so a faulty server cannot
/// deliver wrong bricks.
class FarBricks final : public BrickSource {
 public:
  /// Fetches the manifest. Throws VolumeError if the store does not answer or has no manifest.
  /// @param address  Address of the folder, for messages.
  FarBricks(const std::string& address, std::unique_ptr<ObjectStore> store,
            const StoreParams& params = {});
  ~FarBricks() override;  ///< Ends the transfers in progress.

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// Returns the last answer of the store about the manifest, and requests a new answer. Does not
  /// wait. The result is at most as old as StoreParams::silent.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;
  [[nodiscard]] std::chrono::duration<double> delay() const override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace palpate
