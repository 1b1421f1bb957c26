/// Private to the program: maps over stiffness and damping that show where couplings settle, swing
/// or run away, one map per method.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/scene/scene.h"

namespace palpate {

/// A function that returns the force on a hand for each reading [N]. It remembers its proxy.
using MapFeel = std::function<Vec3(const Vec3& probe)>;

/// The contact that a hand presses on.
struct MapContact {
  Vec3 place = Vec3::Zero();          ///< Contact point [m].
  Vec3 outwards = Vec3::UnitZ();      ///< Direction against the pressing hand.
  std::vector<Primitive> primitives;  ///< At their places; for a whole scene: at rest there.
};

/// A wall of `strength` newtons through the origin.
[[nodiscard]] MapContact wallContact(double strength = 5.0);
/// Two planes whose normals are `degrees` apart form a trough; the hand presses into it.
[[nodiscard]] MapContact troughContact(double degrees, double strength = 5.0);

/// A method of a map. It makes a new hand without memory for a stiffness [N/m] and damping [N s/m].
struct MapMethod {
  std::string name;  ///< Name in maps and tables.
  /// Makes a new hand; `period` is the time between readings [s].
  std::function<MapFeel(double stiffness, double damping, double period)> make;
};

/// Balances primitives and returns the proxy's offset from the probe [m]. `start` is the last
/// proxy.
using MapBalance = std::function<Vec3(const Vec3& probe, double stiffness,
                                      std::span<const Primitive> primitives, const Vec3& start)>;

/// Returns a method that balances the contact's fixed primitives again for each reading.
[[nodiscard]] MapMethod wrapBalance(const MapContact& contact, const std::string& name,
                                    const MapBalance& balance);
/// Returns the engine's solver over the contact's fixed primitives.
[[nodiscard]] MapMethod solverOver(const MapContact& contact);
/// Returns the engine's whole tick in a scene, with all limits but without the tank.
[[nodiscard]] MapMethod wholeTick(const std::shared_ptr<const Scene>& scene, const Vec3& start);

/// The arm's final behaviour, judged by the last quarter of the time, or once it is 0.1 m from the
/// contact.
enum class MapOutcome : std::uint8_t {
  kRests,   ///< At rest, to some encoder steps, or the swing decays.
  kCycles,  ///< Limit cycle: keeps swinging by at most 0.02 m; the swing may still grow.
  kLeaves,  ///< Runs away, or swings by more than 0.02 m.
};

/// Result of tryCoupling for one stiffness and damping.
struct MapCell {
  MapOutcome outcome = MapOutcome::kRests;  ///< Judged by `swing`.
  bool active = false;                      ///< The hand received more energy than it gave.
  double swing = 0.0;  ///< Half the diagonal of the region visited in the last quarter [m].
  double force = 0.0;  ///< Mean force in the last quarter [N].
};

/// The arm, the hand and the test.
struct MapSetting {
  ArmParams arm;         ///< Without its energy tank.
  GripParams grip;       ///< Its stiffness is > 0: its spring applies `load`.
  double rate = 1000.0;  ///< Rate of the loop [Hz].
  double load = 1.0;     ///< Force with which the hand presses [N].
  double kick = 2e-5;    ///< Offset from the contact at the start, on two axes [m].
  double seconds = 1.0;  ///< Duration of the test [s].
  double peak = 7.9;     ///< [N]
};

/// Computes one cell: virtual time, deterministic.
[[nodiscard]] MapCell tryCoupling(const MapSetting& setting, const MapContact& contact,
                                  const MapFeel& feel);

/// Outcomes of one method over stiffness and damping, as computed by drawMap.
struct StabilityMap {
  std::string method;             ///< MapMethod::name.
  std::vector<double> stiffness;  ///< [N/m], one per column, ascending in equal ratios.
  std::vector<double> damping;    ///< [N s/m], one per row: 0, then in equal ratios.
  std::vector<MapCell> cells;     ///< Row by row.
  long tried = 0;                 ///< Cells simulated; the others lie between equal ones.
};

/// Computes coarse cells first, then finer ones where neighbours differ; on all cores.
///
/// @param size  A multiple of 8, plus one.
[[nodiscard]] StabilityMap drawMap(const MapSetting& setting, const MapContact& contact,
                                   const MapMethod& method, int size, double least_stiffness,
                                   double most_stiffness, double most_damping);

}  // namespace palpate
