/// Motions with an exactly known course: surfaces to slide on, streams to follow, and shells that
/// must not be crossed. Each motion consists of a grid and a hand's path. The tests and the
/// accuracy chart run these motions.
///
/// Lengths are in voxels unless stated otherwise. A voxel is 0.1 m / 128, a tick 1 ms, and k 500
/// N/m: 0.5 m/s is 0.64 voxel per tick, and 1 N stretches the spring by 2.56 voxels.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/field/field.h"
#include "palpate/engine/scene/graph.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/engine/tick/step.h"

namespace palpate::bench {

inline constexpr double kVoxel = 0.1 / 128.0;  ///< [m]
inline constexpr double kMotionTick = 1e-3;    ///< [s]
inline constexpr double kMotionStiffness = 500.0;

/// Converts a speed [m/s] to voxels per tick.
inline double voxelsPerTick(double speed) {
  return speed * kMotionTick / kVoxel;
}

/// Returns a dense grid of n^3 voxels as a field. Voxel (i, j, k) is at spacing * (i, j, k).
FieldPtr scalarGrid(int n, const std::function<double(const Vec3&)>& value,
                    const std::string& interpolation = "trilinear", bool level_set = true,
                    double spacing = 1.0);
/// Returns a dense grid of vectors with `size` voxels along each axis. If `axial` is true, the
/// vectors' signs have no meaning.
FieldPtr vectorGrid(const Vec3& size, const std::function<Vec3(const Vec3&)>& value,
                    const std::string& interpolation = "trilinear", bool axial = false);

/// A field with a cache, which tests read as a reference.
class Probed {
 public:
  explicit Probed(std::shared_ptr<const ScalarField> field);
  /// Returns (V - level) / |grad V|, which is about the signed distance of p from the surface
  /// V = level of the interpolated field. The gradient is the cell gradient.
  [[nodiscard]] double off(const Vec3& p, double level);
  [[nodiscard]] double value(const Vec3& p);

 private:
  std::shared_ptr<const ScalarField> field_;
  std::unique_ptr<FieldCache> cache_;
};

/// A surface, and a hand that presses on it.
struct SurfaceMotion {
  std::string name;
  FieldPtr field;
  double level = 0.0;
  Solid solid = Solid::kBelow;
  /// Returns the hand's position after a path of length `way`. The hand is in the solid, except
  /// where the path of cubeMotion() leads around an edge.
  std::function<Vec3(double way)> hand;
  Vec3 outside = Vec3::Zero();                  ///< Start of the hand, outside near hand(0).
  double lap = 0.0;                             ///< Value of `way` after one lap.
  std::function<double(const Vec3&)> distance;  ///< Signed distance to the true surface.
  double floor = 0.0;  ///< About the largest distance between the trilinear and the true surface;
                       ///< 0: unknown.
};

/// Returns a sphere and a hand `depth` below its surface. `kind` is "level set", or "fog N" for a
/// ramp of N voxels.
SurfaceMotion sphereMotion(const std::string& kind, double radius, double depth,
                           const std::string& interpolation = "trilinear");
/// Returns a solid with a spherical cavity. From the cavity, the hand presses `depth` deep into the
/// wall.
SurfaceMotion hollowMotion(double radius, double depth);
/// Returns a torus, and a hand that winds around its tube.
SurfaceMotion torusMotion(double major, double minor, double depth);
/// Returns the level set of a cube with edges of 40 voxels, aligned with the grid or, if `turned`
/// is true, rotated. The hand slides along four faces and around the edges between them. If
/// `hollow` is true, the cube is a cavity, and the hand slides into its edges and corners.
SurfaceMotion cubeMotion(double depth, bool turned, bool hollow = false);

/// Results of a run over a surface.
struct MotionResult {
  /// Largest distance from the interpolated surface in ticks with a force above 1 uN.
  double off_max = 0.0;
  double off_rms = 0.0;
  /// Largest distance from the true surface in ticks with a force above 1 uN.
  double true_max = 0.0;
  /// Mean signed distance from the true surface at the end minus that at the start. Each mean is
  /// over a tenth of the run, but at least one lap.
  double drift = 0.0;
  double samples = 0.0;  ///< Mean number of field samples per tick.
  double cells = 0.0;    ///< Mean number of cells that paths cross per tick.
  double most_samples = 0.0;
  double capped = 0.0;       ///< Share of ticks with a status worse than kHairpin.
  double nanoseconds = 0.0;  ///< Time per tick [ns]: the median over batches of ticks.
  double injected = 0.0;     ///< Mean injected energy per lap [J].
  /// Share of ticks in which the hand is more than half a voxel below the surface and has no force.
  double lost = 0.0;
};

/// Result of a tick of any method.
struct Ticked {
  Vec3 proxy = Vec3::Zero();  ///< [m]
  Vec3 force = Vec3::Zero();  ///< [N]
  double samples = 0.0;       ///< Number of field samples, including those of tracing.
  double cells = 0.0;
  double injected = 0.0;  ///< [J]
  double level = 0.0;     ///< Value of the surface on which the proxy should be.
  bool capped = false;
  bool hairpin = false;
};
/// A method as a function of the hand's position [m], called once per tick.
using Stepper = std::function<Ticked(const Vec3& hand)>;

/// Runs a surface motion with any method at a speed [m/s]. MotionResult::off_max uses Probed::off()
/// up to one voxel from the true surface, and the true distance beyond it. If `anywhere` is true,
/// the method may hold the proxy at any value, so the hand starts on the true surface.
MotionResult feelSurface(const SurfaceMotion& motion, const Stepper& method, double speed,
                         double laps, bool anywhere = false);
/// Returns the engine as a method for a surface.
Stepper engineOn(const SurfaceMotion& motion, ModeKind kind, const StepParams& step,
                 double strength = 3.0);
/// Runs a surface motion with the engine.
MotionResult feelSurface(const SurfaceMotion& motion, ModeKind kind, double speed, double laps,
                         const StepParams& step, double strength = 3.0);

/// Limit of Stream::mostBend() for the streams of tests. At 1, the hand would be at the centre of
/// curvature, where the nearest point of the stream is not unique.
inline constexpr double kMostBend = 0.9;

/// A stream and its exact course, computed by RK4 in steps of 0.02 voxel on the cells' polynomials,
/// split at faces of cells. The computation shares no code with the engine.
struct Stream {
  std::string name;
  FieldPtr field;  ///< Field of the voxels around the course.
  std::function<Vec3(int, int, int)> voxel;
  /// Points of the course, directions there, and normals transported along the course.
  std::vector<Vec3> x, t, n;
  double spacing = 0.02;
  /// Returns the largest curvature of the course towards the hand, times `pull`, the hand's
  /// distance to the side. At 1, the hand is at the centre of curvature.
  [[nodiscard]] double mostBend(double pull) const;
  [[nodiscard]] double length() const { return spacing * static_cast<double>(x.size() - 1); }
  /// Returns the point at length `way` (< 0: upstream) along the exact stream through p. p may be
  /// off the course.
  [[nodiscard]] Vec3 onFrom(const Vec3& p, double way) const;
  [[nodiscard]] Vec3 directionAt(const Vec3& p) const;
};

/// Traces a stream from `start`. Ends early where `inside` is false, or where the speed is below
/// `slowest`. Does not set Stream::field.
Stream traceStream(const std::string& name, const std::function<Vec3(int, int, int)>& voxel,
                   const Vec3& start, double length,
                   const std::function<bool(const Vec3&)>& inside = nullptr, double slowest = 1e-9);
/// Returns a field of the voxels around the course.
FieldPtr fieldAbout(const Stream& stream, const std::string& interpolation = "trilinear");

/// Returns the voxels of an ABC flow or a Taylor-Green flow, with this wavelength [voxels].
std::function<Vec3(int, int, int)> abcFlow(int wavelength);
std::function<Vec3(int, int, int)> taylorGreen(int wavelength);

/// Returns `count` streams of a flow, from random points where the flow is fast. Skips streams
/// whose mostBend(pull) is kMostBend or more.
std::vector<Stream> streamsOfFlow(const std::function<Vec3(int, int, int)>& flow, int wavelength,
                                  double length, std::size_t count, double pull,
                                  const std::string& interpolation = "trilinear");

/// Returns at most `count` streams of a file's first vector grid, from random points where the flow
/// is fast. A stream is 8 to `length` voxels long. Ignores the grid's transform: voxels count as
/// cubes.
std::vector<Stream> streamsOfFile(const std::string& file, std::size_t count, double length);

struct StreamResult {
  double off_max = 0.0;  ///< Largest distance from the course, before the course's end.
  /// Sum over all ticks of the proxy's distance from the exact stream through its last position,
  /// per 1,280 voxels of path.
  double departures = 0.0;
  double samples = 0.0;  ///< Mean number of vector samples per tick, including those of tracing.
  double most_samples = 0.0;
  double capped = 0.0;       ///< Share of ticks with a status worse than kHairpin.
  double hairpins = 0.0;     ///< Share of ticks with status kHairpin.
  double nanoseconds = 0.0;  ///< Time per tick [ns]: the median over batches of ticks.
  double force_step = 0.0;   ///< Largest change of the force from tick to tick [N].
  double force_most = 0.0;   ///< Largest force [N].
};

/// Follows a stream with any method. The hand moves along the course at a speed [m/s], `pull`
/// voxels to the side. Computes departures only if `judged` is true.
StreamResult feelStream(const Stream& stream, const Stepper& method, double speed, double pull,
                        bool judged = true);
/// Returns the engine as a method for a stream.
Stepper engineOn(const Stream& stream, const StepParams& step, double strength = 1.0);
/// Follows a stream with the engine and a strength of 1 N.
StreamResult feelStream(const Stream& stream, double speed, double pull, const StepParams& step);

/// A thin hollow sphere: "level set", "fog" (anti-aliased) or "binary fog". In fogs, the solid is
/// where V > level.
struct Shell {
  std::string name;
  FieldPtr field;
  double level = 0.0;
  Solid solid = Solid::kBelow;
  Vec3 centre;
  double radius = 20.0;
  double half = 0.5;  ///< Half of the shell's thickness.
};
/// Returns a shell of this kind and thickness. `level` applies to fogs only.
Shell makeShell(const std::string& kind, double thickness, double level = 0.5);

struct ShellResult {
  /// Number of presses that end with the proxy more than 0.05 voxel beyond the shell's middle.
  long crossed = 0;
  /// Number of presses with a tick in which the proxy was not outside of the solid: the surface
  /// yielded or missed the contact.
  long yielded = 0;
  double samples = 0.0;  ///< Mean number of samples per tick.
  double most_samples = 0.0;
  double cells = 0.0;
  double most_cells = 0.0;
};

/// Presses from outside at 2 m/s, from `count` directions, each at `degrees` to the normal. Each
/// press stops at the depth at which a plane would bear the share `load` of its strength.
ShellResult pressShell(const Shell& shell, double degrees, double load, long count,
                       const StepParams& step);

}  // namespace palpate::bench
