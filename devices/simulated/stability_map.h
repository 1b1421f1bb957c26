/// Private to palpate's programs: draws maps of the couplings with which an arm rests, oscillates
/// or diverges, for each method.
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

/// Returns the force [N] on a hand at `probe` [m]. Keeps its proxy from call to call.
using MapFeel = std::function<Vec3(const Vec3& probe)>;

/// The contact that a hand presses on.
struct MapContact {
  Vec3 place = Vec3::Zero();      ///< Contact point [m].
  Vec3 outwards = Vec3::UnitZ();  ///< Direction in which the contact pushes the hand.
  /// Primitives at rest at the contact; for a scene, those of one of its contacts.
  std::vector<Primitive> primitives;
};

/// Returns a wall of `strength` [N] through the origin.
[[nodiscard]] MapContact wallContact(double strength = 5.0);
/// Returns a trough: two planes with `degrees` between their normals. The hand presses into it.
[[nodiscard]] MapContact troughContact(double degrees, double strength = 5.0);

/// A method for which maps are drawn.
struct MapMethod {
  std::string name;  ///< Name in maps and tables.
  /// Makes a hand without history for a stiffness [N/m], a damping [N s/m] and a period [s].
  std::function<MapFeel(double stiffness, double damping, double period)> make;
};

/// Balances primitives; returns the proxy's offset from the probe [m]. `start`: last proxy.
using MapBalance = std::function<Vec3(const Vec3& probe, double stiffness,
                                      std::span<const Primitive> primitives, const Vec3& start)>;

/// Returns a method that balances the contact's fixed primitives again for each reading.
[[nodiscard]] MapMethod wrapBalance(const MapContact& contact, const std::string& name,
                                    const MapBalance& balance);
/// Returns a method that runs the engine's solver on the contact's fixed primitives.
[[nodiscard]] MapMethod solverOver(const MapContact& contact);
/// Returns a method that runs the engine's whole tick in a scene. Its force is StepReport::wanted,
/// before the limits of limitForce. The hand is at `start` [m] in the first tick.
[[nodiscard]] MapMethod wholeTick(const std::shared_ptr<const Scene>& scene, const Vec3& start);

/// Final behaviour, judged in the last quarter of the time, or as soon as the arm has run away: it
/// is then more than 0.1 m from MapContact::place.
enum class MapOutcome : std::uint8_t {
  /// MapCell::swing is at most 2.5 encoder steps (of at least 0.1 um), or the oscillation decays.
  kRests,
  /// The arm keeps oscillating by at most 0.02 m. The oscillation may still be growing.
  kCycles,
  kLeaves,  ///< The arm diverges: it oscillates by more than 0.02 m, or has run away.
};

/// Result of tryCoupling for one stiffness and damping.
struct MapCell {
  MapOutcome outcome = MapOutcome::kRests;  ///< Judged by `swing`.
  bool active = false;                      ///< At some time, the hand had gained more than 1e-5 J.
  /// Half the diagonal of the box that contains the positions of the last quarter [m]. If the arm
  /// ran away, its distance from MapContact::place.
  double swing = 0.0;
  double force = 0.0;  ///< Mean force in the last quarter [N]; 0 if the arm ran away.
};

/// Parameters of the arm, the hand and the test.
struct MapSetting {
  ArmParams arm;         ///< Parameters of the arm; its energy tank is ignored.
  GripParams grip;       ///< Stiffness > 0, because the hand's spring applies `load`.
  double rate = 1000.0;  ///< Rate of the loop [Hz].
  double load = 1.0;     ///< Force with which the hand presses [N].
  double kick = 2e-5;    ///< Offset at the start along MapContact::outwards and across it [m].
  double seconds = 1.0;  ///< Duration of the test [s].
  double peak = 7.9;     ///< Largest force of the arm [N].
};

/// Simulates one cell, in virtual time. Deterministic.
[[nodiscard]] MapCell tryCoupling(const MapSetting& setting, const MapContact& contact,
                                  const MapFeel& feel);

/// Outcomes of one method over stiffness and damping; a result of drawMap.
struct StabilityMap {
  std::string method;             ///< MapMethod::name.
  std::vector<double> stiffness;  ///< [N/m], one per column, ascending with a constant ratio.
  /// [N s/m], one per row: 0, then ascending with a constant ratio.
  std::vector<double> damping;
  std::vector<MapCell> cells;  ///< Row by row.
  /// Number of simulated cells. The other cells lie between cells with equal outcomes.
  long tried = 0;
};

/// Computes coarse cells first, then finer cells where neighbours differ, on all cores.
///
/// @param size  Cells per side: a multiple of 8, plus 1. Stiffnesses in N/m, damping in N s/m.
[[nodiscard]] StabilityMap drawMap(const MapSetting& setting, const MapContact& contact,
                                   const MapMethod& method, int size, double least_stiffness,
                                   double most_stiffness, double most_damping);

}  // namespace palpate
