/// Private to the program: where couplings come to rest, swing or run away, as maps over stiffness
/// and damping, a method each.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/simulated_device.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/scene.h"

namespace palpate {

/// The force on a hand, read by read [N]; remembers its proxy.
using MapFeel = std::function<Vec3(const Vec3& probe)>;

/// What a hand presses on.
struct MapContact {
  Vec3 place = Vec3::Zero();          ///< Where it touches [m].
  Vec3 outwards = Vec3::UnitZ();      ///< Against the pressing hand.
  std::vector<Primitive> primitives;  ///< As they stand there; for a whole scene: at rest there.
};

/// A wall of `strength` newtons through the origin.
[[nodiscard]] MapContact wallContact(double strength = 5.0);
/// Two planes whose normals are so many degrees apart, in a trough; the hand presses into it.
[[nodiscard]] MapContact troughContact(double degrees, double strength = 5.0);

/// A method of a map: a new hand, nothing remembered, for a stiffness [N/m] and damping [N s/m].
struct MapMethod {
  std::string name;  ///< For people, in maps and tables.
  int size = 65;     ///< Cells along an axis that its cost allows.
  /// A new hand; `period` is the time from one read to the next [s].
  std::function<MapFeel(double stiffness, double damping, double period)> make;
};

/// The engine's solver and six of the literature (devices/methods) over primitives that stand
/// still, each at the setting that it is meant to be used at.
[[nodiscard]] std::vector<MapMethod> methodsOver(const MapContact& contact);
/// The engine's whole tick in a scene, limits and all but the tank.
[[nodiscard]] MapMethod wholeTick(const std::shared_ptr<const Scene>& scene, const Vec3& start);

/// How the arm ends: by the last quarter of the time, or once it is 0.1 m from the contact.
enum class MapOutcome : std::uint8_t {
  kRests,   ///< Stands, to some steps of the encoder, or what swings dies away.
  kCycles,  ///< Swings without end, and no farther: the hand is shaken.
  kLeaves,  ///< Runs away, or swings by more than 0.02 m.
};

/// What tryCoupling has seen of one stiffness and damping.
struct MapCell {
  MapOutcome outcome = MapOutcome::kRests;  ///< Judged by `swing`.
  bool active = false;                      ///< Energy came out of the hand's port.
  double swing = 0.0;  ///< Half the diagonal of where it was in the last quarter [m].
  double force = 0.0;  ///< Mean of its size, likewise [N].
};

/// The arm, the hand and how it is tried.
struct MapSetting {
  ArmParams arm;         ///< Without its energy tank.
  GripParams grip;       ///< Its stiffness > 0: it presses with `load` by that.
  double rate = 1000.0;  ///< Of the loop [Hz].
  double load = 1.0;     ///< The hand presses with so much [N],
  double kick = 2e-5;    ///< begins so far off [m],
  double seconds = 1.0;  ///< and is looked at so long.
  double peak = 7.9;     ///< [N]
};

/// One cell: virtual time, deterministic.
[[nodiscard]] MapCell tryCoupling(const MapSetting& setting, const MapContact& contact,
                                  const MapFeel& feel);

/// Outcomes of one method over stiffness and damping, as drawMap draws them.
struct StabilityMap {
  std::string method;             ///< MapMethod::name.
  std::vector<double> stiffness;  ///< [N/m], one a column, ascending in equal ratios.
  std::vector<double> damping;    ///< [N s/m], one a row: 0, then in equal ratios.
  std::vector<MapCell> cells;     ///< Row by row.
  long tried = 0;                 ///< Cells simulated; the others lie among equals.
};

/// Coarse cells first, finer ones where neighbours differ; on all cores.
///
/// @param size      A multiple of 8 and one.
/// @param progress  Counts cells that are done; may be null.
[[nodiscard]] StabilityMap drawMap(const MapSetting& setting, const MapContact& contact,
                                   const MapMethod& method, int size, double least_stiffness,
                                   double most_stiffness, double most_damping,
                                   std::atomic<long>* progress = nullptr);

}  // namespace palpate
