/// What check, explain and press share: a hand of one's own in a scene, and in words what each mode
/// does.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/step.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/scene_file.h"

namespace palpate::cli {

/// "x,y,z" in metres, finite and within 1,000 km; else throws Error that names the option.
[[nodiscard]] Vec3 readVector(const std::string& option, const std::string& text);

/// Faces included.
[[nodiscard]] bool holds(const Box& box, const Vec3& p);

/// The scene and what it loads: nothing is written over these.
[[nodiscard]] std::vector<std::filesystem::path> inputsOf(const std::string& scene,
                                                          const SceneSpec& spec);

/// Throws Error where a place is farther than a tick takes for a hand. `name` is what the caller
/// gave it by: an option, or an argument of a function.
void checkReach(const std::string& name, const Vec3& p);

/// Throws Error where ticks a second are not 10 to 100000.
void checkRate(const std::string& name, double rate);

/// A scene with its notes told, refused where a `path` device would refuse it.
struct Opened {
  SceneSpec spec;    ///< As its file says it.
  SceneSpec told;    ///< Of one graph: where that has parts, those that the hand comes near.
  BuiltScene built;  ///< From `told`.
};
/// The parts that a hand came near.
struct Near {
  std::set<std::size_t> parts;  ///< Indices into Scene::parts.
  double missing = 0.0;         ///< So much force of others, for which there was no room [N].

  /// Those that the last tick chose.
  void add(const ProxyState& state, const StepReport& report);
};
/// The caller's hand in a scene of parts.
using Rehearsal = std::function<Near(const BuiltScene&)>;
/// Told of what the user should know, a line each.
using Say = std::function<void(const std::string&)>;
/// On stderr.
void complainOf(const std::string& line);
[[nodiscard]] Opened openFor(SceneSpec spec, const Rehearsal& rehearse, const Progress& progress,
                             const Say& say);
/// From a file, with its progress on a terminal.
[[nodiscard]] Opened openFor(const std::string& scene, const Rehearsal& rehearse);

/// Who reads a field, modes and the coupling: why it is sampled.
[[nodiscard]] std::vector<std::string> readersOf(const Graph& graph, const FieldSet& field);

/// Those of the device `path`: no hand yields, so no hardware limits it.
[[nodiscard]] ForceLimits pathLimits();

/// How a rest ended.
struct Rest {
  StepReport report;  ///< Of its last tick.
  int ticks = 0;
};
/// The hand comes to `at` and rests: one tick, so that contacts are known, and where the stiffness
/// varies as many more as it takes to settle, two seconds at most.
[[nodiscard]] Rest restAt(const Scene& scene, Reader& reader, ProxyState& state, const Vec3& at,
                          double dt);

/// What a primitive does in a balance.
enum class Hold : std::uint8_t {
  kIdle,    ///< Carries nothing.
  kHolds,   ///< Carries less than its strength: the proxy stays on it.
  kYields,  ///< Carries its strength: the proxy was pulled off it.
  kPushes,  ///< A directed force: always its strength.
};

/// One primitive of the last balance.
struct Load {
  Primitive primitive;
  Vec3 force = Vec3::Zero();  ///< What it does to the proxy [N].
  double known = 0.0;         ///< To within this [N].
  Hold hold = Hold::kIdle;
  bool friction = false;     ///< A line of friction, whose strength is mu times its plane's load.
  double coefficient = 0.0;  ///< mu, of friction.
  std::size_t plane = 0;     ///< Of friction: its plane's index among the mode's.
};

/// A primitive's load in the balance of a report: how exactly it is known, and what it does there.
[[nodiscard]] Load loadOf(const Primitive& primitive, const Vec3& force, const StepReport& report);
/// What mode i placed in the last sub-step, with its loads. None after a fault.
[[nodiscard]] std::vector<Load> loadsOf(const ProxyState& state, const StepReport& report,
                                        std::size_t i);
/// Their sum: what the mode does to the proxy [N].
[[nodiscard]] Vec3 totalOf(const std::vector<Load>& loads);
/// Those that hold for the mode: its planes if it has any, else all; friction and the drag of a
/// surface go with the planes. Opposed planes are one: what counts is what they carry together.
[[nodiscard]] std::vector<Load> bearersOf(const std::vector<Load>& loads);
/// The strongest word of these, idle where they do nothing together.
[[nodiscard]] Hold holdOf(const std::vector<Load>& loads);

/// "idle", "holds", "yields", "pushes"; of friction "idle", "sticks", "slips".
[[nodiscard]] const char* wordFor(Hold hold, bool friction = false);
[[nodiscard]] const char* wordFor(Side side);
[[nodiscard]] const char* wordFor(SolverKind kind);

/// For people: a few digits, rounding noise as 0.
[[nodiscard]] std::string shown(double value);

}  // namespace palpate::cli
