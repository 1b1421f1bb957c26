/// Runs millions of hands, arms and scenes, to see whether energy comes out of the hand's port.
#pragma once

#include <cstdint>

#include "palpate/engine/safety/passivity.h"
#include "palpate/engine/types.h"

namespace palpate::bench {

/// The sources of forces. All but the plain wall can create energy by themselves.
enum class ActiveScene : std::uint8_t {
  kWall,       ///< Stiff and damped; past its stable stiffness about half of the time.
  kWaves,      ///< Force by place, also across the direction in which it changes: not a gradient.
  kUndamped,   ///< A wall with damping of the wrong sign, filtered.
  kNoise,      ///< Random by place and time.
  kMoving,     ///< A wall that moves.
  kSticky,     ///< A wall with 1.5 times the force when the hand leaves.
  kAppearing,  ///< A wall that suddenly appears.
  kWhirl,      ///< A force round an axis.
};
inline constexpr int kActiveScenes = 8;

enum class Keeper : std::uint8_t { kNobody, kObserver, kTank };

/// One hand at one arm in one scene.
struct PassivityRun {
  double mass = 0.1;        ///< [kg]
  double viscous = 0.5;     ///< [N s/m], true.
  double coulomb = 0.02;    ///< [N], true.
  double encoder = 1e-5;    ///< Step of each of three axes [m].
  double period = 1e-3;     ///< [s]
  double jitter = 0.0;      ///< Ticks come after (1 - jitter) to 1 of the period.
  double forgets = 0.0;     ///< Share of ticks in which an interruption begins that resets the
                            ///< tank, as if a switch opened, or a scene or a fault ended. The reset
                            ///< comes at once, or
  int away = 0;             ///< up to so many ticks later; until then zero is sent.
  int every = 1;            ///< A new position comes every so many ticks.
  bool tells_age = true;    ///< Other positions are reported as old.
  bool tells_doubt = true;  ///< The tank knows the doubt of the delay and the readings' jitter.
  double late = 0.0;        ///< Share of ticks that come after up to ten periods.
  double delay = 0.0;       ///< [s]
  double doubt = 0.0;       ///< The delay of each force varies by plus or minus this time [s].
  double reading_jitter = 0.0;  ///< Positions are up to twice this time old; the age varies [s].
  double lag = 0.0;             ///< [s]
  double weak = 0.0;            ///< Share of ticks in which motors give less than their command.
  bool tells_weak = true;       ///< The tank knows of the weak motors.
  double grip = 0.0;            ///< The hand's spring [N/m]; 0: the hand has let go.
  double grip_damping = 0;      ///< [N s/m]
  double release = 9.0;         ///< When the hand lets go [s].
  bool adversary = false;       ///< The hand is not a spring: it sees the next force and the
                                ///< encoder's steps, and moves to gain most energy.
  double peak = 5.0;            ///< [N]
  double known_viscous = 1.0;   ///< Share of the friction that the tank knows.
  double known_coulomb = 1.0;
  ActiveScene scene = ActiveScene::kWall;
  double stiffness = 500.0;  ///< [N/m]
  double damping = 0.0;      ///< [N s/m]
  double wave = 1000.0;      ///< [rad/m]
  double amplitude = 1.0;    ///< [N]
  double seconds = 2.0;
  std::uint64_t seed = 0;  ///< Seed of the random numbers during the run.
};

/// Returns a random run in the ranges of the design notes.
///
/// @param fractional  Delays may also be parts of a period.
[[nodiscard]] PassivityRun randomRun(std::uint64_t seed, bool fractional);

/// Gives the run an amplifier that lags by 0.03 to 3 periods.
void letLag(PassivityRun& run);
/// Gives the run a delay with a doubt of 0.03 to 3 periods; half of the runs also have amplifiers
/// that lag.
void doubtDelay(PassivityRun& run);
/// Gives the run positions that are up to a period old.
void shakeReadings(PassivityRun& run);
/// Gives the run a tank that is reset often, and positions every 1 to 8 ticks.
void forgetOften(PassivityRun& run);

struct PassivityResult {
  double least = 0.0;    ///< Lowest energy that the hand had put in, over all samples [J].
  double margin = 0.0;   ///< Lowest value of that energy + debt: below zero breaks the promise.
  double spare = 0.0;    ///< Smallest difference between that sum and the tank's energy, while the
                         ///< tank's is positive [J]; below zero breaks the promise too.
  double debt = 0.0;     ///< [J]
  double scaled = 0.0;   ///< Share of ticks in which the keeper changed the force.
  double lost = 0.0;     ///< Mean share of the force that was lost.
  double nominal = 0.0;  ///< The largest force [N].
};

/// Plays the run. The result is exact but for rounding. The arm moves along straight pieces for any
/// cause, and the work of the acting force is integrated in closed form.
[[nodiscard]] PassivityResult play(const PassivityRun& run, Keeper keeper);

/// Sums of many runs.
struct PassivityTally {
  long runs = 0;
  long active = 0;      ///< Runs in which energy came out, more than rounding,
  long large = 0;       ///< more than a millijoule,
  long broken = 0;      ///< more than the tank promises.
  long indebted = 0;    ///< Runs in which the tank could not pay for something.
  double worst = 0.0;   ///< Lowest energy [J].
  double margin = 0.0;  ///< Lowest PassivityResult::margin.
  double debt = 0.0;    ///< Largest debt [J].
  double scaled = 0.0;  ///< Sums over the runs.
  double lost = 0.0;

  void add(const PassivityResult& r);
  void add(const PassivityTally& other);
};

/// Searches for the worst run. The search starts from a random run and changes a run a little each
/// time. It continues from the run that left the tank the least to spare. Plays `plays` runs of 0.2
/// s. The search also changes delays in doubt, lag, jitter and resets of the tank.
///
/// @param at_once  Keeps delay, doubt, lag and the readings' jitter at 0: a position is then known
///                 as soon as it was read.
[[nodiscard]] PassivityTally playSearched(std::uint64_t seed, long plays, bool at_once = false);

}  // namespace palpate::bench
