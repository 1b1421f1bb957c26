/// Moves a hand in a scene, and describes the loads of its modes.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/tick/step.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {

/// Returns the numbers of "x,y,z"; no value if the text is not three finite numbers.
[[nodiscard]] std::optional<Vec3> numbersOf(const std::string& text);

/// Parses "x,y,z" [m]. Throws Error about `option` unless the text is three finite numbers with
/// magnitudes below 1e6 m.
[[nodiscard]] Vec3 readVector(const std::string& option, const std::string& text);

/// Returns true if p is in the box or on its faces.
[[nodiscard]] bool holds(const Box& box, const Vec3& p);

/// Returns the scene file and the files that it loads, which outputs must not overwrite.
[[nodiscard]] std::vector<std::filesystem::path> inputsOf(const std::string& scene,
                                                          const SceneSpec& spec);

/// Throws Error about `name` (an option or argument) if a coordinate [m] is not finite, or has a
/// magnitude of 1e6 m or more, which hapticStep() rejects.
void checkReach(const std::string& name, const Vec3& p);

/// Throws Error unless the rate is 10 to 100,000 Hz.
void checkRate(const std::string& name, double rate);

/// An open scene. Its notes were printed. Its coupling fits the device `path`.
struct Opened {
  SceneSpec spec;
  /// Description of `built`. If `spec` has parts, `told` contains only the parts near the hand, in
  /// one graph.
  SceneSpec told;
  BuiltScene built;
};
struct Near {
  std::set<std::size_t> parts;  ///< Indices into Scene::parts.
  double missing = 0.0;         ///< Largest StepReport::missing of the ticks [N].

  /// Adds the parts that were near the hand in a tick.
  void add(const ProxyState& state, const StepReport& report);
};
/// Moves the caller's hand through a scene with parts. Returns the parts that were near the hand.
using TrialRun = std::function<Near(const BuiltScene&)>;
/// Receives messages to the user, one line each.
using Say = std::function<void(const std::string&)>;
void complainOf(const std::string& line);
/// Reduces a scene with parts to those near the hand, in one graph. Throws Error if there are no
/// near parts, or too many for one graph.
void narrow(Opened& opened, const Near& near, SceneCache& cache, const Say& say);
/// Builds a scene that waits for its data, and passes its notes to `say`. Calls `trial` only if the
/// scene has parts. Throws Error.
[[nodiscard]] Opened openFor(SceneSpec spec, const TrialRun& trial, const Progress& progress,
                             const Say& say);
/// Opens a scene from a file, and shows the progress on a terminal.
[[nodiscard]] Opened openFor(const std::string& scene, const TrialRun& trial);

/// Returns the names of the modes, and of the coupling, that read a field.
[[nodiscard]] std::vector<std::string> readersOf(const Graph& graph, const FieldSet& field);

/// Returns the limits with which the device `path` limits forces.
[[nodiscard]] ForceLimits pathLimits();

struct Rest {
  StepReport report;
  int ticks = 0;
};
/// Runs a tick with the hand at rest at `at` [m], so that the modes find their contacts. If the
/// stiffness varies, runs further ticks until the stiffness is constant, for at most 2 s.
[[nodiscard]] Rest restAt(const Scene& scene, Reader& reader, ProxyState& state, const Vec3& at,
                          double dt);

/// State of a primitive in a balance.
enum class Hold : std::uint8_t {
  kIdle,    ///< The primitive carries no load.
  kHolds,   ///< The primitive carries less than its strength, or the proxy has stayed on it.
  kYields,  ///< The primitive carries its full strength, and the proxy leaves it.
  kPushes,  ///< A directed force, which always has its full strength.
};

struct Load {
  Primitive primitive;
  Vec3 force = Vec3::Zero();  ///< Force on the proxy [N].
  double known = 0.0;         ///< Uncertainty of the force's magnitude [N].
  Hold hold = Hold::kIdle;
  bool friction = false;     ///< A friction line: its strength is mu times its plane's load.
  double coefficient = 0.0;  ///< Friction coefficient mu; 0 without friction.
  std::size_t plane = 0;     ///< For a friction line: index of its plane in the mode.
};

[[nodiscard]] Load loadOf(const Primitive& primitive, const Vec3& force, const StepReport& report);
/// Returns the loads of mode i in the last sub-step; empty after a fault.
[[nodiscard]] std::vector<Load> loadsOf(const ProxyState& state, const StepReport& report,
                                        std::size_t i);
/// Returns the sum of the loads: the mode's force on the proxy [N].
[[nodiscard]] Vec3 totalOf(const std::vector<Load>& loads);
/// Returns the loads that decide whether a mode holds: its planes, or its other loads if it has no
/// planes. Leaves out friction and, beside planes, the drag of a surface.
[[nodiscard]] std::vector<Load> bearersOf(const std::vector<Load>& loads);
/// Returns the most severe state of bearersOf(loads); kIdle if the sum of these is zero, to within
/// its uncertainty.
[[nodiscard]] Hold holdOf(const std::vector<Load>& loads);

/// Returns "idle", "holds", "yields" or "pushes"; for friction lines "idle", "sticks" or "slips".
[[nodiscard]] const char* wordFor(Hold hold, bool friction = false);
[[nodiscard]] const char* wordFor(Side side);
[[nodiscard]] const char* wordFor(SolverKind kind);

/// Formats a number with at most four significant digits for the user. Magnitudes below 1e-12
/// become 0.
[[nodiscard]] std::string shown(double value);

}  // namespace palpate::cli
