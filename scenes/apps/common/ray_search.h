/// Searches for the contacts of a scene with probe rays: straight paths of a probe.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "palpate/engine/tick/step.h"

namespace palpate::cli {

inline constexpr double kHardestPress = 5.0;   ///< Largest force with which the hand presses [N].
inline constexpr double kLeastContact = 0.02;  ///< Smallest force that counts as a contact [N].
inline constexpr double kClearance =
    8e-3;  ///< Distance between a visit's start and the contact [m].

/// A probe that forces do not deflect, with the force of each mode on the probe. Parts whose lists
/// of mode names are equal share the entries of forces().
class SearchProbe {
 public:
  /// The scene has to outlive the probe.
  explicit SearchProbe(const Scene& scene);

  /// Ends all contacts, and clears a fault: the next touch() begins with the proxy at the probe.
  void lift();
  /// Runs a tick with the probe at `at` [m]. If dt [s] is 0, the scene's time stands still.
  void touch(const Vec3& at, double dt);

  [[nodiscard]] double time() const { return state_.time(); }
  /// Returns the force on the probe in the last tick [N].
  [[nodiscard]] const Vec3& force() const { return report_.wanted; }
  /// Returns the stiffness of the coupling in the last tick [N/m].
  [[nodiscard]] double stiffness() const { return report_.stiffness; }
  /// Returns the force of each mode on the probe [N]; their sum is force() without damping.
  [[nodiscard]] const std::vector<Vec3>& forces() const { return forces_; }
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

/// The region that the hand may use: the scene and a small margin, within the arm's workspace.
struct HandRange {
  Box box;              ///< Box around the scene and the margin [m].
  double radius = 0.0;  ///< Radius of the sphere about the origin of W, a little inside the
                        ///< workspace [m].

  /// Returns the interval of t in which the line p + t u, with a unit vector u, lies in the range.
  /// The interval is empty if first >= second.
  [[nodiscard]] std::pair<double, double> part(const Vec3& p, const Vec3& u) const;
};

/// Returns the range in a scene with the given bounds [m], within `radius` of the origin of W [m].
/// If the scene lies outside the cube around the workspace, the range is the workspace.
[[nodiscard]] HandRange handRangeOf(const Scene& scene, const Box& bounds, double radius);

struct ProbeRay {
  Vec3 from = Vec3::Zero();    ///< Start of the ray in W [m].
  Vec3 along = Vec3::UnitX();  ///< Direction of the ray; a unit vector.
  double length = 0.0;       ///< Length [m]; the ray ends if `hardest` would exceed kHardestPress.
  std::vector<float> held;   ///< Largest force of each mode against the probe's direction [N].
  std::vector<float> depth;  ///< Distance from the start to each mode's largest force [m].
  double hardest = 0.0;      ///< Largest total force against the probe's direction [N].

  [[nodiscard]] Vec3 at(double t) const { return from + t * along; }
};

/// Results of the search at one time of the scene.
class RaySearch {
 public:
  /// Searches at `time` [s]. `share`, in (0, 1], scales the limits of rays and readings.
  RaySearch(const Scene& scene, const HandRange& within, double time, double share);

  std::vector<ProbeRay> rays;  ///< Rays on which a force opposed the probe (kLeastContact).
  std::vector<double> top;     ///< Largest value of ProbeRay::held of each mode [N].
  int rays_cast = 0;           ///< Number of rays tried, also those without contact or outside the
                               ///< range.
  long reads = 0;              ///< Number of field readings.
};

}  // namespace palpate::cli
