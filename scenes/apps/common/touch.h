/// Functions that check, explain and press share: they put a separate hand into a scene and
/// describe the action of each mode.
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

/// Reads "x,y,z" in metres, finite and within 1,000 km; else throws Error that names the option.
[[nodiscard]] Vec3 readVector(const std::string& option, const std::string& text);

/// Returns true if p is in the box, faces included.
[[nodiscard]] bool holds(const Box& box, const Vec3& p);

/// Returns the scene and the files that it loads: outputs must not overwrite these.
[[nodiscard]] std::vector<std::filesystem::path> inputsOf(const std::string& scene,
                                                          const SceneSpec& spec);

/// Throws Error if a place is farther than a tick accepts for a hand. `name` is the caller's
/// option, or the argument of a function.
void checkReach(const std::string& name, const Vec3& p);

/// Throws Error unless the rate is 10 to 100000 ticks per second.
void checkRate(const std::string& name, double rate);

/// An open scene: its notes were reported, and a `path` device would accept it.
struct Opened {
  SceneSpec spec;    ///< Contents of its file.
  SceneSpec told;    ///< One graph: if `spec` has parts, only those near the hand.
  BuiltScene built;  ///< From `told`.
};
/// Parts that a hand came near.
struct Near {
  std::set<std::size_t> parts;  ///< Indices into Scene::parts.
  double missing = 0.0;         ///< Force of parts that had no room [N].

  /// Adds the parts that the last tick chose.
  void add(const ProxyState& state, const StepReport& report);
};
/// Moves the caller's hand in a scene of parts.
using TrialRun = std::function<Near(const BuiltScene&)>;
/// Receives messages for the user, one line each.
using Say = std::function<void(const std::string&)>;
/// Writes to stderr.
void complainOf(const std::string& line);
[[nodiscard]] Opened openFor(SceneSpec spec, const TrialRun& trial, const Progress& progress,
                             const Say& say);
/// Opens a scene from a file, with progress on a terminal.
[[nodiscard]] Opened openFor(const std::string& scene, const TrialRun& trial);

/// Returns the readers of a field, modes and the coupling: the reasons why it is sampled.
[[nodiscard]] std::vector<std::string> readersOf(const Graph& graph, const FieldSet& field);

/// Returns the limits of the device `path`: no hand yields, so no hardware limits it.
[[nodiscard]] ForceLimits pathLimits();

/// Result of restAt.
struct Rest {
  StepReport report;  ///< Report of the last tick.
  int ticks = 0;
};
/// Puts the hand at `at`, where it rests: for one tick, so that contacts are known. If the
/// stiffness varies, as many more ticks follow as it takes to settle, two seconds at most.
[[nodiscard]] Rest restAt(const Scene& scene, Reader& reader, ProxyState& state, const Vec3& at,
                          double dt);

/// State of a primitive in a balance.
enum class Hold : std::uint8_t {
  kIdle,    ///< Carries no load.
  kHolds,   ///< Carries less than its strength: the proxy stays on it.
  kYields,  ///< Carries its strength: the proxy was pulled off it.
  kPushes,  ///< A directed force: always at its strength.
};

/// Load of one primitive in the last balance.
struct Load {
  Primitive primitive;
  Vec3 force = Vec3::Zero();  ///< Force on the proxy [N].
  double known = 0.0;         ///< Uncertainty of the force [N].
  Hold hold = Hold::kIdle;
  bool friction = false;     ///< A line of friction, whose strength is mu times its plane's load.
  double coefficient = 0.0;  ///< mu, of friction.
  std::size_t plane = 0;     ///< For friction: its plane's index among the mode's primitives.
};

/// Returns the load of a primitive in the balance of a report, with its uncertainty and state.
[[nodiscard]] Load loadOf(const Primitive& primitive, const Vec3& force, const StepReport& report);
/// Returns the loads of mode i's primitives in the last sub-step. Empty after a fault.
[[nodiscard]] std::vector<Load> loadsOf(const ProxyState& state, const StepReport& report,
                                        std::size_t i);
/// Returns the sum: the force of the mode on the proxy [N].
[[nodiscard]] Vec3 totalOf(const std::vector<Load>& loads);
/// Returns the loads that hold for the mode: its planes if it has any, else all. Friction and a
/// surface's drag follow the planes and do not count. Opposed planes are one: only the load that
/// they carry together counts.
[[nodiscard]] std::vector<Load> bearersOf(const std::vector<Load>& loads);
/// Returns the strongest state of these loads; idle if they carry no load together.
[[nodiscard]] Hold holdOf(const std::vector<Load>& loads);

/// Returns "idle", "holds", "yields", "pushes"; for friction "idle", "sticks", "slips".
[[nodiscard]] const char* wordFor(Hold hold, bool friction = false);
[[nodiscard]] const char* wordFor(Side side);
[[nodiscard]] const char* wordFor(SolverKind kind);

/// Formats a number for people: a few digits, rounding noise as 0.
[[nodiscard]] std::string shown(double value);

}  // namespace palpate::cli
