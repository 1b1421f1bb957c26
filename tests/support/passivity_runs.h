/// Simulates millions of hands, arms and scenes, and checks whether a hand gains energy at its
/// port.
#pragma once

#include <cstdint>

#include "palpate/engine/safety/passivity.h"
#include "palpate/engine/types.h"

namespace palpate::bench {

/// The sources of forces. All but the plain wall can create energy by themselves.
enum class ActiveScene : std::uint8_t {
  kWall,  ///< Stiff and damped; in about half of the runs stiffer than the stability limit.
  /// The force depends on the place. It also has a component perpendicular to its direction of
  /// change, so it is not a gradient.
  kWaves,
  kUndamped,   ///< A wall with damping of the wrong sign, filtered.
  kNoise,      ///< Random by place and time.
  kMoving,     ///< A moving wall.
  kSticky,     ///< A wall whose force is 1.5 times larger while the hand leaves.
  kAppearing,  ///< A wall that suddenly appears.
  kWhirl,      ///< A force that circles an axis.
};
inline constexpr int kActiveScenes = 8;

enum class Keeper : std::uint8_t { kNobody, kObserver, kTank };

/// One hand on one arm in one scene.
struct PassivityRun {
  double mass = 0.1;      ///< [kg]
  double viscous = 0.5;   ///< [N s/m], true.
  double coulomb = 0.02;  ///< [N], true.
  double encoder = 1e-5;  ///< Encoder step along each of three axes [m].
  double period = 1e-3;   ///< [s]
  double jitter = 0.0;    ///< The time between two ticks is (1 - jitter) to 1 of the period.
  /// Share of ticks in which an interruption of the force begins, such as an opened switch, or the
  /// end of a scene or fault. The interruption resets the tank, at most `away` ticks later.
  double forgets = 0.0;
  int away = 0;           ///< Largest number of ticks until the reset; until then, zero is sent.
  int every = 1;          ///< A new position comes once in this number of ticks.
  bool tells_age = true;  ///< In all other ticks, the position is reported as old.
  /// The tank knows the uncertainty of the delay and the jitter of the readings.
  bool tells_doubt = true;
  double late = 0.0;            ///< Share of ticks that come late, by up to ten periods.
  double delay = 0.0;           ///< [s]
  double doubt = 0.0;           ///< The delay of each force varies by plus or minus this time [s].
  double reading_jitter = 0.0;  ///< Positions have a varying age of up to twice this time [s].
  double lag = 0.0;             ///< [s]
  /// Share of ticks in which the motors give less than the sent force.
  double weak = 0.0;
  bool tells_weak = true;   ///< True if the tank gets the share that the motors give.
  double grip = 0.0;        ///< Stiffness of the hand [N/m]; 0: the arm is released.
  double grip_damping = 0;  ///< [N s/m]
  double release = 9.0;     ///< Time at which the hand lets go [s].
  /// The hand is not a spring: it knows the next force and the encoder's steps, and moves so that
  /// it gains the most energy.
  bool adversary = false;
  double peak = 5.0;           ///< [N]
  double known_viscous = 1.0;  ///< Share of the true friction that the tank knows.
  double known_coulomb = 1.0;
  ActiveScene scene = ActiveScene::kWall;
  double stiffness = 500.0;  ///< [N/m]
  double damping = 0.0;      ///< [N s/m]
  double wave = 1000.0;      ///< [rad/m]
  double amplitude = 1.0;    ///< [N]
  double seconds = 2.0;
  std::uint64_t seed = 0;  ///< Seed of the random numbers during the run.
};

/// Returns a random run within the ranges of the design notes.
///
/// @param fractional  Delays may also be fractions of a period.
[[nodiscard]] PassivityRun randomRun(std::uint64_t seed, bool fractional);

/// Gives the run an amplifier whose lag is 0.03 to 3 periods.
void letLag(PassivityRun& run);
/// Gives the run a delay that is uncertain by plus or minus 0.03 to 3 periods. In half of the runs
/// the amplifiers also lag by 0.2 periods.
void doubtDelay(PassivityRun& run);
/// Gives the run positions that are up to a period old.
void shakeReadings(PassivityRun& run);
/// Gives the run a tank that is reset often, and new positions only every 1 to 8 ticks.
void forgetOften(PassivityRun& run);

struct PassivityResult {
  double least = 0.0;  ///< Smallest energy that the hand had put in, over all samples [J].
  /// Smallest sum of that energy and the debt [J]; below zero the tank's promise is broken.
  double margin = 0.0;
  /// Smallest difference between that sum and the tank's energy, while the latter is positive [J].
  /// Below zero the promise is broken too.
  double spare = 0.0;
  double debt = 0.0;     ///< [J]
  double scaled = 0.0;   ///< Share of ticks in which the controller changed the force.
  double lost = 0.0;     ///< Mean share of the force that the controller removed.
  double nominal = 0.0;  ///< Largest force [N].
};

/// Simulates the run. The result is exact except for rounding. The arm always moves along straight
/// pieces, and the work of the acting force is integrated in closed form.
[[nodiscard]] PassivityResult play(const PassivityRun& run, Keeper keeper);

/// Sums of many runs.
struct PassivityTally {
  long runs = 0;
  long active = 0;      ///< Number of runs in which more energy came out than rounding explains.
  long large = 0;       ///< Number of runs in which more than a millijoule came out.
  long broken = 0;      ///< Number of runs in which more energy came out than the tank promises.
  long indebted = 0;    ///< Number of runs in which the tank had less energy than it needed.
  double worst = 0.0;   ///< Lowest energy [J].
  double margin = 0.0;  ///< Lowest PassivityResult::margin.
  double debt = 0.0;    ///< Largest debt [J].
  double scaled = 0.0;  ///< Sum over all runs of PassivityResult::scaled.
  double lost = 0.0;    ///< Sum over all runs of PassivityResult::lost.

  void add(const PassivityResult& r);
  void add(const PassivityTally& other);
};

/// Searches for the worst run. The search starts from a random run and changes it in each
/// step, from the run in which the tank had the least to spare. Simulates `plays` runs of 0.2 s.
/// The search also changes the delay's uncertainty, lag, jitter and resets of the tank.
///
/// @param at_once  Keeps delay, doubt, lag and the readings' jitter at 0: a position is then known
///                 as soon as it was read.
[[nodiscard]] PassivityTally playSearched(std::uint64_t seed, long plays, bool at_once = false);

}  // namespace palpate::bench
