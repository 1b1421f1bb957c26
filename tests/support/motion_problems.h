/// Motions whose exact course is known: surfaces to slide on, streams to follow and shells not to
/// cross, as grids, with the hands that feel them. What the tests and the chart of accuracy run.
///
/// Lengths are in voxels unless said otherwise; a voxel is 0.1 m / 128, a tick 1 ms, k 500 N/m, so
/// that 0.5 m/s is 0.64 voxel a tick and 1 N is 2.56 voxels of spring.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/field.h"
#include "palpate/engine/graph.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/step.h"

namespace palpate::bench {

inline constexpr double kVoxel = 0.1 / 128.0;  ///< [m]
inline constexpr double kMotionTick = 1e-3;    ///< [s]
inline constexpr double kMotionStiffness = 500.0;

/// Voxels a tick at a speed [m/s].
inline double voxelsPerTick(double speed) {
  return speed * kMotionTick / kVoxel;
}

/// A dense grid of n^3 voxels as a field, voxel (i, j, k) at that place in voxels.
FieldPtr scalarGrid(int n, const std::function<double(const Vec3&)>& value,
                    const std::string& interpolation = "trilinear", bool level_set = true);
/// The same of vectors, size by axis; `axial`: of axes, whose sign means nothing.
FieldPtr vectorGrid(const Vec3& size, const std::function<Vec3(const Vec3&)>& value,
                    const std::string& interpolation = "trilinear", bool axial = false);

/// A field with its own reader's cache: what a reference asks.
class Probed {
 public:
  explicit Probed(std::shared_ptr<const ScalarField> field);
  /// How far p is from the surface V = level of the interpolated field: |V - level| / |grad V|, of
  /// the cell's own polynomial, signed as V.
  [[nodiscard]] double off(const Vec3& p, double level);
  [[nodiscard]] double value(const Vec3& p);

 private:
  std::shared_ptr<const ScalarField> field_;
  std::unique_ptr<FieldCache> cache_;
};

/// A surface and a hand that goes along under it.
struct SurfaceMotion {
  std::string name;
  FieldPtr field;
  double level = 0.0;
  Solid solid = Solid::kBelow;
  std::function<Vec3(double way)> hand;         ///< After a way along its path; below the surface.
  Vec3 outside = Vec3::Zero();                  ///< Whence it comes, near hand(0).
  double lap = 0.0;                             ///< Of the hand's path.
  std::function<double(const Vec3&)> distance;  ///< To the true surface, signed.
  double floor = 0.0;  ///< Of the interpolant against the true surface; 0: not known.
};

/// Sphere of a radius, hand `depth` below; "level set" or "fog N", a ramp of N voxels.
SurfaceMotion sphereMotion(const std::string& kind, double radius, double depth,
                           const std::string& interpolation = "trilinear");
/// The same from inside, the hand beyond the wall.
SurfaceMotion hollowMotion(double radius, double depth);
/// Torus, the hand winding about it.
SurfaceMotion torusMotion(double major, double minor, double depth);
/// A cube's level set, edges 40 voxels, with the grid or turned against it; the hand slides along
/// each of four faces and over its edge. Hollow: inside it, along walls into edges and corners.
SurfaceMotion cubeMotion(double depth, bool turned, bool hollow = false);

/// What a run of hapticStep came to.
struct MotionResult {
  double off_max = 0.0;  ///< Largest distance from the interpolant's surface while held.
  double off_rms = 0.0;
  double true_max = 0.0;  ///< From the true surface.
  double drift = 0.0;     ///< Mean signed distance from the true surface, last tenth less first.
  double samples = 0.0;   ///< A tick.
  double cells = 0.0;     ///< Walked, a tick.
  double most_samples = 0.0;
  double capped = 0.0;       ///< Share of ticks whose status is not converged.
  double nanoseconds = 0.0;  ///< A tick, the median of hundreds.
  double injected = 0.0;     ///< [J] a lap.
  double lost = 0.0;         ///< Share of ticks in which nothing held the proxy, the hand below.
};

/// What one tick of any method came to.
struct Ticked {
  Vec3 proxy = Vec3::Zero();  ///< [m]
  Vec3 force = Vec3::Zero();  ///< [N]
  double samples = 0.0;       ///< Reads of the field, those of tracing included.
  double cells = 0.0;
  double injected = 0.0;  ///< [J]
  double level = 0.0;     ///< Of the surface on which the proxy should be.
  bool capped = false;
  bool hairpin = false;
};
/// A method: takes the hand [m] tick by tick.
using Stepper = std::function<Ticked(const Vec3& hand)>;

/// Feels a surface by any method. What is farther from the true surface than a voxel counts by
/// that distance, since slopes there say nothing.
MotionResult feelSurface(const SurfaceMotion& motion, const Stepper& method, double speed,
                         double laps, bool anywhere = false);
/// The engine on a surface.
Stepper engineOn(const SurfaceMotion& motion, ModeKind kind, const StepParams& step,
                 double strength = 3.0);
/// Feels a surface by the engine.
MotionResult feelSurface(const SurfaceMotion& motion, ModeKind kind, double speed, double laps,
                         const StepParams& step, double strength = 3.0);

/// Of a stream's bend, as Stream::mostBend: below it the place nearest to the hand is one.
inline constexpr double kMostBend = 0.9;

/// A stream and its exact course: RK4 in steps of 0.02 voxel, split at the faces of cells, on the
/// cells' own polynomials; written apart from the engine's.
struct Stream {
  std::string name;
  FieldPtr field;  ///< Voxels about the course.
  std::function<Vec3(int, int, int)> voxel;
  std::vector<Vec3> x, t, n;  ///< Places, directions, and one that is carried along across them.
  double spacing = 0.02;
  /// Of the course, times the hand's `pull` aside: at 1 the hand is at the centre of curvature.
  [[nodiscard]] double mostBend(double pull) const;
  [[nodiscard]] double length() const { return spacing * static_cast<double>(x.size() - 1); }
  /// On along the exact stream from p, which need not be on the course.
  [[nodiscard]] Vec3 onFrom(const Vec3& p, double way) const;
  [[nodiscard]] Vec3 directionAt(const Vec3& p) const;
};

/// Traces from a start; ends early at the data's edge (`inside`) or where the speed falls below. It
/// has no field yet.
Stream traceStream(const std::string& name, const std::function<Vec3(int, int, int)>& voxel,
                   const Vec3& start, double length,
                   const std::function<bool(const Vec3&)>& inside = nullptr, double slowest = 1e-9);
/// A grid of the voxels about the course.
FieldPtr fieldAbout(const Stream& stream, const std::string& interpolation = "trilinear");

/// Voxels of an ABC flow and of a Taylor-Green one, so many to a wavelength.
std::function<Vec3(int, int, int)> abcFlow(int wavelength);
std::function<Vec3(int, int, int)> taylorGreen(int wavelength);

/// Streams of such a flow from random places in its faster parts, bent less than kMostBend.
std::vector<Stream> streamsOfFlow(const std::function<Vec3(int, int, int)>& flow, int wavelength,
                                  double length, std::size_t count, double pull,
                                  const std::string& interpolation = "trilinear");

/// Streams of a file's vector grid, from random places in its faster parts, in the grid's own
/// voxels as if they were cubes; at most `length` long, and at least 8.
std::vector<Stream> streamsOfFile(const std::string& file, std::size_t count, double length);

struct StreamResult {
  double off_max = 0.0;     ///< From the course.
  double departures = 0.0;  ///< Sum over ticks of the departure from the exact local stream, by
                            ///< 1,280 voxels.
  double samples = 0.0;     ///< Reads of vectors a tick, those of tracing included.
  double most_samples = 0.0;
  double capped = 0.0;    ///< Share of ticks that did not converge; hairpins apart.
  double hairpins = 0.0;  ///< Share of ticks in which the engine says it is at one.
  double nanoseconds = 0.0;
  double force_step = 0.0;  ///< Largest change of the force in a tick [N].
  double force_most = 0.0;  ///< [N]
};

/// Follows a stream by any method; departures are only found where `judged`.
StreamResult feelStream(const Stream& stream, const Stepper& method, double speed, double pull,
                        bool judged = true);
/// The engine on a stream.
Stepper engineOn(const Stream& stream, const StepParams& step, double strength = 1.0);
/// Follows a stream by the engine, the hand on its course and `pull` aside, strength 1 N.
StreamResult feelStream(const Stream& stream, double speed, double pull, const StepParams& step);

/// A thin sphere, hollow: "level set", "fog" (anti-aliased) or "binary fog", so many voxels thick.
/// Of fog the solid is where V > level.
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
  long crossed = 0;      ///< The proxy ended inside.
  long yielded = 0;      ///< It was let through, or left.
  double samples = 0.0;  ///< A tick.
  double most_samples = 0.0;
  double cells = 0.0;
  double most_cells = 0.0;
};

/// Presses from outside at 2 m/s, `degrees` from head on, from `count` directions, to a depth at
/// which a plane would carry `load` of its strength, and holds there.
ShellResult pressShell(const Shell& shell, double degrees, double load, long count,
                       const StepParams& step);

}  // namespace palpate::bench
