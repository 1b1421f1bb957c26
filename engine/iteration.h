/// Newton on the balance: what one reading leads to.
#pragma once

#include <limits>

#include "palpate/engine/rail.h"
#include "palpate/engine/tick.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Where a balance is, and where Newton's step on it leads.
struct Balanced {
  Vec3 proxy = Vec3::Zero();          ///< G(x) [m],
  Vec3 offset = Vec3::Zero();         ///< and from the probe.
  Vec3 step = Vec3::Zero();           ///< Newton's, from x [m],
  Vec3 target = Vec3::Zero();         ///< which leads here [m],
  Vec3 target_offset = Vec3::Zero();  ///< from the probe.
};

/// How far Newton's step is believed: a voxel, half as far each time that it turns back on the last
/// one. Without surfaces a step that turns back between two readings has what it looks for between
/// them: then half of what is left of that way, which is bisection.
struct TrustRegion {
  double radius = std::numeric_limits<double>::infinity();  ///< [m]
  double ahead = std::numeric_limits<double>::infinity();   ///< It is within so much [m],
  bool closed = false;                                      ///< and that is little enough.
  double reach = 0.0;  ///< Of the strengths at the last reading [m].
  double went = 0.0;   ///< Between the last two readings [m].
  double least = std::numeric_limits<double>::infinity();  ///< The shortest step of this move [m],
  Vec3 least_at = Vec3::Zero();                            ///< from here,
  Vec3 least_target = Vec3::Zero();                        ///< to there.

  /// None so far counts.
  void forgetLeast() noexcept { least = std::numeric_limits<double>::infinity(); }
};

/// The iteration of one slice of a tick: volumes and hand stand.
struct Iteration {
  Vec3 last_read = Vec3::Zero();  ///< Where properties were read last [m],
  Vec3 read_at = Vec3::Zero();    ///< and whence the next trial step is: there,
  bool read = false;              ///< if it was in this slice; else it is from the proxy.
  Balanced to;
  TrustRegion trust;
  double voxel = std::numeric_limits<double>::infinity();  ///< The finest of what varies [m].
  bool follows = false;  ///< Something else than a surface varies, or has in this slice: what was
                         ///< read holds for the place of its reading only.
  double followed = std::numeric_limits<double>::infinity();  ///< The finest voxel of that [m].
  Rail rail;
};

/// Something varies, and nothing that does pushes or is put on a surface: what is left stands at
/// the proxy (but a front that is snapped off). Its balance, as it was read, makes no energy, and
/// what Newton's step is beyond that might.
[[nodiscard]] bool anchored(const BalanceMemory& b) noexcept;

/// Reads properties at a place [m]: step 1 of the paper's figure 1. RT: no allocation.
void read(Tick& tick, Iteration& now, const Vec3& at) noexcept PALPATE_NONBLOCKING;

/// A proxy that is new here: what its modes remember begins where it is. RT: no allocation.
void lookRound(Tick& tick) noexcept PALPATE_NONBLOCKING;

/// Places the primitives (step 2) and finds their balance (eqs. 14, 15), and Newton's step from
/// `from` [m], where they were read. `foreseen`: by the last reading's planes, as carried along.
/// False where a sample spoilt the balance. RT: no allocation.
[[nodiscard]] bool balance(Tick& tick, Iteration& now, bool foreseen,
                           const Vec3& from) noexcept PALPATE_NONBLOCKING;

/// The trust region after a reading that came `way` [m] from the last. Forces that leap, as those
/// towards an axis do on it, have no place where Newton's step ends; they balance where it turns
/// back on itself however short its way: a force between those on both sides is the balance's
/// (Filippov's solution). Found to the tolerance, that is where the last reading was; where nothing
/// pushes the balance of that reading, which makes no energy.
void trust(const Tick& tick, Iteration& now, const Vec3& way) noexcept;

/// What is left after Newton's step is within the tolerance: the step itself is, and where nothing
/// pushes and no surface holds the balance too, so that the proxy is where its primitives, which
/// make no energy, put it; or, where planes of surfaces alone hold, it is so much shorter than the
/// way that led to it that what follows would be, and it stays on them.
[[nodiscard]] bool steady(const Tick& tick, const Iteration& now) noexcept;
/// By about so much such a way from where was read leaves a surface along which it leads [m]. In a
/// trilinear volume slopes jump at the faces of cells: by as much as c and n differ, or as n turns
/// within half a voxel.
[[nodiscard]] double leaves(const Tick& tick, const Iteration& now, double way) noexcept;
/// Where the proxy is, once what is left is within the tolerance [m]: at the balance, if where was
/// read is that near to it, to the last digit, on which friction's threshold rests; else where
/// Newton's step leads. Where the surface is certain at neither, there where it was read.
[[nodiscard]] Vec3 answer(const Tick& tick, const Iteration& now) noexcept;

/// As far off the hand as all that was placed can hold the proxy [m].
[[nodiscard]] double reachOfStrengths(const Tick& tick) noexcept;

}  // namespace palpate
