/// Functions that the verbs `check`, `explain` and `press` use: they move a hand in a scene and
/// describe what each mode does.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/tick/step.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {

/// Reads "x,y,z" in metres. The numbers must be finite and below 1,000 km. Otherwise throws Error,
/// which names `option`.
[[nodiscard]] Vec3 readVector(const std::string& option, const std::string& text);

/// Returns true if p is in the box or on its faces.
[[nodiscard]] bool holds(const Box& box, const Vec3& p);

/// Returns the scene file and the files that the scene loads. Outputs must not overwrite these.
[[nodiscard]] std::vector<std::filesystem::path> inputsOf(const std::string& scene,
                                                          const SceneSpec& spec);

/// Throws Error if a coordinate exceeds the limit of hapticStep for a hand. The error names `name`:
/// an option, or the argument of a function.
void checkReach(const std::string& name, const Vec3& p);

/// Throws Error unless the rate is 10 to 100,000 ticks per second.
void checkRate(const std::string& name, double rate);

/// An open scene. Its notes were printed, and its coupling fits the device `path`.
struct Opened {
  SceneSpec spec;  ///< Description of the scene as in its file.
  /// Description of the scene that was built. If `spec` has parts, it contains only the parts near
  /// the hand, in one graph.
  SceneSpec told;
  BuiltScene built;  ///< The scene built from `told`.
};
/// Parts that were near the hand in a run.
struct Near {
  std::set<std::size_t> parts;  ///< Indices into Scene::parts.
  double missing = 0.0;         ///< Largest force of parts that did not fit in a tick [N].

  /// Adds the parts that were near the hand in the last tick.
  void add(const ProxyState& state, const StepReport& report);
};
/// Moves the caller's hand through a scene with parts, and returns the parts near the hand.
using TrialRun = std::function<Near(const BuiltScene&)>;
/// Receives messages to the user, one line each.
using Say = std::function<void(const std::string&)>;
/// Writes a message to standard error.
void complainOf(const std::string& line);
[[nodiscard]] Opened openFor(SceneSpec spec, const TrialRun& trial, const Progress& progress,
                             const Say& say);
/// Opens a scene from a file, and shows the progress on a terminal.
[[nodiscard]] Opened openFor(const std::string& scene, const TrialRun& trial);

/// Returns the modes that read a field, and the coupling if it does: the reasons why the field is
/// sampled.
[[nodiscard]] std::vector<std::string> readersOf(const Graph& graph, const FieldSet& field);

/// Returns the force limits of the device `path`, which has no motors that could limit them.
[[nodiscard]] ForceLimits pathLimits();

/// Result of restAt.
struct Rest {
  StepReport report;  ///< Report of the last tick.
  int ticks = 0;
};
/// Runs ticks with the hand at rest at `at`: one tick, so that the contacts are known. If the
/// coupling's stiffness varies, runs ticks until the stiffness is constant, for at most two
/// seconds.
[[nodiscard]] Rest restAt(const Scene& scene, Reader& reader, ProxyState& state, const Vec3& at,
                          double dt);

/// State of a primitive in a balance.
enum class Hold : std::uint8_t {
  kIdle,    ///< The primitive carries no load.
  kHolds,   ///< The primitive carries less than its strength, and the proxy stays on it.
  kYields,  ///< The primitive carries its full strength, and the proxy has left it.
  kPushes,  ///< A directed force, which always has its full strength.
};

/// Load of one primitive in the last balance of a tick.
struct Load {
  Primitive primitive;
  Vec3 force = Vec3::Zero();  ///< Force on the proxy [N].
  double known = 0.0;         ///< Uncertainty of the force [N].
  Hold hold = Hold::kIdle;
  /// True for a friction line. Its strength is mu times the load of its plane.
  bool friction = false;
  double coefficient = 0.0;  ///< Friction coefficient mu; 0 without friction.
  /// For a friction line: index of its plane among the primitives of the mode.
  std::size_t plane = 0;
};

/// Returns the load of a primitive in the last balance of a tick, with its uncertainty and its
/// state.
[[nodiscard]] Load loadOf(const Primitive& primitive, const Vec3& force, const StepReport& report);
/// Returns the loads of the primitives of mode i in the last sub-step; an empty list after a fault.
[[nodiscard]] std::vector<Load> loadsOf(const ProxyState& state, const StepReport& report,
                                        std::size_t i);
/// Returns the sum of the loads: the mode's force on the proxy [N].
[[nodiscard]] Vec3 totalOf(const std::vector<Load>& loads);
/// Returns the loads that decide whether a mode holds: those of its planes, or all loads if it has
/// no plane. Friction and the drag of a surface do not count, because they depend on the planes.
/// Two opposed planes count as one load, their sum.
[[nodiscard]] std::vector<Load> bearersOf(const std::vector<Load>& loads);
/// Returns the strongest state of these loads: kYields before kHolds. Returns kIdle if their sum is
/// zero.
[[nodiscard]] Hold holdOf(const std::vector<Load>& loads);

/// Returns "idle", "holds", "yields" or "pushes"; for friction lines "idle", "sticks" or "slips".
[[nodiscard]] const char* wordFor(Hold hold, bool friction = false);
[[nodiscard]] const char* wordFor(Side side);
[[nodiscard]] const char* wordFor(SolverKind kind);

/// Formats a number with a few digits for the user. Rounding errors become 0.
[[nodiscard]] std::string shown(double value);

}  // namespace palpate::cli
