/// Hands, arms and scenes by the million, to see whether energy comes out of the hand's port.
#pragma once

#include <cstdint>

#include "palpate/engine/passivity.h"
#include "palpate/engine/types.h"

namespace palpate::bench {

/// What forces come from. All but the plain wall can give energy by themselves.
enum class ActiveScene : std::uint8_t {
  kWall,       ///< Stiff and damped; past its stable stiffness as often as not.
  kWaves,      ///< Force by place, across the way that it changes: not the gradient of anything.
  kUndamped,   ///< A wall with damping of the wrong sign, filtered.
  kNoise,      ///< By place and time at random.
  kMoving,     ///< A wall that moves.
  kSticky,     ///< A wall that gives half as much again when it is left.
  kAppearing,  ///< One that is suddenly there.
  kWhirl,      ///< A force round an axis.
};
inline constexpr int kActiveScenes = 8;

enum class Keeper : std::uint8_t { kNobody, kObserver, kTank };

/// One hand at one arm in one scene.
struct PassivityRun {
  double mass = 0.1;        ///< [kg]
  double viscous = 0.5;     ///< [N s/m], true.
  double coulomb = 0.02;    ///< [N], true.
  double encoder = 1e-5;    ///< Of each of three axes [m].
  double period = 1e-3;     ///< [s]
  double jitter = 0.0;      ///< Ticks come after (1 - jitter) to 1 of the period.
  double forgets = 0.0;     ///< Share of ticks from which on the tank is to begin anew, as if a
                            ///< switch opened, or a scene or a fault went: at once, or
  int away = 0;             ///< up to so many ticks later; meanwhile zero is sent.
  int every = 1;            ///< A new position comes every so many ticks,
  bool tells_age = true;    ///< and the others are said to be old.
  bool tells_doubt = true;  ///< The tank is told the delay's doubt, and the readings' jitter.
  double late = 0.0;        ///< Share of ticks that come after up to ten periods.
  double delay = 0.0;       ///< [s]
  double doubt = 0.0;       ///< Every force is late by another time: the delay, give or take [s].
  double reading_jitter = 0.0;  ///< Positions are up to twice so old, each by another time [s].
  double lag = 0.0;             ///< [s]
  double weak = 0.0;           ///< Share of ticks in which the motors give less than they are told,
  bool tells_weak = true;      ///< which the tank is told.
  double grip = 0.0;           ///< The hand's spring [N/m]; 0: it has let go.
  double grip_damping = 0;     ///< [N s/m]
  double release = 9.0;        ///< When it lets go [s].
  bool adversary = false;      ///< The hand is no spring: it sees the next force and the encoder's
                               ///< steps, and goes where that gives most.
  double peak = 5.0;           ///< [N]
  double known_viscous = 1.0;  ///< Share that is known.
  double known_coulomb = 1.0;
  ActiveScene scene = ActiveScene::kWall;
  double stiffness = 500.0;  ///< [N/m]
  double damping = 0.0;      ///< [N s/m]
  double wave = 1000.0;      ///< [rad/m]
  double amplitude = 1.0;    ///< [N]
  double seconds = 2.0;
  std::uint64_t seed = 0;  ///< Of what is drawn on the way.
};

/// A run at random: the ranges of the design notes.
///
/// @param fractional  Delays may be parts of a period as well.
[[nodiscard]] PassivityRun randomRun(std::uint64_t seed, bool fractional);

/// Amplifiers that lag by a thirtieth of a period to three.
void letLag(PassivityRun& run);
/// Delays that are off by a thirtieth of a period to three, half of them with amplifiers that lag.
void doubtDelay(PassivityRun& run);
/// Positions that are up to a period old.
void shakeReadings(PassivityRun& run);
/// Tanks that begin anew again and again, with positions every 1 to 8 ticks.
void forgetOften(PassivityRun& run);

struct PassivityResult {
  double least = 0.0;    ///< The lowest energy that the hand had put in, over all samples [J].
  double margin = 0.0;   ///< The lowest of that + debt: below zero breaks the promise.
  double spare = 0.0;    ///< By so much at least the tank says less than that, where it says
                         ///< something [J]; below zero breaks the promise too.
  double debt = 0.0;     ///< [J]
  double scaled = 0.0;   ///< Share of ticks in which the keeper changed the force.
  double lost = 0.0;     ///< Of the force, mean.
  double nominal = 0.0;  ///< The largest force [N].
};

/// Runs it. Exact but for rounding: the arm moves along straight pieces, whatever made it move, and
/// the work of the force that acts is integrated in closed form.
[[nodiscard]] PassivityResult play(const PassivityRun& run, Keeper keeper);

/// Many of them.
struct PassivityTally {
  long runs = 0;
  long active = 0;      ///< Energy came out, more than rounding,
  long large = 0;       ///< more than a millijoule,
  long broken = 0;      ///< more than the tank promises.
  long indebted = 0;    ///< The tank could not pay for something.
  double worst = 0.0;   ///< The lowest energy [J],
  double margin = 0.0;  ///< and PassivityResult::margin.
  double debt = 0.0;    ///< [J], the most.
  double scaled = 0.0;  ///< Sums of what runs say.
  double lost = 0.0;

  void add(const PassivityResult& r);
  void add(const PassivityTally& other);
};

/// Runs that look for their own worst: one at random, changed a little again and again, goes on
/// from what left the tank least to spare; so many plays of a fifth of a second. Delays in doubt,
/// lag, jitter and forgetting are among what is changed.
[[nodiscard]] PassivityTally playSearched(std::uint64_t seed, long plays);

}  // namespace palpate::bench
