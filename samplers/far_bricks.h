/// Bricks out of what gives objects by their names, far away: a web server (http_store.h), a Ceph
/// cluster (rados_store.h), or a store of one's own.
#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "palpate/samplers/bricks.h"

namespace palpate {

/// How a store is asked.
struct StoreParams {
  int connections = 6;                        ///< At a time, 1 to 32; each carries one brick.
  std::chrono::milliseconds connect{2'000};   ///< A connection has to stand within this.
  std::chrono::milliseconds stalled{2'000};   ///< A transfer has to go on within this,
  std::chrono::milliseconds longest{30'000};  ///< and to end within this.
  std::chrono::milliseconds silent{2'000};    ///< isThere(): no answer for so long is none.
  std::chrono::milliseconds opened{60'000};   ///< Within this it has told what there is.
};

/// ObjectRequest::why where it has no room in memory.
inline constexpr char kNoMemory[] = "there is no memory for it";

/// An object that is asked for, and how that went. Used over and over, with its memory.
struct ObjectRequest {
  virtual ~ObjectRequest() = default;

  // The question.
  std::size_t limit = 0;  ///< Of a longer object no more is taken than this [bytes],
  bool part = false;      ///< which is all that is asked for: its begin.
  // The answer.
  std::vector<std::byte> body;                    ///< At most `limit`.
  BrickStatus status = BrickStatus::kUnreadable;  ///< kCut: it is longer.
  const char* why = nullptr;                      ///< Of kUnreadable; lasts.
  long code = 0;  ///< Of kUnreadable: with what a server answered; 0: nothing that one knows.
  std::chrono::steady_clock::time_point last;  ///< When something came, or it was asked for.

  /// Asks for so much, anew.
  void ask(std::size_t at_most, bool its_begin = false) noexcept {
    limit = at_most;
    part = its_begin;
    body.clear();
    fail(nullptr);
    last = std::chrono::steady_clock::now();
  }
  /// The answer is that it could not be had.
  void fail(const char* reason, long number = 0) noexcept {
    status = BrickStatus::kUnreadable;
    why = reason;
    code = number;
  }
};

/// What gives objects by their names. begin(), drop() and ended() are for one thread.
class ObjectStore {
 public:
  ObjectStore() = default;
  ObjectStore(const ObjectStore&) = delete;
  ObjectStore& operator=(const ObjectStore&) = delete;
  virtual ~ObjectStore() = default;  ///< When no request is on its way any more.

  /// A request of this store's. By any thread.
  [[nodiscard]] virtual std::unique_ptr<ObjectRequest> make() = 0;
  /// Asks, and waits for the end. By any thread, each with requests that begin() never has.
  virtual void get(const std::string& name, ObjectRequest& request) noexcept = 0;
  /// Asks; ended() gives it when it has ended. False: it failed at once, as `request` says.
  [[nodiscard]] virtual bool begin(const std::string& name, ObjectRequest& request) noexcept = 0;
  /// Of what was begun and has not ended: ended() never gives it, nothing is written to it.
  virtual void drop(ObjectRequest& request) noexcept = 0;
  /// One that has ended; none: nothing has within `patience`, or wake() was called.
  [[nodiscard]] virtual ObjectRequest* ended(std::chrono::milliseconds patience) noexcept = 0;
  virtual void wake() noexcept = 0;  ///< By any thread.
};

/// The folder of bricks in a store. A thread of its own asks for them; who calls next()
/// decompresses and checks. Whoever answers can give bricks that do not arrive, not ones that are
/// wrong: no object is taken that is longer than the manifest says or a brick can be, and they are
/// checked as files are.
class FarBricks final : public BrickSource {
 public:
  /// Fetches the manifest. Throws VolumeError: no answer, no manifest.
  /// @param address  Of the folder, for messages.
  FarBricks(const std::string& address, std::unique_ptr<ObjectStore> store,
            const StoreParams& params = {});
  ~FarBricks() override;  ///< Ends what is on its way.

  [[nodiscard]] const BrickManifest& manifest() const noexcept override;
  void want(std::vector<BrickWish> wishes) override;
  [[nodiscard]] std::optional<BrickArrival> next(std::span<std::byte> slot,
                                                 std::chrono::milliseconds patience) override;
  /// By the store's last answer about the manifest, asked for anew each time: it takes no time,
  /// and says what was StoreParams::silent ago at worst.
  [[nodiscard]] bool isThere() override;
  [[nodiscard]] BrickArrival read(const BrickId& id, std::span<std::byte> slot) override;
  [[nodiscard]] std::chrono::duration<double> delay() const override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace palpate
