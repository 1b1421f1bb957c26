/// Search for the contacts of a scene, by probe rays: straight paths of a probe.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "palpate/engine/tick/step.h"

namespace palpate::cli {

inline constexpr double kHardestPress =
    5.0;  ///< Limit of the force with which the hand presses [N].
inline constexpr double kLeastContact = 0.02;  ///< Smaller forces are not contacts [N].
inline constexpr double kClearance = 8e-3;  ///< Distance before the contact at start and end [m].

/// A probe that moves exactly to given places, and the force of each mode on it there. Modes of
/// parts with equal names count as one.
class SearchProbe {
 public:
  /// The scene has to outlive the probe.
  explicit SearchProbe(const Scene& scene);

  /// Moves the probe away from everything, without memory of contacts.
  void lift();
  /// Evaluates a tick at a place; with dt = 0 the scene's time stands still.
  void touch(const Vec3& at, double dt);

  [[nodiscard]] double time() const { return state_.time(); }
  /// Returns the force on the probe [N].
  [[nodiscard]] const Vec3& force() const { return report_.wanted; }
  /// Returns the coupling's stiffness at the last place [N/m].
  [[nodiscard]] double stiffness() const { return report_.stiffness; }
  /// Returns the force of each mode [N]; their sum is the force without the coupling's damping.
  [[nodiscard]] const std::vector<Vec3>& forces() const { return forces_; }
  /// Returns the number of reads of fields so far.
  [[nodiscard]] long reads() const { return reads_; }

 private:
  void add(std::size_t mode, const ModeMemory& memory, std::size_t& next);

  const Scene& scene_;
  Reader reader_;
  ProxyState state_;
  StepReport report_;
  std::vector<std::size_t> first_of_part_;
  std::vector<Vec3> forces_;
  long reads_ = 0;
};

/// Range of the hand: the scene with a small margin, within the arm's workspace.
struct HandRange {
  Box box;              ///< [m]
  double radius = 0.0;  ///< Radius of the workspace about the origin of W [m].

  /// Returns the part of a line, p + t u with unit u, that lies in the range: empty if first >=
  /// second.
  [[nodiscard]] std::pair<double, double> part(const Vec3& p, const Vec3& u) const;
};

/// Returns the range of a hand in a scene. If the scene is out of the workspace, the range is the
/// workspace.
/// @param bounds  Box about the scene [m].
/// @param radius  Radius of the arm's workspace [m].
[[nodiscard]] HandRange handRangeOf(const Scene& scene, const Box& bounds, double radius);

/// A straight path of the probe, and the modes that acted against it.
struct ProbeRay {
  Vec3 from = Vec3::Zero();    ///< Start [m].
  Vec3 along = Vec3::UnitX();  ///< Direction, a unit vector.
  double length = 0.0;         ///< Up to the place where the probe would press too hard [m].
  std::vector<float> held;     ///< Largest force of each mode against the probe [N].
  std::vector<float> depth;    ///< Place of each mode's largest force [m].
  double hardest = 0.0;        ///< Largest sum of the forces [N].

  /// Returns the place at a distance from the start [m].
  [[nodiscard]] Vec3 at(double t) const { return from + t * along; }
};

/// All findings of the search at one time of the scene.
class RaySearch {
 public:
  /// Casts rays until each mode acted on enough of them, or a limit is reached.
  /// @param time   Time of the scene [s].
  /// @param share  Share of the limits that this search may use, in (0, 1].
  RaySearch(const Scene& scene, const HandRange& within, double time, double share);

  std::vector<ProbeRay> rays;  ///< Rays on which a mode acted.
  std::vector<double> top;     ///< Largest force of each mode on any ray [N].
  int rays_cast = 0;           ///< Number of all rays.
  long reads = 0;              ///< Reads of fields.
};

}  // namespace palpate::cli
