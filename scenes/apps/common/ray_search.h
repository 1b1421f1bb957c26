/// Searches for the contacts of a scene with probe rays: straight paths of a probe.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "palpate/engine/tick/step.h"

namespace palpate::cli {

inline constexpr double kHardestPress = 5.0;   ///< Largest force with which the hand presses [N].
inline constexpr double kLeastContact = 0.02;  ///< Smallest force that counts as a contact [N].
/// Distance before the first contact at which a visit begins and ends [m].
inline constexpr double kClearance = 8e-3;

/// A probe that forces do not deflect, and the force of each mode on it. Modes of parts count as
/// one mode if they have equal names.
class SearchProbe {
 public:
  /// The scene has to outlive the probe.
  explicit SearchProbe(const Scene& scene);

  /// Moves the probe away from all fields. The probe then has no contacts.
  void lift();
  /// Evaluates a tick with the probe at a position. If dt is 0, the scene's time does not advance.
  void touch(const Vec3& at, double dt);

  [[nodiscard]] double time() const { return state_.time(); }
  /// Returns the force on the probe in the last tick [N].
  [[nodiscard]] const Vec3& force() const { return report_.wanted; }
  /// Returns the coupling's stiffness in the last tick [N/m].
  [[nodiscard]] double stiffness() const { return report_.stiffness; }
  /// Returns the force of each mode on the probe [N]. Their sum is the probe's force without
  /// damping.
  [[nodiscard]] const std::vector<Vec3>& forces() const { return forces_; }
  /// Returns the number of readings of fields so far.
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

/// The space that the hand may use: the scene with a small margin, within the arm's workspace.
struct HandRange {
  Box box;              ///< Box about the scene and the margin [m].
  double radius = 0.0;  ///< Radius of the workspace about the origin of W [m].

  /// Returns the interval of t in which the line p + t u lies in the range; u is a unit vector. The
  /// interval is empty if first >= second.
  [[nodiscard]] std::pair<double, double> part(const Vec3& p, const Vec3& u) const;
};

/// Returns the range of a hand in a scene. If the scene lies outside the workspace, the range is
/// the workspace.
/// @param bounds  Box about the scene [m].
/// @param radius  Radius of the arm's workspace [m].
[[nodiscard]] HandRange handRangeOf(const Scene& scene, const Box& bounds, double radius);

/// A straight path of the probe, and the modes that acted on the probe.
struct ProbeRay {
  Vec3 from = Vec3::Zero();    ///< Start of the path [m].
  Vec3 along = Vec3::UnitX();  ///< Direction, a unit vector.
  /// Length up to the point at which the force would exceed kHardestPress [m].
  double length = 0.0;
  std::vector<float> held;  ///< Largest force of each mode against the probe's direction [N].
  /// Distance from the start at which this force occurs, for each mode [m].
  std::vector<float> depth;
  double hardest = 0.0;  ///< Largest total force against the probe's direction [N].

  /// Returns the position at a distance t from the start [m].
  [[nodiscard]] Vec3 at(double t) const { return from + t * along; }
};

/// Results of the search at one time of the scene.
class RaySearch {
 public:
  /// Searches until each mode acted on enough rays, or until a limit is reached.
  /// @param time   Time of the scene [s].
  /// @param share  Share of both limits that this search may use, in (0, 1].
  RaySearch(const Scene& scene, const HandRange& within, double time, double share);

  std::vector<ProbeRay> rays;  ///< Rays on which a mode acted.
  std::vector<double> top;     ///< Largest force of each mode on any ray [N].
  int rays_cast = 0;           ///< Number of all rays, with those on which no mode acted.
  long reads = 0;              ///< Readings of fields.
};

}  // namespace palpate::cli
