/// Simulates random combinations of hand, arm and scene, and measures the energy that the hand
/// gains at its port.
#pragma once

#include <cstdint>

#include "palpate/engine/safety/passivity.h"
#include "palpate/engine/types.h"

namespace palpate::bench {

/// Sources of force. All except the wall can create energy even without sampling and delay.
enum class ActiveScene : std::uint8_t {
  kWall,  ///< A wall with damping. Sampling and delay make it create energy if it is too stiff.
  /// A force that depends on the position and is not a gradient field.
  kWaves,
  /// A wall, and everywhere a force along the low-passed velocity normal to the wall.
  kUndamped,
  kNoise,      ///< A force that is random in position and time.
  kMoving,     ///< A moving wall.
  kSticky,     ///< A wall whose force is 1.5 times as large while the hand moves out.
  kAppearing,  ///< A wall that appears suddenly.
  kWhirl,      ///< A force that circulates about an axis.
};
inline constexpr int kActiveScenes = 8;

enum class Keeper : std::uint8_t { kNobody, kObserver, kTank };

/// A hand on an arm in a scene.
struct PassivityRun {
  double mass = 0.1;      ///< [kg]
  double viscous = 0.5;   ///< True viscous friction [N s/m].
  double coulomb = 0.02;  ///< True Coulomb friction [N].
  double encoder = 1e-5;  ///< Encoder step along each of three axes [m].
  double period = 1e-3;   ///< [s]
  /// The time between two ticks is (1 - jitter) to 1 times the period, except for `late` ticks.
  double jitter = 0.0;
  /// Probability in each tick that an interruption begins, such as an open switch, a scene's end or
  /// a fault. The tank is reset in each of its ticks, and in the tick after it.
  double forgets = 0.0;
  int away = 0;           ///< Longest interruption [ticks]. During it, zero is sent.
  int every = 1;          ///< A new position arrives in every n-th tick.
  bool tells_age = true;  ///< True: in the other ticks the position is reported as old.
  /// True: the tank knows the delay's uncertainty and the readings' jitter.
  bool tells_doubt = true;
  double late = 0.0;            ///< Share of ticks that take 1 to 10 periods, at random.
  double delay = 0.0;           ///< Mean delay of forces [s].
  double doubt = 0.0;           ///< Each force's delay deviates by up to this time [s].
  double reading_jitter = 0.0;  ///< Positions are up to twice this time old, at random [s].
  double lag = 0.0;             ///< Time constant of the amplifiers [s].
  /// Share of ticks in which the motors apply less than the sent force.
  double weak = 0.0;
  bool tells_weak = true;   ///< True: the tank learns the share that the motors apply.
  double grip = 0.0;        ///< Stiffness of the hand [N/m]; 0: released.
  double grip_damping = 0;  ///< [N s/m]
  double release = 9.0;     ///< Time at which the hand lets go [s].
  /// True: the hand is not a spring. This hand knows the next force and the encoder steps, and
  /// chooses at random among motions that gain much energy.
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
  std::uint64_t seed = 0;  ///< Seed of the random numbers drawn during the run.
};

/// Returns a run with random parameters. The same seed gives the same run.
/// @param fractional  True: delays can be fractions of a period.
[[nodiscard]] PassivityRun randomRun(std::uint64_t seed, bool fractional);

/// Sets an amplifier lag of 0.03 to 3 periods.
void letLag(PassivityRun& run);
/// Sets a delay uncertainty of 0.03 to 3 periods, and a mean delay of at least that. Half of the
/// seeds also get a lag of 0.2 periods.
void doubtDelay(PassivityRun& run);
/// Sets positions that are late at random, by up to 0.03 to 1 period.
void shakeReadings(PassivityRun& run);
/// Sets frequent resets of the tank, and a new position only in every n-th tick (n from 1 to 8).
void forgetOften(PassivityRun& run);

struct PassivityResult {
  double least = 0.0;  ///< Smallest energy that the hand has put in, over all samples [J].
  /// Smallest sum of the hand's energy and the tank's debt [J]. Negative: the tank broke its
  /// guarantee.
  double margin = 0.0;
  /// Smallest difference of that sum and the tank's energy, while the tank's energy is positive
  /// [J]. Negative: the tank broke its guarantee. Infinity: the tank's energy was never positive.
  double spare = 0.0;
  double debt = 0.0;    ///< Debt of the tank at the end [J].
  double scaled = 0.0;  ///< Share of ticks in which the sent force is not the scene's force.
  /// Sum of the differences between the sent and the scene's forces, as a share of the sum of the
  /// scene's forces.
  double lost = 0.0;
  double nominal = 0.0;  ///< Largest sent force [N].
};

/// Simulates a run. Ends it early if the hand is 10 m away. The energies are exact except for
/// rounding: the arm moves along straight pieces, and the work of the force is integrated in closed
/// form.
[[nodiscard]] PassivityResult play(const PassivityRun& run, Keeper keeper);

/// Sums over many runs.
struct PassivityTally {
  long runs = 0;
  long active = 0;      ///< Number of runs in which the hand gained energy beyond rounding.
  long large = 0;       ///< Number of runs in which the hand gained more than 1 mJ.
  long broken = 0;      ///< Number of runs in which the tank broke its guarantee.
  long indebted = 0;    ///< Number of runs in which the tank went into debt.
  double worst = 0.0;   ///< Lowest energy [J].
  double margin = 0.0;  ///< Lowest PassivityResult::margin.
  double debt = 0.0;    ///< Largest debt [J].
  double scaled = 0.0;  ///< Sum of PassivityResult::scaled.
  double lost = 0.0;    ///< Sum of PassivityResult::lost.

  void add(const PassivityResult& r);
  void add(const PassivityTally& other);
};

/// Searches for the worst run. Starts with a random run, and changes at random the run with the
/// least spare energy so far, relative to what its peak force can extract in a tick. Simulates
/// `plays` runs of 0.2 s. The changes include delay uncertainty, lag, jitter and resets.
///
/// @param at_once  True: delay, uncertainty, lag and jitter of readings are 0.
[[nodiscard]] PassivityTally playSearched(std::uint64_t seed, long plays, bool at_once = false);

}  // namespace palpate::bench
