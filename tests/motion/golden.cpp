/// Golden recordings: compares the forces of hands in scenes of all kinds with stored results.
/// - palpate_golden_ticks FILE: compares with FILE; exits with 1 if a scene differs by too much
/// - palpate_golden_ticks FILE --write: writes FILE
/// - palpate_golden_ticks --record NAME OUT: writes a scene as a recording, for palpate compare
/// With the compiler that wrote FILE, inputs, outputs and work of all ticks must be bit-identical.
/// With another compiler, only the inputs must be bit-identical. Then in every 100th tick, proxies
/// may differ by the sum of both error bounds, and forces by the effect of this difference.
///
/// A commit that only moves code must not change a hash. A commit that changes behaviour states
/// which hashes change, and why. Do not use library functions here whose rounding depends on the
/// processor (sine, exponential).
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "palpate/devices/recording/recording.h"
#include "palpate/engine/loop/hand_tick.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/corner_noise.h"
#include "tests/support/motion_problems.h"
#include "tests/support/random.h"

using namespace palpate;
using palpate::bench::kVoxel;
using palpate::test::Random;

namespace {

constexpr int kTicks = 2000;
constexpr int kSide = 48;                                // edge of a grid [voxels]
const Vec3 kMiddle = Vec3::Constant(0.5 * (kSide - 1));  // middle of a grid [voxels]
constexpr double kMetres = 0.05;                         // size of the fields that are formulas [m]
using Fields = std::map<std::string, FieldPtr>;

ModeSpec mode(ModeKind kind, const std::string& of, double strength, double friction = 0.0,
              double viscosity = 0.0) {
  ModeSpec spec;
  spec.kind = kind;
  spec.of = of;
  spec.strength = strength;
  spec.solid = Solid::kBelow;
  spec.friction = friction;
  spec.viscosity = viscosity;
  return spec;
}

/// A smooth path through random positions in a box about `middle`. The hand takes `ticks_a_leg`
/// ticks from one position to the next.
class Wander {
 public:
  Wander(const Vec3& middle, const Vec3& half, int ticks_a_leg, std::uint64_t seed)
      : ticks_(ticks_a_leg) {
    Random random(seed);
    for (int i = 0; i < kTicks / ticks_ + 5; ++i) {
      const Vec3 p = random.inCube(1.0);
      places_.emplace_back(middle + half.cwiseProduct(p));
    }
  }
  Vec3 operator()(int tick) const {
    const auto i = static_cast<std::size_t>(tick / ticks_);
    const double t = static_cast<double>(tick % ticks_) / ticks_;
    const Vec3& a = places_[i];
    const Vec3& b = places_[i + 1];
    const Vec3& c = places_[i + 2];
    const Vec3& d = places_[i + 3];  // Catmull-Rom spline
    return b + 0.5 * t *
                   ((c - a) + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)));
  }

 private:
  int ticks_;
  std::vector<Vec3> places_;
};

/// The input and scene of the next tick, which an event may change.
struct Moment {
  int tick;
  TickInput& in;
  std::size_t& scene;  ///< Index into Take::scenes, or kNoScene.
};
constexpr std::size_t kNoScene = 99;

/// Scenes, and the path of a hand in them.
struct Take {
  std::string name;
  std::vector<std::unique_ptr<const Scene>> scenes;
  std::function<Vec3(int)> hand;  ///< Returns the hand's position in a tick [m].
  std::function<void(Moment&)> event;
  ForceLimits limits{1e3, 1e12};
};

std::unique_ptr<const Scene> sceneOf(std::vector<ModeSpec> modes, const Fields& fields,
                                     const std::map<std::string, MotionPtr>& motions = {},
                                     const CouplingParams& coupling = {500.0, 0.0}) {
  GraphSpec spec;
  spec.modes = std::move(modes);
  spec.motions = motions;
  for (ModeSpec& m : spec.modes) {
    if (m.kind == ModeKind::kGuide && !motions.empty()) m.in = motions.begin()->first;
  }
  return makeScene(spec, fields, coupling);
}

template <class... Scenes>
Take take(std::string name, std::function<Vec3(int)> hand, Scenes... scenes) {
  Take out;
  out.name = std::move(name);
  out.hand = std::move(hand);
  (out.scenes.push_back(std::move(scenes)), ...);
  return out;
}

// The fields below are formulas of positions [m].

FieldPtr dentedBall() {
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-10), Vec3::Constant(10)}, 1.0};
  return makeScalarField(frame, [](const Vec3& p) {
    const double r = p.norm();
    const Vec3 outwards = r > 0.0 ? Vec3(p / r) : Vec3(Vec3::Zero());
    const Vec3 slope = 10.0 * Vec3(p.y() * p.z(), p.x() * p.z(), p.x() * p.y()) / kMetres;
    const double dent = 10.0 * p.x() * p.y() * p.z() / kMetres;
    return ScalarSample{r - 0.8 * kMetres + dent, outwards + slope, r < 2.0 * kMetres};
  });
}

FieldPtr slantedFlow() {
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-10), Vec3::Constant(10)}, 0.0};
  Mat3 jacobian;
  jacobian << 0.3, -2.0, 0.4, 2.2, -0.1, -0.5, -0.3, 0.7, -0.2;
  return makeVectorField(frame, [jacobian](const Vec3& p) {
    return VectorSample{jacobian * p + Vec3(0.02, 0.01, 0.1), jacobian, p.norm() < 2.0 * kMetres};
  });
}

Fields formulas() {
  return {{"ball", dentedBall()}, {"flow", slantedFlow()}};
}

/// Returns all modes except user-defined ones, in variants that place different primitives.
std::vector<std::pair<const char*, ModeSpec>> allModes() {
  std::vector<std::pair<const char*, ModeSpec>> modes{
      {"force", mode(ModeKind::kForce, "flow", 0.4)},
      {"viscosity", mode(ModeKind::kViscosity, "ball", 0.3)},
      {"surface", mode(ModeKind::kSurface, "ball", 1.5)},
      {"surface-friction", mode(ModeKind::kSurface, "ball", 1.5, 0.5, 0.1)},
      {"isosurface", mode(ModeKind::kIsosurface, "ball", 2.0)},
      {"isosurface-friction", mode(ModeKind::kIsosurface, "ball", 2.0, 0.4, 0.2)},
      {"follow", mode(ModeKind::kFollow, "flow", 0.8)},
      {"transverse-damping", mode(ModeKind::kTransverseDamping, "flow", 0.2)},
      {"front", mode(ModeKind::kFrontShape, "flow", 0.9)},
      {"front-one-sided", mode(ModeKind::kFrontShape, "flow", 0.9)},
      {"snap-drag", mode(ModeKind::kFrontShape, "flow", 0.9)},
      {"vortex-tube", mode(ModeKind::kVortexTube, "flow", 0.7)},
      {"guide-point", mode(ModeKind::kGuide, "", 1.0)},
      {"guide-line", mode(ModeKind::kGuide, "", 1.0)},
      {"guide-plane", mode(ModeKind::kGuide, "", 1.2)}};
  modes[9].second.two_sided = false;
  modes[10].second.snap_voxels = 3.0;
  modes[12].second.guide.position = Vec3(0.03, 0.01, 0.0);
  modes[12].second.guide.snap = 0.02;
  modes[13].second.guide = {PrimitiveKind::kLine, Vec3(0.02, 0.0, 0.01), Vec3(0.0, 0.6, 0.8), 0.02};
  modes[13].second.strength = TransferFunction::piecewise({{0, 0}, {0.01, 2}});
  modes[14].second.guide = {PrimitiveKind::kPlane, Vec3(0.0, 0.0, 0.02), Vec3(0.6, 0.0, 0.8), 0.03};
  return modes;
}

/// Returns a motion back and forth. Its quaternions are computed without sines, for portable
/// rounding.
MotionPtr tumbling(const Vec3& middle, double size) {
  std::vector<Keyframe> keys(5);
  const std::array<Vec3, 3> turns{Vec3(0.1, 0.05, -0.08), Vec3(0.05, 0.15, 0.05),
                                  Vec3(-0.05, 0.05, 0.1)};
  const std::array<Vec3, 3> ways{Vec3(1, 0, 0), Vec3(1, -1, 0), Vec3(0, 0, 1)};
  for (std::size_t i = 0; i < 5; ++i) {
    keys[i].time = 0.1 * static_cast<double>(i);
    if (i == 0 || i == 4) continue;
    const Eigen::Quaterniond q =
        Eigen::Quaterniond(1.0, turns[i - 1].x(), turns[i - 1].y(), turns[i - 1].z()).normalized();
    keys[i].rotation_wxyz = {q.w(), q.x(), q.y(), q.z()};
    keys[i].translate = size * ways[i - 1] + middle - q * middle;
  }
  return std::make_shared<const Motion>(keys, true);
}

// The fields below are grids, with positions in voxels.

const Mat3& anyFrame() {
  static const Mat3 turn = Eigen::Quaterniond(0.8, 0.3, -0.4, 0.2).normalized().toRotationMatrix();
  return turn;
}

FieldPtr ballGrid(double radius, const char* interpolation = "trilinear", double ramp = 3.0) {
  return bench::scalarGrid(
      kSide, [=](const Vec3& p) { return std::clamp((p - kMiddle).norm() - radius, -ramp, ramp); },
      interpolation);
}

FieldPtr torusGrid() {
  return bench::scalarGrid(kSide, [](const Vec3& p) {
    const Vec3 q = anyFrame() * (p - kMiddle);
    const double ring = std::sqrt(q.x() * q.x() + q.y() * q.y()) - 14.0;
    return std::clamp(std::sqrt(ring * ring + q.z() * q.z()) - 6.0, -3.0, 3.0);
  });
}

/// Returns a groove whose walls have an angle to its middle plane. `half_tangent` is the tangent of
/// half that angle.
FieldPtr grooveGrid(double half_tangent) {
  const double sine = 2.0 * half_tangent / (1.0 + half_tangent * half_tangent);
  const double cosine = std::sqrt(1.0 - sine * sine);
  return bench::scalarGrid(kSide, [=](const Vec3& p) {
    const Vec3 q = anyFrame() * (p - kMiddle);
    const double along = sine * (q.z() + 8.0);
    return std::clamp(std::min(along + cosine * q.x(), along - cosine * q.x()), -3.0, 3.0);
  });
}

FieldPtr hollowCubeGrid(bool hollow) {
  return bench::scalarGrid(kSide, [=](const Vec3& p) {
    const double off = (anyFrame() * (p - kMiddle)).cwiseAbs().maxCoeff() - 13.0;
    return std::clamp(hollow ? -off : off, -3.0, 3.0);
  });
}

/// Returns random values at grid points `grain` voxels apart, interpolated linearly between them.
FieldPtr roughGrid(double grain, std::uint64_t seed) {
  Random random(seed);
  std::vector<double> values(40 * 40 * 40);
  for (double& value : values) value = random.uniform(-1.0, 1.0);
  return bench::scalarGrid(
      kSide, [=](const Vec3& p) { return grain * bench::betweenCorners(values, 40, p / grain); });
}

FieldPtr shellGrid(double thickness) {
  return bench::scalarGrid(kSide, [=](const Vec3& p) {
    return std::clamp(std::abs((p - kMiddle).norm() - 15.0) - 0.5 * thickness, -3.0, 3.0);
  });
}

FieldPtr flowGrid(const char* interpolation = "trilinear", bool axial = false) {
  return bench::vectorGrid(
      Vec3::Constant(kSide),
      [](const Vec3& p) {
        const Vec3 q = (p - kMiddle) / 20.0;
        return Vec3(-q.y() + 0.3 * q.z() * q.z(), q.x() - 0.2 * q.x() * q.y(), 0.4 + 0.3 * q.x());
      },
      interpolation, axial);
}

std::function<Vec3(int)> inGrid(double half, int ticks_a_leg, std::uint64_t seed) {
  return Wander(kVoxel * kMiddle, Vec3::Constant(kVoxel * half), ticks_a_leg, seed);
}
std::function<Vec3(int)> inRoom(int ticks_a_leg, std::uint64_t seed) {
  return Wander(Vec3(0.6, 0.3, 0.4) * kMetres, Vec3::Constant(0.6 * kMetres), ticks_a_leg, seed);
}

/// Returns a take with an isosurface of a grid.
Take skin(const char* name, const FieldPtr& field, double strength, int ticks_a_leg,
          double half = 18.0, double friction = 0.0, double viscosity = 0.0) {
  return take(
      name, inGrid(half, ticks_a_leg, 5),
      sceneOf({mode(ModeKind::kIsosurface, "it", strength, friction, viscosity)}, {{"it", field}}));
}

std::vector<Part> ballParts(int count, double room) {
  Random random(21);
  std::vector<Part> parts;
  for (int i = 0; i < count; ++i) {
    GraphSpec spec;
    spec.modes = {mode(ModeKind::kIsosurface, "it", 1.0 + 0.1 * (i % 7), i % 3 == 0 ? 0.3 : 0.0)};
    const double radius = random.uniform(0.005, 0.02);
    const Vec3 centre = random.inCube(room);
    FieldFrame frame;
    const Vec3 size = Vec3::Constant(radius + 3e-3);
    frame.bounds = {centre - size, centre + size};
    frame.background = 3e-3;
    const FieldPtr field = makeScalarField(frame, [=](const Vec3& p) noexcept -> ScalarSample {
      const Vec3 d = p - centre;
      return {d.norm() - radius, d.normalized(), true};
    });
    parts.push_back(makePart(spec, {{"it", field}}));
  }
  return parts;
}

std::vector<Take> takes() {
  std::vector<Take> all;
  std::vector<ModeSpec> modes;
  for (const auto& [name, spec] : allModes()) {
    modes.push_back(spec);
    all.push_back(take(name, inRoom(100, 1), sceneOf({spec}, formulas())));
  }
  all.push_back(take("all-modes", inRoom(100, 2), sceneOf(modes, formulas())));
  const MotionPtr tumble = tumbling(Vec3::Zero(), 0.01);
  all.push_back(take("all-modes-moving", inRoom(100, 3),
                     sceneOf(modes, formulas(), {{"ball", tumble}, {"flow", tumble}})));
  all.push_back(take("ball-moves", inRoom(100, 4), sceneOf(modes, formulas(), {{"ball", tumble}})));

  all.push_back(skin("ball-slow", ballGrid(14.0), 8.0, 400));
  all.push_back(skin("ball-fast", ballGrid(14.0), 8.0, 15));
  all.push_back(skin("ball-fog", ballGrid(14.0, "trilinear", 6.0), 3.0, 100));
  all.push_back(skin("ball-quadratic", ballGrid(10.0, "quadratic"), 3.0, 100));
  all.push_back(skin("ball-cubic", ballGrid(10.0, "cubic"), 3.0, 100));
  all.push_back(skin("ball-friction", ballGrid(14.0), 3.0, 100, 18.0, 0.5, 0.2));
  all.push_back(skin("ball-yields", ballGrid(14.0), 0.5, 100));
  all.push_back(skin("torus", torusGrid(), 8.0, 100));
  all.push_back(skin("cube", hollowCubeGrid(false), 8.0, 100));
  all.push_back(skin("cube-hollow", hollowCubeGrid(true), 8.0, 100));
  all.push_back(skin("groove-90", grooveGrid(0.41421), 20.0, 100, 14.0));
  all.push_back(skin("groove-45", grooveGrid(0.19891), 20.0, 100, 14.0));
  all.push_back(skin("groove-20", grooveGrid(0.08749), 20.0, 100, 14.0));
  all.push_back(skin("groove-20-friction", grooveGrid(0.08749), 20.0, 100, 14.0, 0.4));
  all.push_back(skin("rough-12", roughGrid(12.0, 3), 8.0, 100));
  all.push_back(skin("rough-7", roughGrid(7.0, 4), 8.0, 100));
  all.push_back(skin("rough-4", roughGrid(4.5, 5), 8.0, 200));
  all.push_back(skin("rough-yields", roughGrid(4.5, 6), 0.5, 60));
  all.push_back(skin("shell", shellGrid(1.5), 3.0, 30));
  all.push_back(
      take("surface-rough", inGrid(18.0, 100, 6),
           sceneOf({mode(ModeKind::kSurface, "it", 2.0, 0.3, 0.1)}, {{"it", roughGrid(7.0, 7)}})));

  const auto flowing = [&](const char* name, const FieldPtr& flow, const ModeSpec& spec, int leg) {
    all.push_back(take(name, inGrid(16.0, leg, 8), sceneOf({spec}, {{"flow", flow}})));
  };
  flowing("stream", flowGrid(), mode(ModeKind::kFollow, "flow", 1.0), 100);
  flowing("stream-fast", flowGrid(), mode(ModeKind::kFollow, "flow", 3.0), 15);
  flowing("stream-axial", flowGrid("trilinear", true), mode(ModeKind::kFollow, "flow", 1.0), 100);
  flowing("stream-cubic", flowGrid("cubic"), mode(ModeKind::kFollow, "flow", 1.0), 100);
  flowing("tube-grid", flowGrid(), mode(ModeKind::kVortexTube, "flow", 1.0), 100);
  flowing("front-grid", flowGrid(), mode(ModeKind::kFrontShape, "flow", 1.0), 100);
  all.push_back(
      take("stream-on-skin", inGrid(16.0, 100, 9),
           sceneOf({mode(ModeKind::kIsosurface, "ball", 3.0, 0.3, 0.1),
                    mode(ModeKind::kFollow, "flow", 1.0), mode(ModeKind::kViscosity, "ball", 0.2)},
                   {{"ball", ballGrid(14.0)}, {"flow", flowGrid()}})));

  const Vec3 middle = kVoxel * kMiddle;
  all.push_back(take("ball-tumbles", inGrid(16.0, 200, 10),
                     sceneOf({mode(ModeKind::kIsosurface, "it", 8.0, 0.3)},
                             {{"it", ballGrid(14.0)}}, {{"it", tumbling(middle, 8.0 * kVoxel)}})));
  all.push_back(take("groove-tumbles", inGrid(10.0, 200, 11),
                     sceneOf({mode(ModeKind::kIsosurface, "it", 20.0)}, {{"it", grooveGrid(0.3)}},
                             {{"it", tumbling(middle, 8.0 * kVoxel)}})));
  all.push_back(take("slab-over-groove", inGrid(10.0, 200, 12),
                     sceneOf({mode(ModeKind::kIsosurface, "groove", 20.0),
                              mode(ModeKind::kIsosurface, "slab", 8.0)},
                             {{"groove", grooveGrid(0.3)}, {"slab", hollowCubeGrid(false)}},
                             {{"slab", tumbling(middle, 20.0 * kVoxel)}})));

  const auto inParts = [&](const char* name, const GraphSpec& spec, const Fields& fields, int count,
                           double room) {
    all.push_back(take(name, Wander(Vec3::Zero(), Vec3::Constant(room), 60, 13),
                       makeScene(spec, fields, {}, {}, ballParts(count, room))));
  };
  inParts("parts", {}, {}, 200, 0.1);
  inParts("parts-crowded", {}, {}, 300, 0.02);
  GraphSpec wind;
  wind.modes = {mode(ModeKind::kForce, "flow", 0.4)};
  inParts("parts-in-wind", wind, {{"flow", slantedFlow()}}, 200, 0.05);

  Take faults = skin("faults", ballGrid(14.0), 3.0, 100);
  faults.limits = {5.0, 2000.0};
  faults.event = [](Moment& now) {
    if (now.tick == 600) now.in.hand.position.x() = std::numeric_limits<double>::quiet_NaN();
    now.in.cleared = now.tick == 700 || now.tick == 1300 || now.tick == 1600;
    if (now.tick == 1000) now.scene = kNoScene;
    if (now.tick == 1200) now.in.wrong = Fault::kStale;
    if (now.tick == 1500) now.in.order = Fault::kStopped;
    if (now.tick == 1800) now.in.unsent = Fault::kWrite;
    now.in.given = now.tick % 7 == 0 ? 0.5 : 1.0;
  };
  all.push_back(std::move(faults));
  const FieldPtr ball = ballGrid(14.0);
  Take swaps = take("swaps", inGrid(18.0, 100, 14),
                    sceneOf({mode(ModeKind::kIsosurface, "it", 3.0)}, {{"it", ball}}),
                    sceneOf({mode(ModeKind::kIsosurface, "it", 1.0)}, {{"it", ball}}),
                    sceneOf({mode(ModeKind::kSurface, "it", 2.0, 0.3)}, {{"it", ball}}));
  swaps.limits = {5.0, 2000.0};
  swaps.event = [](Moment& now) { now.scene = static_cast<std::size_t>(now.tick / 250 % 3); };
  all.push_back(std::move(swaps));
  GraphSpec varying;
  varying.modes = {mode(ModeKind::kIsosurface, "ball", 3.0, 0.2)};
  varying.stiffness = TransferSpec(TransferFunction::piecewise({{-0.01, 900}, {0.01, 300}}));
  varying.stiffness->factors[0].by = "ball";
  all.push_back(
      take("stiffness-varies", inRoom(100, 15), makeScene(varying, formulas(), {300.0, 1.0})));
  Take uneven = skin("uneven-ticks", ballGrid(14.0), 3.0, 100, 18.0, 0.3);
  uneven.limits = {5.0, 2000.0};
  uneven.event = [last = Vec3(Vec3::Zero())](Moment& now) mutable {
    constexpr std::array kSpans{1e-3, 0.7e-3, 1.4e-3, 1e-3, 0.0, 3e-3};
    now.in.dt = kSpans[static_cast<std::size_t>(now.tick % 6)];
    now.in.hand.ready = now.tick % 500 < 450;
    // Every third position repeats the previous one.
    if (now.tick % 3 == 1) {
      now.in.hand.position = last;
      now.in.hand.age = 1e-3;
    }
    last = now.in.hand.position;
    now.in.hand.too_fast = now.tick % 400 > 380;
    now.in.hand.velocity = Vec3(0.5, 0.2, 0.0);
    now.in.hand.max_speed = 0.3;
  };
  all.push_back(std::move(uneven));
  return all;
}

/// The 64-bit FNV-1a hash of Fowler, Noll and Vo.
class Hash {
 public:
  void add(std::span<const unsigned char> bytes) {
    for (const unsigned char byte : bytes) hash_ = (hash_ ^ byte) * 1099511628211ULL;
  }
  [[nodiscard]] std::uint64_t value() const { return hash_; }

 private:
  std::uint64_t hash_ = 14695981039346656037ULL;
};

/// Runs a take. Returns its ticks as a recording stores them.
std::vector<RecordedTick> feel(const Take& take) {
  HandTick hand(take.limits);
  std::vector<RecordedTick> rows;
  rows.reserve(kTicks);
  Telemetry told;
  for (int i = 0; i < kTicks; ++i) {
    std::size_t scene = 0;
    told.input = {};
    told.input.hand.position = take.hand(i);
    Moment now{i, told.input, scene};
    if (take.event) take.event(now);
    const Scene* const felt = scene == kNoScene ? nullptr : take.scenes[scene].get();
    told.report = hand.step(felt, told.input);
    hand.withhold(told.input, told.report);
    hand.sent(told.input);
    told.tick = i + 1;
    told.time = 1e-3 * i;
    told.probe = told.input.hand.position;
    told.scene = felt == nullptr ? 0 : scene + 1;  // ids of scenes differ from process to process
    told.fault = hand.state().fault();
    rows.push_back(recordedTick(told));
  }
  return rows;
}

/// The results of a take, in the form that the file stores.
struct Pinned {
  std::string hashes;  ///< Hashes of inputs, outputs and work, and the number of ticks with a
                       ///< force.
  /// Proxy, its error bound, and force of every kEach-th tick.
  std::vector<std::array<double, 7>> places;
};
constexpr std::size_t kEach = 100;
// The file's decimal numbers cause differences of up to these values.
constexpr double kRounded = 1e-9;       // [m]
constexpr double kRoundedForce = 1e-4;  // [N]

Pinned pinned(const std::vector<RecordedTick>& rows) {
  std::array<Hash, 3> hashes;
  long held = 0;
  Pinned out;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const RecordedTick& row = rows[i];
    const auto* bytes = reinterpret_cast<const unsigned char*>(&row);
    for (const RecordedField& field : recordedFields()) {
      const bool work = std::string_view(field.type) == "<i4";
      Hash& hash = hashes[work ? 2 : field.output ? 1 : 0];
      hash.add({bytes + field.offset, sizeOf(field)});
    }
    held += Eigen::Map<const Vec3>(row.wanted.data()).norm() > 0.0 ? 1 : 0;
    if (i % kEach != kEach - 1) continue;
    out.places.push_back({row.proxy[0], row.proxy[1], row.proxy[2], row.error_bound, row.force[0],
                          row.force[1], row.force[2]});
  }
  std::array<char, 128> line{};
  std::snprintf(line.data(), line.size(), "%016llx %016llx %016llx %ld",
                static_cast<unsigned long long>(hashes[0].value()),
                static_cast<unsigned long long>(hashes[1].value()),
                static_cast<unsigned long long>(hashes[2].value()), held);
  out.hashes = line.data();
  return out;
}

/// The differences between two runs of a take, in the stored ticks.
struct Apart {
  std::size_t first = 0;  ///< First stored tick that differs by more than rounding; 0: none.
  double proxy = 0.0;     ///< Largest distance of the proxies [m].
  double beyond = 0.0;    ///< Largest excess of a distance over the sum of both error bounds [m].
  double force = 0.0;     ///< Largest difference of the forces [N].
  bool far = false;       ///< A difference exceeds its limit, or is NaN.
};

Apart apart(const Pinned& a, const Pinned& b) {
  Apart out;
  for (std::size_t i = 0; i < std::min(a.places.size(), b.places.size()); ++i) {
    const Eigen::Map<const Eigen::Matrix<double, 7, 1>> x(a.places[i].data());
    const Eigen::Map<const Eigen::Matrix<double, 7, 1>> y(b.places[i].data());
    const double proxy = (x - y).head<3>().norm();
    const double force = (x - y).tail<3>().norm();
    if (out.first == 0 && (proxy > kRounded || force > kRoundedForce)) out.first = (i + 1) * kEach;
    out.proxy = std::max(out.proxy, proxy);
    out.beyond = std::max(out.beyond, proxy - x[3] - y[3]);
    out.force = std::max(out.force, force);
    // Bounds the change of the force with the proxy [N/m]: couplings have at most 900 N/m, and
    // little damping.
    constexpr double kStiffest = 2000.0;
    const double bounds = x[3] + y[3] + kRounded;
    const bool near = proxy <= bounds && force <= kStiffest * bounds + kRoundedForce;
    out.far = out.far || !near;
  }
  return out;
}

/// Returns the compiler and the machine, which determine the last bits of results.
std::string builder() {
#if defined(__FMA__)
  const char* const machine = "x86-64 with fused multiply-adds";
#elif defined(__x86_64__)
  const char* const machine = "x86-64";
#else
  const char* const machine = "another";
#endif
#ifdef __clang__
  const char* const compiler = "clang ";
#else
  const char* const compiler = "g++ ";
#endif
  return std::string("# ") + compiler + __VERSION__ + ", " + machine;
}

/// Reads a file that --write has written.
std::map<std::string, Pinned> readPinned(std::istream& in) {
  std::map<std::string, Pinned> known;
  std::string line;
  Pinned* last = nullptr;
  while (std::getline(in, line)) {
    if (!line.starts_with(' ')) {
      last = &known[line.substr(0, line.find(' '))];
      last->hashes = line.substr(line.find(' ') + 1);
    } else if (last != nullptr) {
      const char* at = line.c_str();
      for (double& value : last->places.emplace_back()) {
        char* end = nullptr;
        value = std::strtod(at, &end);
        at = end;
      }
    }
  }
  return known;
}

int write(const std::string& file) {
  std::ofstream out(file);
  out << builder() << '\n';
  for (const Take& one : takes()) {
    const Pinned pin = pinned(feel(one));
    out << one.name << ' ' << pin.hashes << '\n';
    for (const auto& place : pin.places) {
      std::array<char, 256> line{};
      std::snprintf(line.data(), line.size(), " %.9g %.9g %.9g %.2g %.6g %.6g %.6g\n", place[0],
                    place[1], place[2], place[3], place[4], place[5], place[6]);
      out << line.data();
    }
  }
  return out.flush() ? 0 : 2;
}

int compare(const std::string& file) {
  std::ifstream in(file);
  std::string line;
  if (!std::getline(in, line)) {
    std::fprintf(stderr, "%s: the file is missing, unreadable or empty\n", file.c_str());
    return 2;
  }
  const bool bits = line == builder();
  if (!bits) std::printf("written by %s; this program: %s\n", line.c_str(), builder().c_str());
  std::map<std::string, Pinned> known = readPinned(in);
  int others = 0;
  int failed = 0;
  const std::vector<Take> all = takes();
  for (const Take& one : all) {
    const Pinned found = pinned(feel(one));
    const Pinned& was = known[one.name];
    if (found.hashes == was.hashes) continue;
    ++others;
    const Apart off = apart(found, was);
    const auto given = [](const Pinned& pin) { return pin.hashes.substr(0, 16); };
    const bool far =
        was.places.size() != found.places.size() || given(was) != given(found) || off.far;
    const bool fails = bits || far;
    failed += fails ? 1 : 0;
    std::printf("%s%s\n  was %s\n  is  %s\n", one.name.c_str(), fails ? "" : " (within bounds)",
                was.hashes.empty() ? "not there" : was.hashes.c_str(), found.hashes.c_str());
    if (off.first > 0) {
      std::printf(
          "  differs from tick %zu on or up to 99 ticks before: proxies by at most %.3g um, and by "
          "at most %.3g um more than both error bounds; forces by at most %.3g N\n",
          off.first, 1e6 * off.proxy, 1e6 * std::max(0.0, off.beyond), off.force);
    }
  }
  std::printf(
      "%zu scenes of %d ticks; %d differ from %s (hashes of inputs, outputs and work; ticks with "
      "a force), %d of them beyond the limits\n",
      all.size(), kTicks, others, file.c_str(), failed);
  if (failed > 0) {
    std::printf(
        "To see the first difference: run palpate_golden_ticks --record NAME FILE before and "
        "after the change, then palpate compare.\n");
  }
  return failed == 0 && known.size() == all.size() ? 0 : 1;
}

int record(const std::string& name, const std::string& file) {
  for (const Take& one : takes()) {
    if (one.name != name) continue;
    RecordedSetting setting;
    setting.device.name = name;
    setting.device.limits = one.limits;
    std::ofstream out(file, std::ios::binary);
    out << recordingHeader(setting) << recordingChunk(feel(one));
    return out.flush() ? 0 : 2;
  }
  std::fprintf(stderr, "there is no golden recording with the name %s\n", name.c_str());
  return 2;
}

int run(const std::vector<std::string>& arguments) {
  if (arguments.size() == 3 && arguments[0] == "--record")
    return record(arguments[1], arguments[2]);
  if (arguments.size() == 2 && arguments[1] == "--write") return write(arguments[0]);
  if (arguments.size() == 1) return compare(arguments[0]);
  std::fprintf(stderr, "usage: palpate_golden_ticks FILE [--write] | --record NAME OUT\n");
  return 2;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run({argv + 1, argv + argc});
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_golden_ticks: %s\n", e.what());
    return 2;
  }
}
