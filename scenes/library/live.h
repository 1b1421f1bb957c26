/// Memory that a running loop shares with a window in another process. The window reads the loop's
/// state and sends requests. Neither process can block the other.
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
#include "palpate/samplers/descriptor.h"

namespace palpate {

/// Publishes a value without pointers to any number of readers, also in other processes. The class
/// is a sequence lock: the writer never waits, and a reader gets a complete value or must read
/// again. Unlike the reader of a Mailbox, a reader changes no state and needs no write access.
template <class T>
class Published {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// Replaces the value. Only one thread may call write(). RT: wait-free; copies the value twice.
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
  /// if the writer wrote during the copy. RT: wait-free.
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

/// Largest number of modes that a window shows; the window omits further modes.
inline constexpr std::size_t kLiveModes = 64;
/// Largest number of primitives that a window shows; the window omits further primitives.
inline constexpr std::size_t kLivePrimitives = 64;
/// Number of past ticks that a window can show: about 4 s at 1 kHz.
inline constexpr std::size_t kLiveRows = 4096;

/// A primitive in the last balance of a tick.
struct LivePrimitive {
  std::array<double, 3> position{};   ///< Primitive::position [m].
  std::array<double, 3> direction{};  ///< Primitive::direction.
  std::array<double, 3> force{};      ///< Force on the proxy [N].
  double strength = 0.0;              ///< Primitive::strength [N].
  /// Determines the meaning of `position` and `direction`.
  PrimitiveKind kind = PrimitiveKind::kForce;
  bool friction = false;  ///< True for a friction line.
  /// Index of the primitive's mode in LiveScene::modes; kLiveModes: the list lacks this mode.
  std::uint16_t mode = 0;
};

/// A tick with its primitives. Published about 100 times a second (in each tick at rates below
/// 150 Hz), and when the fault changes.
struct LiveTick {
  std::int64_t tick = 0;                       ///< Telemetry::tick, the number of the tick.
  std::uint64_t scene = 0;                     ///< Scene::id.
  double time = 0.0;                           ///< Time since the start [s].
  std::array<double, 3> probe{};               ///< Position of the probe [m].
  std::array<double, 3> proxy{};               ///< Position of the proxy [m].
  std::array<double, 3> force{};               ///< Force that was sent to the device [N].
  double stiffness = 0.0;                      ///< Stiffness of the coupling [N/m].
  double error_bound = 0.0;                    ///< StepReport::error_bound [m].
  std::int64_t late_ticks = 0;                 ///< Number of late ticks since the start.
  std::uint32_t primitive_count = 0;           ///< Number of valid entries in `primitives`.
  StepStatus status = StepStatus::kConverged;  ///< Result of the tick.
  Fault fault = Fault::kNone;                  ///< Fault that cuts the force; kNone: no fault.
  bool limited = false;  ///< True if the force was limited (StepReport::limited).
  /// The primitives, in the order of their modes.
  std::array<LivePrimitive, kLivePrimitives> primitives{};
};

/// A few numbers of a tick, published for every tick.
struct LiveRow {
  std::int64_t tick = 0;  ///< Telemetry::tick, the number of the tick.
  double time = 0.0;      ///< Time since the start of the run [s].
  float force = 0.0F;     ///< Magnitude of the force that was sent to the device [N].
  float apart = 0.0F;     ///< Distance between probe and proxy [m].
  float took = 0.0F;      ///< Time that the computation of the tick took [s].
};

/// Largest gain that the user can set in a window.
inline constexpr float kMostDial = 8.0F;

/// The gain of one mode. A mode keeps its number (`mode`) if an edit of the scene keeps the mode's
/// name. A mode without a name keeps its number if the edit keeps the kind and the volume. Other
/// modes get new numbers, so that a late request cannot change their gains.
struct LiveDial {
  std::uint32_t mode = 0;  ///< Number that identifies the mode.
  /// Gain: factor of the mode's strength and viscosity, 0 to kMostDial; 0: off. Not for
  /// user-defined modes.
  float factor = 1.0F;
};

/// Names and gains of a scene's modes.
struct LiveScene {
  /// Largest length of a name with its terminating zero byte [bytes].
  static constexpr std::size_t kName = 48;

  std::uint64_t id = 0;          ///< Scene::id.
  std::uint32_t mode_count = 0;  ///< Number of valid entries in `modes`.
  /// One mode with its gain.
  struct Mode {
    std::array<char, kName> name{};  ///< Name to show, terminated by a zero byte.
    LiveDial dial;                   ///< Gain with which the scene was built.
  };
  std::array<Mode, kLiveModes> modes{};  ///< Modes outside parts, then those of the groups.
};

/// Requests of the window's user. To make a request, the window increases the request's count.
struct LiveWishes {
  std::uint64_t cuts = 0;        ///< Number of requests to cut the force.
  std::uint64_t clears = 0;      ///< Number of requests to restore the force.
  std::uint64_t closed = 0;      ///< Not 0 if the user has closed the window.
  std::uint64_t dialled = 0;     ///< Number of requests to change gains.
  std::uint32_t dial_count = 0;  ///< Number of valid `dials`.
  /// Requested gains of all modes in the window.
  std::array<LiveDial, kLiveModes> dials{};
};

/// Target of the hand, which the mouse in the window sets.
struct LiveHand {
  std::array<double, 3> target{};  ///< Position in W [m].
};

/// The memory block that both processes map.
struct LiveBlock {
  /// The text "palplive". In every version, the block begins with this text.
  static constexpr std::uint64_t kMagic = 0x6576696c'706c6170;
  /// Version of the layout. Increase it with each change of a member below.
  static constexpr std::uint64_t kLayout = 3;

  /// kMagic; with another value, this memory is not a LiveBlock.
  std::atomic<std::uint64_t> magic{kMagic};
  /// kLayout; with another value, the members have another layout.
  std::atomic<std::uint64_t> layout{kLayout};
  // The loop writes these members.
  Published<LiveTick> tick;    ///< The newest complete tick.
  Published<LiveScene> scene;  ///< Modes of the scene of `tick`.
  /// The row of tick n is at the index n % kLiveRows.
  std::array<Published<LiveRow>, kLiveRows> rows;
  std::atomic<std::int64_t> newest{0};   ///< Number of the newest tick that has a row.
  std::atomic<std::int64_t> process{0};  ///< Process id of the loop, which has started the window.
  std::atomic<std::uint32_t> over{0};    ///< Not 0 if the run has ended.
  /// LiveWishes::dialled of the last request for gains that the loop rejected.
  std::atomic<std::uint64_t> refused{0};
  // The window's process writes these members.
  Published<LiveWishes> wishes;  ///< Requests to the loop.
  Published<LiveHand> hand;      ///< Target of the hand from the mouse.
};

/// Returns the core with the highest number that this process may use. The first hand's loop runs
/// on this core, and the window must not. Returns -1 if the process may use only one core, or if
/// the kernel does not report the cores.
[[nodiscard]] int loopsCore() noexcept;

/// A LiveBlock in memory that two processes map.
class LiveShare {
 public:
  /// Creates the memory of a loop, whose size no process can change. Throws Error.
  LiveShare();
  /// Maps a loop's memory by an inherited descriptor, and takes the descriptor over. Throws Error,
  /// and closes the descriptor, if the memory is not a loop's, has another layout or cannot be
  /// mapped.
  explicit LiveShare(int descriptor);
  ~LiveShare();
  LiveShare(const LiveShare&) = delete;
  LiveShare& operator=(const LiveShare&) = delete;

  /// Returns the block, valid as long as this object exists.
  [[nodiscard]] LiveBlock& block() noexcept { return *block_; }
  /// Returns the block for reading.
  [[nodiscard]] const LiveBlock& block() const noexcept { return *block_; }
  /// Returns the descriptor. A child process inherits the descriptor only if the caller passes it
  /// to the child.
  [[nodiscard]] int descriptor() const noexcept { return descriptor_.get(); }

 private:
  void map();

  Descriptor descriptor_;
  LiveBlock* block_ = nullptr;
};

/// Publishes the ticks of a loop to a window.
// Padding is intended: the mailbox keeps the data of its two threads on separate cache lines.
class LiveWriter {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// The block must outlive this object. `rate` is the rate of the loop [Hz].
  LiveWriter(LiveBlock& block, double rate);
  /// Announces the scene of the next ticks. Call expect() before you publish the scene, from the
  /// thread that publishes the scene. `dials` contains the gains of the modes of SceneSpec::graph.
  /// If `dials` is empty, each mode's number is its index and its gain is 1.
  void expect(const Scene& scene, std::span<const LiveDial> dials = {});
  /// Publishes a tick after its force was sent. Only the loop's thread may call take(). RT:
  /// wait-free, no allocation.
  void take(const Telemetry& tick, const ProxyState& state) noexcept PALPATE_NONBLOCKING;

 private:
  /// Assigns the primitives of a tick to the modes of its scene.
  struct Modes {
    std::uint64_t id = 0;
    std::size_t own = 0;  ///< Number of modes outside parts; the modes of parts follow them.
    std::vector<std::uint32_t>
        of_part;  ///< Index of each part's first mode. The parts of a group share modes.
    LiveScene told;
  };
  void tellWhole(const Telemetry& tick, const ProxyState& state) noexcept;

  LiveBlock& block_;
  std::int64_t every_;  ///< A tick with primitives is published once per this number of ticks.
  Mailbox<std::shared_ptr<const Modes>> expected_;
  std::uint64_t told_scene_ = 0;
  Fault told_fault_ = Fault::kNone;
  LiveTick whole_;
};

}  // namespace palpate
