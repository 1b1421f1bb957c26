/// Newton on the balance: what one reading leads to.
#pragma once

#include <limits>

#include "palpate/engine/rail.h"
#include "palpate/engine/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A balance, and Newton's step on it.
struct Balanced {
  Vec3 proxy = Vec3::Zero();          ///< The balance G(x) [m].
  Vec3 offset = Vec3::Zero();         ///< G(x) from the probe [m].
  Vec3 step = Vec3::Zero();           ///< Newton's step from x [m].
  Vec3 target = Vec3::Zero();         ///< Where Newton's step leads [m].
  Vec3 target_offset = Vec3::Zero();  ///< The target from the probe [m].
};

/// How far Newton's step is trusted: a voxel, and half as far each time that it turns back on the
/// last one. Without surfaces the balance lies between two readings whose steps turn back: the
/// radius is then half of what is left between them, which is bisection.
struct TrustRegion {
  double radius = std::numeric_limits<double>::infinity();  ///< The trust radius [m].
  double ahead = std::numeric_limits<double>::infinity();   ///< The balance is this near [m].
  bool closed = false;                                      ///< `ahead` is within the tolerance.
  double reach = 0.0;  ///< How far from the hand the strengths last read hold the proxy [m].
  double went = 0.0;   ///< Distance between the last two readings [m].
  double least = std::numeric_limits<double>::infinity();  ///< Shortest step of this move [m].
  Vec3 least_at = Vec3::Zero();                            ///< Where the shortest step begins [m].
  Vec3 least_target = Vec3::Zero();                        ///< Where the shortest step leads [m].

  /// Forgets the shortest step: none so far counts.
  void forgetLeast() noexcept { least = std::numeric_limits<double>::infinity(); }
};

/// The iteration of one slice of a tick, in which volumes and hand stand still.
struct Iteration {
  Vec3 last_read = Vec3::Zero();  ///< Where properties were read last [m].
  Vec3 read_at = Vec3::Zero();    ///< Where the next trial step starts if `read` [m].
  bool read = false;              ///< Read in this slice; else trial steps start at the proxy.
  Balanced to;                    ///< The last balance, and where the next trial step is to lead.
  TrustRegion trust;              ///< How far such a step may go.
  double voxel = std::numeric_limits<double>::infinity();  ///< The finest voxel of what varies [m].
  bool follows = false;  ///< Something other than a surface varies, or has in this slice: a reading
                         ///< holds for its own place only.
  double followed = std::numeric_limits<double>::infinity();  ///< Finest voxel beside surfaces [m].
  Rail rail;  ///< The stream that holds the proxy; laid anew when the proxy moves.
};

/// True if something varies, and nothing that varies pushes or is put on a surface: all stands at
/// the proxy (but a front that is snapped off). The balance as it was read then makes no energy,
/// and what Newton's step is beyond the balance might.
[[nodiscard]] bool anchored(const BalanceMemory& b) noexcept;

/// Reads properties at `at` [m]: step 1 of the paper's figure 1. RT: no allocation.
void read(Tick& tick, Iteration& now, const Vec3& at) noexcept PALPATE_NONBLOCKING;

/// Begins the memory of the modes for a proxy that is new here, at its place. RT: no allocation.
void lookRound(Tick& tick) noexcept PALPATE_NONBLOCKING;

/// Places the primitives (step 2), finds their balance (eqs. 14, 15), and Newton's step from `from`
/// [m], where they were read. `foreseen`: the planes are the last reading's, carried along. False
/// where a sample that is not finite spoilt the balance. RT: no allocation.
[[nodiscard]] bool balance(Tick& tick, Iteration& now, bool foreseen,
                           const Vec3& from) noexcept PALPATE_NONBLOCKING;

/// Updates the trust region after a reading displaced by `way` [m] from the last; `compared`: that
/// was of the same data, and a step that turns back says how far they can be trusted. Forces that
/// jump, as those towards an axis do on it, have no balance where Newton's step ends; they balance
/// where the step turns back on itself however short it is: a force between those on both sides
/// balances there (Filippov's solution). Found to the tolerance, that place is the last reading's;
/// where nothing pushes it is the balance of that reading, which makes no energy.
void trust(const Tick& tick, Iteration& now, const Vec3& way, bool compared) noexcept;

/// True if what is left after Newton's step is within the tolerance: the step itself is, and where
/// nothing pushes and no surface holds the balance too, so that the proxy is where its primitives,
/// which make no energy, put it; or, where planes of surfaces alone hold, the step is so much
/// shorter than the one before that the next would be, and the proxy stays on the planes.
[[nodiscard]] bool steady(const Tick& tick, const Iteration& now) noexcept;
/// True if p [m] is within so much [m] of every surface that holds the proxy in the last balance,
/// and not farther behind one that bears nothing: by the values there, for slopes jump at the faces
/// of trilinear cells and no plane tells by how much. Cost: a value and a slope a surface.
[[nodiscard]] bool onSurfaces(const Tick& tick, const Vec3& p, double within) noexcept;
/// Where the proxy is, once what is left is within the tolerance [m]: at the balance, if the last
/// reading is that near to it, to the last digit, on which friction's threshold rests; else where
/// Newton's step leads. Where neither is certain to be on the surface, at the last reading.
[[nodiscard]] Vec3 answer(const Tick& tick, const Iteration& now) noexcept;

/// How far from the hand all that was placed can hold the proxy [m].
[[nodiscard]] double reachOfStrengths(const Tick& tick) noexcept;

}  // namespace palpate
