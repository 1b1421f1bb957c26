/// A running loop as a window in another process sees it, and what that window asks of it: one
/// block of memory that both map. Neither side can hold up the other.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "palpate/engine/mailbox.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"
#include "palpate/engine/telemetry.h"

namespace palpate {

/// The newest value of plain data from one writer to any readers, perhaps in other processes.
///
/// A sequence lock: the writer never waits, whatever readers do; a reader sees a whole value or
/// none, and asks again. A Mailbox cannot be used here: its reader takes slots from the writer, and
/// a reader of another process may be one that has gone wrong.
template <class T>
class Published {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// Replaces the value. One thread. RT: wait-free, no allocation. Cost: a store for every 8 bytes.
  void write(const T& value) noexcept {
    std::array<std::uint64_t, kWords> words{};
    std::memcpy(words.data(), &value, sizeof(T));
    const std::uint64_t turn = turn_.load(std::memory_order_relaxed);
    turn_.store(turn + 1, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    for (std::size_t i = 0; i < kWords; ++i) {
      words_[i].store(words[i], std::memory_order_relaxed);
    }
    turn_.store(turn + 2, std::memory_order_release);
  }
  /// Copies the newest value; false, and no change, where there has been none or a write came
  /// between. RT: wait-free.
  [[nodiscard]] bool read(T& value) const noexcept {
    const std::uint64_t turn = turn_.load(std::memory_order_acquire);
    if (turn == 0 || turn % 2 != 0) return false;
    std::array<std::uint64_t, kWords> words;
    for (std::size_t i = 0; i < kWords; ++i) words[i] = words_[i].load(std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_acquire);
    if (turn_.load(std::memory_order_relaxed) != turn) return false;
    std::memcpy(static_cast<void*>(&value), words.data(), sizeof(T));
    return true;
  }

 private:
  static constexpr std::size_t kWords = (sizeof(T) + 7) / 8;
  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);

  std::atomic<std::uint64_t> turn_{0};
  std::array<std::atomic<std::uint64_t>, kWords> words_{};
};

/// Modes that a window shows; of more it shows the first.
inline constexpr std::size_t kLiveModes = 64;
/// Primitives that a window shows; of more it shows the first.
inline constexpr std::size_t kLivePrimitives = 64;
/// Ticks that a window can look back at: 4 s at 1 kHz.
inline constexpr std::size_t kLiveRows = 4096;

/// One primitive of a tick's last balance.
struct LivePrimitive {
  std::array<double, 3> position{};            ///< Primitive::position [m].
  std::array<double, 3> direction{};           ///< Primitive::direction.
  std::array<double, 3> force{};               ///< What it does to the proxy [N].
  double strength = 0.0;                       ///< Primitive::strength [N].
  PrimitiveKind kind = PrimitiveKind::kForce;  ///< What its position and direction mean.
  bool friction = false;                       ///< A line of friction.
  std::uint16_t mode = 0;  ///< Index into LiveScene::modes; kLiveModes: of one that has no room.
};

/// One tick, whole: some hundred a second.
struct LiveTick {
  std::int64_t tick = 0;                                    ///< Telemetry::tick.
  std::uint64_t scene = 0;                                  ///< Scene::id.
  double time = 0.0;                                        ///< Time since the start [s].
  std::array<double, 3> probe{};                            ///< [m]
  std::array<double, 3> proxy{};                            ///< [m]
  std::array<double, 3> force{};                            ///< Force that was sent [N].
  double stiffness = 0.0;                                   ///< Of the coupling [N/m].
  double error_bound = 0.0;                                 ///< Of the last balance [m].
  std::int64_t late_ticks = 0;                              ///< Missed ticks so far.
  std::uint32_t primitive_count = 0;                        ///< Entries of `primitives`.
  StepStatus status = StepStatus::kConverged;               ///< How the tick ended.
  Fault fault = Fault::kNone;                               ///< Why the force is cut.
  bool limited = false;                                     ///< StepReport::limited.
  std::array<LivePrimitive, kLivePrimitives> primitives{};  ///< In the order of modes.
};

/// What is kept of every tick.
struct LiveRow {
  std::int64_t tick = 0;  ///< Telemetry::tick.
  double time = 0.0;      ///< [s]
  float force = 0.0F;     ///< Size of the force that was sent [N].
  float apart = 0.0F;     ///< |probe - proxy| [m].
  float took = 0.0F;      ///< Time that the tick took [s].
};

/// Most that a window's user turns a mode up.
inline constexpr float kMostDial = 8.0F;

/// A mode's dial. The mode is who it is, not where: the loop gives it a number of its own, which it
/// keeps while its scene's file is edited and no other mode ever gets. So what is asked of a mode
/// is never done to another, however late it comes.
struct LiveDial {
  std::uint32_t mode = 0;  ///< Who it is.
  float factor = 1.0F;     ///< Of its strength and viscosity, 0 to kMostDial; 0: it is off.
};

/// A scene's modes.
struct LiveScene {
  static constexpr std::size_t kName = 48;  ///< Longest name [bytes], with its zero byte.

  std::uint64_t id = 0;          ///< Scene::id.
  std::uint32_t mode_count = 0;  ///< Entries of `modes`.
  /// One mode, as it is felt.
  struct Mode {
    std::array<char, kName> name{};  ///< To be shown; ends with a zero byte.
    LiveDial dial;                   ///< What the scene was built with.
  };
  std::array<Mode, kLiveModes>
      modes{};  ///< The scene's own, then those of its parts, alike ones once.
};

/// What the window asks for: each count is one of requests.
struct LiveWishes {
  std::uint64_t cuts = 0;                    ///< Times that the force was to be cut.
  std::uint64_t clears = 0;                  ///< Times that it was to be let out again.
  std::uint64_t closed = 0;                  ///< Not 0: its user has closed the window.
  std::uint64_t dialled = 0;                 ///< Times that `dials` was changed.
  std::uint32_t dial_count = 0;              ///< Entries of `dials`.
  std::array<LiveDial, kLiveModes> dials{};  ///< Of all modes that the window knows.
};

/// Where the window's user means the hand to be [m].
struct LiveHand {
  std::array<double, 3> target{};  ///< In W [m].
};

/// The block.
struct LiveBlock {
  static constexpr std::uint64_t kMagic = 0x6576696c'706c6170;  ///< "palplive", of every layout.
  static constexpr std::uint64_t kLayout = 3;  ///< One more with each change of what follows.

  std::atomic<std::uint64_t> magic{kMagic};    ///< kMagic, else it is none.
  std::atomic<std::uint64_t> layout{kLayout};  ///< kLayout, else it is another version's.
  // From the loop.
  Published<LiveTick> tick;                        ///< The newest whole tick.
  Published<LiveScene> scene;                      ///< The scene of `tick`.
  std::array<Published<LiveRow>, kLiveRows> rows;  ///< Tick n's at n % kLiveRows.
  std::atomic<std::int64_t> newest{0};             ///< The newest row's tick.
  std::atomic<std::int64_t> process{0};            ///< The loop's; it starts the window's.
  std::atomic<std::uint32_t> over{0};              ///< Not 0: the run has ended.
  std::atomic<std::uint64_t> refused{0};  ///< The last LiveWishes::dialled that cannot be felt.
  // From the window.
  Published<LiveWishes> wishes;  ///< What is asked of the loop.
  Published<LiveHand> hand;      ///< Of a mouse.
};

/// The core on which the window does not run, the loop's of the first hand: the last of those that
/// this process may use; -1 where there is but one.
[[nodiscard]] int loopsCore() noexcept;

/// The block's memory, mapped.
class LiveShare {
 public:
  /// New memory, for a loop. Nobody can make it shorter. Throws Error.
  LiveShare();
  /// That of another process, by an inherited descriptor. Throws Error where it is none.
  explicit LiveShare(int descriptor);
  ~LiveShare();
  LiveShare(const LiveShare&) = delete;
  LiveShare& operator=(const LiveShare&) = delete;

  /// The memory; valid as long as this.
  [[nodiscard]] LiveBlock& block() noexcept { return *block_; }
  /// The same, to read.
  [[nodiscard]] const LiveBlock& block() const noexcept { return *block_; }
  /// Closed in programs that are started, unless they are given it.
  [[nodiscard]] int descriptor() const noexcept { return descriptor_; }

 private:
  void map();

  int descriptor_ = -1;
  LiveBlock* block_ = nullptr;
};

/// Tells a window of a loop's ticks.
// The mailbox keeps its sides on cache lines of their own.
class LiveWriter {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// `rate`: ticks a second [Hz]. The block outlives it.
  LiveWriter(LiveBlock& block, double rate);
  /// The scene that ticks will be of soon: before it is published, from the thread that does.
  /// `dials`: of SceneSpec::graph's modes; none: each has its number there and is not turned.
  void expect(const Scene& scene, std::span<const LiveDial> dials = {});
  /// One tick, after it was sent, on its thread. RT: wait-free, no allocation. Cost: some 50 ns,
  /// every hundredth of a second some hundreds more.
  void take(const Telemetry& tick, const ProxyState& state) noexcept PALPATE_NONBLOCKING;

 private:
  /// Whose primitives are whose, of one scene.
  struct Modes {
    std::uint64_t id = 0;
    std::size_t own = 0;                 ///< The scene's own, then those of its parts.
    std::vector<std::uint32_t> of_part;  ///< The first of each part's; alike ones share theirs.
    LiveScene told;
  };
  void tellWhole(const Telemetry& tick, const ProxyState& state) noexcept;

  LiveBlock& block_;
  std::int64_t every_;  ///< Ticks from one whole one to the next.
  Mailbox<std::shared_ptr<const Modes>> expected_;
  std::uint64_t told_scene_ = 0;
  Fault told_fault_ = Fault::kNone;
  LiveTick whole_;
};

}  // namespace palpate
