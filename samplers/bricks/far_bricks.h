/// Bricks from remote stores that provide objects by name: a web server (http_store.h), a Ceph
/// cluster (rados_store.h), or a store of the user's own.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstring>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Limits of the requests to a store.
struct StoreParams {
  /// Number of simultaneous connections for bricks; values outside of 1 to 32 are clamped. Each
  /// transfers one brick at a time. A web server gets one more connection, for isThere().
  int connections = 6;
  std::chrono::milliseconds connect{2'000};  ///< Longest time to establish a connection.
  std::chrono::milliseconds stalled{2'000};  ///< Longest pause within a transfer.
  /// Longest duration of a transfer in the background. `opened` limits blocking fetches.
  std::chrono::milliseconds longest{30'000};

  /// isThere() returns false if the store has not answered a check for this time.
  std::chrono::milliseconds silent{2'000};
  /// Longest duration of a blocking fetch, including all its tries. With a store that cannot stop a
  /// try, such as Ceph, a fetch may take longer: after this time, it only starts no further try.
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

  /// Result of the request. kCut means that the object is longer than `limit`, or that the server
  /// stated a length outside of `least` to `limit`.
  BrickStatus status = BrickStatus::kUnreadable;
  /// Length of the object that the server stated [bytes]; set only if that length is invalid. 0 if
  /// the server sent a range that does not begin at byte 0.
  std::optional<std::size_t> announced;
  const char* why = nullptr;  ///< Reason for kUnreadable; null if unknown. The text stays valid.
  long code = 0;              ///< Status code of the server for kUnreadable; 0 if unknown.

  /// Time at which the last data arrived, if the store records it; else the time at which the
  /// request began.
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
  /// Returns true if memory was short. A store in a module may have its own copy of the text.
  [[nodiscard]] bool lacksMemory() const noexcept {
    return why != nullptr && std::strcmp(why, kNoMemory) == 0;
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
  /// Fetches an object and waits for the result. Any thread may call it. Do not use the same
  /// request object for get() and for begin().
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
/// thread that calls next() decompresses the objects and checks them against the manifest, so it
/// rejects damaged objects.
class FarBricks final : public BrickSource {
 public:
  /// Fetches the manifest. Throws VolumeError if the store does not answer, reports an error or has
  /// no manifest, or if the manifest is longer than 1 GiB or rejected by BrickManifest::parse.
  /// @param address  Address of the folder, for messages.
  FarBricks(const std::string& address, std::unique_ptr<ObjectStore> store,
            const StoreParams& params = {});
  ~FarBricks() override;  ///< Ends the transfers in progress.

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// Returns true if the store's last answer had the manifest's unchanged head, or if there is no
  /// answer yet. Requests a new answer, and does not wait for it. Returns false while a request is
  /// unanswered for longer than StoreParams::silent.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;
  [[nodiscard]] std::chrono::duration<double> delay() const override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace palpate
