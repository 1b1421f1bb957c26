/// Motions with an exactly known course: surfaces to slide on, streams to follow and shells that
/// must not be crossed. Each is a grid with a hand that moves along it. The tests and the accuracy
/// chart run them.
///
/// Lengths are in voxels unless another unit is given. A voxel is 0.1 m / 128, a tick 1 ms and k
/// 500 N/m. So 0.5 m/s is 0.64 voxel per tick, and 1 N stretches the spring by 2.56 voxels.
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

/// Returns a speed [m/s] as voxels per tick.
inline double voxelsPerTick(double speed) {
  return speed * kMotionTick / kVoxel;
}

/// Returns a dense grid of n^3 voxels as a field. Voxel (i, j, k) is at `spacing` times (i, j, k).
FieldPtr scalarGrid(int n, const std::function<double(const Vec3&)>& value,
                    const std::string& interpolation = "trilinear", bool level_set = true,
                    double spacing = 1.0);
/// Returns a dense grid of vectors with `size` voxels along each axis. `axial`: the vectors are
/// axes, whose sign has no meaning.
FieldPtr vectorGrid(const Vec3& size, const std::function<Vec3(const Vec3&)>& value,
                    const std::string& interpolation = "trilinear", bool axial = false);

/// A field with its own cache, which tests read as a reference.
class Probed {
 public:
  explicit Probed(std::shared_ptr<const ScalarField> field);
  /// Returns |V - level| / |grad V|, the distance of p from the surface V = level of the
  /// interpolated field, with the sign of V - level. The slope is that of the cell's own
  /// polynomial.
  [[nodiscard]] double off(const Vec3& p, double level);
  [[nodiscard]] double value(const Vec3& p);

 private:
  std::shared_ptr<const ScalarField> field_;
  std::unique_ptr<FieldCache> cache_;
};

/// A surface and a hand that moves below it.
struct SurfaceMotion {
  std::string name;
  FieldPtr field;
  double level = 0.0;
  Solid solid = Solid::kBelow;
  /// Position of the hand after a length of its path; below the surface.
  std::function<Vec3(double way)> hand;
  Vec3 outside = Vec3::Zero();                  ///< Start of the run, near hand(0) and outside.
  double lap = 0.0;                             ///< Length of a lap of the hand's path.
  std::function<double(const Vec3&)> distance;  ///< Signed distance to the true surface.
  double floor = 0.0;  ///< Distance between the interpolated and the true surface; 0: unknown.
};

/// Returns a sphere with a hand `depth` below its surface. `kind`: "level set", or "fog N", a ramp
/// of N voxels.
SurfaceMotion sphereMotion(const std::string& kind, double radius, double depth,
                           const std::string& interpolation = "trilinear");
/// Returns a hollow sphere with the hand inside and `depth` beyond the wall.
SurfaceMotion hollowMotion(double radius, double depth);
/// Returns a torus with a hand that winds around the tube.
SurfaceMotion torusMotion(double major, double minor, double depth);
/// Returns the level set of a cube with edges of 40 voxels, aligned with the grid or turned
/// relative to it. The hand slides along each of four faces and over its edge. If hollow, the hand
/// is inside and moves along walls into edges and corners.
SurfaceMotion cubeMotion(double depth, bool turned, bool hollow = false);

/// Result of a run of hapticStep.
struct MotionResult {
  /// Largest distance from the interpolated surface while the proxy is held.
  double off_max = 0.0;
  double off_rms = 0.0;
  double true_max = 0.0;  ///< Largest distance from the true surface.
  /// Mean signed distance from the true surface in the last tenth, less that in the first tenth.
  double drift = 0.0;
  double samples = 0.0;  ///< Field reads, mean per tick.
  double cells = 0.0;    ///< Cells walked through, mean per tick.
  double most_samples = 0.0;
  double capped = 0.0;       ///< Share of ticks that did not converge.
  double nanoseconds = 0.0;  ///< Time per tick [ns], the median of hundreds.
  double injected = 0.0;     ///< Energy injected per lap [J].
  /// Share of ticks in which the hand is below the surface but the proxy is free.
  double lost = 0.0;
};

/// Result of one tick of any method.
struct Ticked {
  Vec3 proxy = Vec3::Zero();  ///< [m]
  Vec3 force = Vec3::Zero();  ///< [N]
  double samples = 0.0;       ///< Reads of the field, including those of tracing.
  double cells = 0.0;
  double injected = 0.0;  ///< [J]
  double level = 0.0;     ///< Value at the surface on which the proxy should be.
  bool capped = false;
  bool hairpin = false;
};
/// A method: a function that is called with the hand's position [m] in each tick.
using Stepper = std::function<Ticked(const Vec3& hand)>;

/// Runs a surface motion with any method. If the proxy is more than a voxel from the true surface,
/// that distance counts instead of the one from the slope, because slopes there have no meaning.
MotionResult feelSurface(const SurfaceMotion& motion, const Stepper& method, double speed,
                         double laps, bool anywhere = false);
/// Returns the engine as a method on a surface.
Stepper engineOn(const SurfaceMotion& motion, ModeKind kind, const StepParams& step,
                 double strength = 3.0);
/// Runs a surface motion with the engine.
MotionResult feelSurface(const SurfaceMotion& motion, ModeKind kind, double speed, double laps,
                         const StepParams& step, double strength = 3.0);

/// Limit of Stream::mostBend. Below it, the place nearest to the hand is unique.
inline constexpr double kMostBend = 0.9;

/// A stream and its exact course: RK4 in steps of 0.02 voxel, split at the faces of cells, on the
/// cells' own polynomials. Shares no code with the engine.
struct Stream {
  std::string name;
  FieldPtr field;  ///< Field of the voxels about the course.
  std::function<Vec3(int, int, int)> voxel;
  /// Points of the course, directions there, and normals that are carried along the course.
  std::vector<Vec3> x, t, n;
  double spacing = 0.02;
  /// Returns the largest curvature of the course times `pull`, the hand's distance to the side. At
  /// 1 the hand is at the centre of curvature.
  [[nodiscard]] double mostBend(double pull) const;
  [[nodiscard]] double length() const { return spacing * static_cast<double>(x.size() - 1); }
  /// Returns the point at a length `way` along the exact stream from p. The point p need not be on
  /// the course.
  [[nodiscard]] Vec3 onFrom(const Vec3& p, double way) const;
  [[nodiscard]] Vec3 directionAt(const Vec3& p) const;
};

/// Traces a stream from a start. Ends early at the edge of the data (`inside`) or if the speed
/// falls below `slowest`. Does not set Stream::field.
Stream traceStream(const std::string& name, const std::function<Vec3(int, int, int)>& voxel,
                   const Vec3& start, double length,
                   const std::function<bool(const Vec3&)>& inside = nullptr, double slowest = 1e-9);
/// Returns a field of the voxels about the course.
FieldPtr fieldAbout(const Stream& stream, const std::string& interpolation = "trilinear");

/// Return the voxels of an ABC flow and of a Taylor-Green flow, with a wavelength in voxels.
std::function<Vec3(int, int, int)> abcFlow(int wavelength);
std::function<Vec3(int, int, int)> taylorGreen(int wavelength);

/// Returns streams of a flow from random places in its faster parts. Streams with a bend of
/// kMostBend or more are left out.
std::vector<Stream> streamsOfFlow(const std::function<Vec3(int, int, int)>& flow, int wavelength,
                                  double length, std::size_t count, double pull,
                                  const std::string& interpolation = "trilinear");

/// Returns streams of a file's vector grid from random places in its faster parts. Lengths are in
/// the grid's voxels, which are treated as cubes; at most `length`, and at least 8.
std::vector<Stream> streamsOfFile(const std::string& file, std::size_t count, double length);

struct StreamResult {
  double off_max = 0.0;  ///< Largest distance from the course.
  /// Sum over all ticks of the distance by which the tick left the exact local stream, per 1,280
  /// voxels.
  double departures = 0.0;
  double samples = 0.0;  ///< Reads of vectors per tick, including those of tracing.
  double most_samples = 0.0;
  double capped = 0.0;    ///< Share of ticks that did not converge, without hairpins.
  double hairpins = 0.0;  ///< Share of ticks in which the engine reports a hairpin.
  double nanoseconds = 0.0;
  double force_step = 0.0;  ///< Largest change of the force in a tick [N].
  double force_most = 0.0;  ///< Largest force [N].
};

/// Follows a stream with any method. Computes departures only if `judged`.
StreamResult feelStream(const Stream& stream, const Stepper& method, double speed, double pull,
                        bool judged = true);
/// Returns the engine as a method on a stream.
Stepper engineOn(const Stream& stream, const StepParams& step, double strength = 1.0);
/// Follows a stream with the engine, with strength 1 N. The hand moves along the course, at the
/// distance `pull` to the side.
StreamResult feelStream(const Stream& stream, double speed, double pull, const StepParams& step);

/// A thin hollow sphere with a thickness in voxels: "level set", "fog" (anti-aliased) or "binary
/// fog". In a fog the solid is where V > level.
struct Shell {
  std::string name;
  FieldPtr field;
  double level = 0.0;
  Solid solid = Solid::kBelow;
  Vec3 centre;
  double radius = 20.0;
  double half = 0.5;
};
Shell makeShell(const std::string& kind, double thickness, double level = 0.5);

struct ShellResult {
  long crossed = 0;  ///< Number of presses that ended with the proxy inside.
  /// Number of presses in which the surface let the proxy through, or the proxy left the surface.
  long yielded = 0;
  double samples = 0.0;  ///< Mean per tick.
  double most_samples = 0.0;
  double cells = 0.0;
  double most_cells = 0.0;
};

/// Presses from outside at 2 m/s, from `count` directions, each `degrees` from the normal. Each
/// press goes to the depth at which a plane would carry the share `load` of its strength, and stays
/// there.
ShellResult pressShell(const Shell& shell, double degrees, double load, long count,
                       const StepParams& step);

}  // namespace palpate::bench
