/// Memory that a running loop shares with a window in another process: the loop's state and the
/// window's requests. Neither side can block the other.
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

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/loop/mailbox.h"
#include "palpate/engine/loop/telemetry.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate {

/// Publishes plain data from one writer to any number of readers, also in other processes.
///
/// A sequence lock: the writer never waits for readers. A reader gets a whole value, or fails and
/// reads again. A Mailbox cannot be used here: its reader takes slots from the writer, and a reader
/// in another process may be faulty.
template <class T>
class Published {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// Replaces the value. One thread. RT: wait-free, no allocation. Cost: one store per 8 bytes.
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
  /// Copies the newest value. Returns false and leaves `value` unchanged before the first write, or
  /// if a write intervened. RT: wait-free.
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

/// Largest number of modes that a window shows; it shows the first ones.
inline constexpr std::size_t kLiveModes = 64;
/// Largest number of primitives that a window shows; it shows the first ones.
inline constexpr std::size_t kLivePrimitives = 64;
/// Number of past ticks that a window can show: 4 s at 1 kHz.
inline constexpr std::size_t kLiveRows = 4096;

/// One primitive of a tick's last balance.
struct LivePrimitive {
  std::array<double, 3> position{};            ///< Primitive::position [m].
  std::array<double, 3> direction{};           ///< Primitive::direction.
  std::array<double, 3> force{};               ///< Force on the proxy [N].
  double strength = 0.0;                       ///< Primitive::strength [N].
  PrimitiveKind kind = PrimitiveKind::kForce;  ///< Meaning of position and direction.
  bool friction = false;                       ///< True for a friction line.
  std::uint16_t mode = 0;  ///< Index into LiveScene::modes; kLiveModes: the mode is beyond the
                           ///< list.
};

/// One complete tick; published about 100 times a second.
struct LiveTick {
  std::int64_t tick = 0;                                    ///< Telemetry::tick.
  std::uint64_t scene = 0;                                  ///< Scene::id.
  double time = 0.0;                                        ///< Time since the start [s].
  std::array<double, 3> probe{};                            ///< [m]
  std::array<double, 3> proxy{};                            ///< [m]
  std::array<double, 3> force{};                            ///< Force that was sent [N].
  double stiffness = 0.0;                                   ///< Stiffness of the coupling [N/m].
  double error_bound = 0.0;                                 ///< StepReport::error_bound of the last
                                                            ///< balance [m].
  std::int64_t late_ticks = 0;                              ///< Missed ticks so far.
  std::uint32_t primitive_count = 0;                        ///< Entries of `primitives`.
  StepStatus status = StepStatus::kConverged;               ///< How the tick ended.
  Fault fault = Fault::kNone;                               ///< Why the force is cut.
  bool limited = false;                                     ///< StepReport::limited.
  std::array<LivePrimitive, kLivePrimitives> primitives{};  ///< In the order of modes.
};

/// Record of every tick.
struct LiveRow {
  std::int64_t tick = 0;  ///< Telemetry::tick.
  double time = 0.0;      ///< [s]
  float force = 0.0F;     ///< Magnitude of the force that was sent [N].
  float apart = 0.0F;     ///< |probe - proxy| [m].
  float took = 0.0F;      ///< Duration of the tick [s].
};

/// Largest factor that a window's user can set for a mode.
inline constexpr float kMostDial = 8.0F;

/// Gain of a mode. It names the mode by a number, not by an index. The loop assigns the number; the
/// mode keeps it while its scene's file is edited, and no other mode ever gets it. So a late
/// request cannot change another mode.
struct LiveDial {
  std::uint32_t mode = 0;  ///< The mode's number.
  float factor = 1.0F;     ///< Factor of its strength and viscosity, 0 to kMostDial; 0: off.
};

/// Modes of a scene.
struct LiveScene {
  static constexpr std::size_t kName = 48;  ///< Longest name [bytes], with its zero byte.

  std::uint64_t id = 0;          ///< Scene::id.
  std::uint32_t mode_count = 0;  ///< Entries of `modes`.
  /// One mode with its gain.
  struct Mode {
    std::array<char, kName> name{};  ///< Text to show; ends with a zero byte.
    LiveDial dial;                   ///< Gain that the scene was built with.
  };
  std::array<Mode, kLiveModes>
      modes{};  ///< The scene's own modes, then those of its parts; similar parts once.
};

/// Requests from the window; a request raises its count.
struct LiveWishes {
  std::uint64_t cuts = 0;                    ///< Requests to cut the force.
  std::uint64_t clears = 0;                  ///< Requests to restore the force.
  std::uint64_t closed = 0;                  ///< Not 0: the user has closed the window.
  std::uint64_t dialled = 0;                 ///< Changes of `dials`.
  std::uint32_t dial_count = 0;              ///< Entries of `dials`.
  std::array<LiveDial, kLiveModes> dials{};  ///< Gains of all modes that the window knows.
};

/// Target of the hand, from the window's user.
struct LiveHand {
  std::array<double, 3> target{};  ///< In W [m].
};

/// The shared block of memory.
struct LiveBlock {
  static constexpr std::uint64_t kMagic = 0x6576696c'706c6170;  ///< "palplive", for every layout.
  static constexpr std::uint64_t kLayout = 3;  ///< Raised with each change of the members below.

  std::atomic<std::uint64_t> magic{kMagic};    ///< kMagic; else this is not a LiveBlock.
  std::atomic<std::uint64_t> layout{kLayout};  ///< kLayout; else it has another version.
  // From the loop.
  Published<LiveTick> tick;                        ///< The newest whole tick.
  Published<LiveScene> scene;                      ///< Scene of `tick`.
  std::array<Published<LiveRow>, kLiveRows> rows;  ///< Tick n is at n % kLiveRows.
  std::atomic<std::int64_t> newest{0};             ///< Tick of the newest row.
  std::atomic<std::int64_t> process{0};            ///< Id of the loop's process, which starts the
                                                   ///< window.
  std::atomic<std::uint32_t> over{0};              ///< Not 0: the run has ended.
  std::atomic<std::uint64_t> refused{0};  ///< Newest LiveWishes::dialled that the loop rejected.
  // From the window.
  Published<LiveWishes> wishes;  ///< Requests to the loop.
  Published<LiveHand> hand;      ///< Target from a mouse.
};

/// Returns the core of the loop of the first hand, which the window must not use: the last core of
/// those that this process may use. Returns -1 if there is only one.
[[nodiscard]] int loopsCore() noexcept;

/// Mapped memory of a LiveBlock.
class LiveShare {
 public:
  /// Creates new memory, for a loop. No process can shrink it. Throws Error.
  LiveShare();
  /// Maps another process's memory by an inherited descriptor. Throws Error if the descriptor is of
  /// another kind.
  explicit LiveShare(int descriptor);
  ~LiveShare();
  LiveShare(const LiveShare&) = delete;
  LiveShare& operator=(const LiveShare&) = delete;

  /// Returns the block; valid as long as this object.
  [[nodiscard]] LiveBlock& block() noexcept { return *block_; }
  /// Returns the block for reading.
  [[nodiscard]] const LiveBlock& block() const noexcept { return *block_; }
  /// Returns the descriptor. A started program inherits it only if the caller passes it on.
  [[nodiscard]] int descriptor() const noexcept { return descriptor_; }

 private:
  void map();

  int descriptor_ = -1;
  LiveBlock* block_ = nullptr;
};

/// Publishes a loop's ticks to a window.
// The mailbox keeps its two sides on separate cache lines.
class LiveWriter {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// `rate`: ticks per second [Hz]. The block must outlive this object.
  LiveWriter(LiveBlock& block, double rate);
  /// Announces the scene of coming ticks. Call it before the scene is published, from the
  /// publishing thread. `dials`: gains of the modes of SceneSpec::graph; empty: a mode's number is
  /// its index there, and its factor is 1.
  void expect(const Scene& scene, std::span<const LiveDial> dials = {});
  /// Publishes one tick after its force was sent, on the tick's thread. RT: wait-free, no
  /// allocation. Cost: some 50 ns, and some hundreds of ns more every hundredth of a second.
  void take(const Telemetry& tick, const ProxyState& state) noexcept PALPATE_NONBLOCKING;

 private:
  /// Assigns the primitives of one scene to its modes.
  struct Modes {
    std::uint64_t id = 0;
    std::size_t own = 0;                 ///< Number of the scene's own modes; those of parts
                                         ///< follow.
    std::vector<std::uint32_t> of_part;  ///< Index of each part's first mode; similar parts share
                                         ///< it.
    LiveScene told;
  };
  void tellWhole(const Telemetry& tick, const ProxyState& state) noexcept;

  LiveBlock& block_;
  std::int64_t every_;  ///< Ticks between two complete ones.
  Mailbox<std::shared_ptr<const Modes>> expected_;
  std::uint64_t told_scene_ = 0;
  Fault told_fault_ = Fault::kNone;
  LiveTick whole_;
};

}  // namespace palpate
