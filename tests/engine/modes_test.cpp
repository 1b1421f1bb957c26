#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/modes/mode.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/formula_fields.h"
#include "tests/support/fresh_hand.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"
#include "tests/support/thinned.h"

namespace palpate::modes_test {
using palpate::test::CountScope;
using palpate::test::Random;

namespace {

constexpr double kDt = 1e-3;
constexpr long kPaths = palpate::test::kSanitized ? 50 : 1000;
constexpr double kStiffness = 500.0;
const ForceLimits kOpen{1e3, 1e12};

/// Returns a dented ball: the distance to a sphere of radius 5 cm plus a wave of 2 mm, with data up
/// to 9 cm from the centre, moved by `pose`.
FieldPtr dentedBall(const Eigen::Isometry3d& pose) {
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-10), Vec3::Constant(10)}, 1.0};
  return makeScalarField(frame, [pose](const Vec3& p_W) {
    const Vec3 p = pose.inverse() * p_W;
    constexpr double kWave = 60.0;
    constexpr double kHeight = 2e-3;
    const double r = p.norm();
    const double sx = std::sin(kWave * p.x());
    const double cx = std::cos(kWave * p.x());
    const double sy = std::sin(kWave * p.y());
    const double cy = std::cos(kWave * p.y());
    const Vec3 slope = kHeight * kWave * Vec3(cx * cy, -sx * sy, 0.0);
    const Vec3 outwards = r > 0.0 ? Vec3(p / r) : Vec3(Vec3::Zero());
    return ScalarSample{r - 0.05 + kHeight * sx * cy, pose.linear() * (outwards + slope), r < 0.09};
  });
}

/// Returns a vortex about an oblique axis, with a flow along the axis and a shear, moved by `pose`.
FieldPtr slantedFlow(const Eigen::Isometry3d& pose) {
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-10), Vec3::Constant(10)}, 0.0};
  Mat3 J;
  J << 0.3, -2.0, 0.4, 2.2, -0.1, -0.5, -0.3, 0.7, -0.2;
  return makeVectorField(frame, [pose, J](const Vec3& p_W) {
    const Vec3 p = pose.inverse() * p_W;
    const Mat3 R = pose.linear();
    return VectorSample{R * (J * p + Vec3(0.02, 0.01, 0.1)), R * J * R.transpose(),
                        p.norm() < 0.09};
  });
}

std::map<std::string, FieldPtr> fields(
    const Eigen::Isometry3d& pose = Eigen::Isometry3d::Identity()) {
  return {{"ball", dentedBall(pose)}, {"flow", slantedFlow(pose)}};
}

/// A user's mode that adds a point at the proxy. Counts its calls.
bool placeDrag(void* state, const ModeInput& input, PrimitiveSet& set) noexcept {
  ++*static_cast<int*>(state);
  const Properties::Scalar& height =
      input.properties.scalars[static_cast<std::size_t>(input.reads[0])];
  const double strength = height.inside ? 0.4 + height.value : 0.0;
  return set.tryAdd({PrimitiveKind::kPoint, input.proxy, Vec3::UnitX(), strength});
}

struct Named {
  const char* name;
  ModeSpec mode;
  bool anchored;  ///< True: anchored at the last tick's proxy, so a single move adds no energy.
};

Named named(const char* name, ModeKind kind, const char* of, double strength, bool anchored) {
  Named out{name, {}, anchored};
  out.mode.kind = kind;
  out.mode.of = of;
  out.mode.strength = strength;
  out.mode.solid = Solid::kBelow;
  return out;
}

/// Returns modes of all kinds except force and user-defined, in variants that place different
/// primitives. `pose` moves the guides.
std::vector<Named> allModes(const Eigen::Isometry3d& pose = Eigen::Isometry3d::Identity()) {
  std::vector<Named> modes;
  modes.push_back(named("viscosity", ModeKind::kViscosity, "ball", 0.3, true));
  modes.push_back(named("surface", ModeKind::kSurface, "ball", 1.5, false));
  modes.push_back(named("surface with friction", ModeKind::kSurface, "ball", 1.5, false));
  modes.back().mode.friction = 0.5;
  modes.back().mode.viscosity = 0.1;
  modes.push_back(named("follow", ModeKind::kFollow, "flow", 0.8, false));
  modes.push_back(named("transverse damping", ModeKind::kTransverseDamping, "flow", 0.2, false));
  modes.push_back(named("front", ModeKind::kFrontShape, "flow", 0.9, true));
  modes.push_back(named("one-sided front", ModeKind::kFrontShape, "flow", 0.9, true));
  modes.back().mode.two_sided = false;
  modes.push_back(named("vortex tube", ModeKind::kVortexTube, "flow", 0.7, true));
  modes.push_back(named("isosurface", ModeKind::kIsosurface, "ball", 2.0, false));
  modes.push_back(named("isosurface with friction", ModeKind::kIsosurface, "ball", 2.0, false));
  modes.back().mode.friction = 0.4;
  modes.back().mode.viscosity = 0.2;
  modes.push_back(named("snap-drag", ModeKind::kFrontShape, "flow", 0.9, false));
  modes.back().mode.snap_voxels = 3.0;
  modes.push_back(named("guide point", ModeKind::kGuide, "", 1.0, false));
  modes.back().mode.guide.position = pose * Vec3(0.03, 0.01, 0.0);
  modes.back().mode.guide.snap = 0.02;
  modes.push_back(named("guide line", ModeKind::kGuide, "", 1.0, false));
  modes.back().mode.guide = {PrimitiveKind::kLine, pose * Vec3(0.02, 0.0, 0.01),
                             pose.linear() * Vec3(0.0, 0.6, 0.8), 0.02};
  modes.back().mode.strength = TransferFunction::piecewise({{0, 0}, {0.01, 2}});
  modes.push_back(named("guide plane", ModeKind::kGuide, "", 1.2, false));
  modes.back().mode.guide = {PrimitiveKind::kPlane, pose * Vec3(0.0, 0.0, 0.02),
                             pose.linear() * Vec3(0.6, 0.0, 0.8), 0.03};
  return modes;
}

std::unique_ptr<const Scene> sceneOf(const std::vector<ModeSpec>& modes,
                                     const std::map<std::string, FieldPtr>& at = fields(),
                                     const CouplingParams& coupling = {kStiffness, 0.0}) {
  GraphSpec spec;
  spec.modes = modes;
  return makeScene(spec, at, coupling);
}

/// Returns a motion that rotates and translates back and forth in 0.4 s times `slower`.
MotionPtr tumbling(double slower = 1.0) {
  std::vector<Keyframe> keys(5);
  const std::array<Vec3, 3> turns{Vec3(0.2, 0.1, -0.15), Vec3(0.1, 0.3, 0.1), Vec3(-0.1, 0.1, 0.2)};
  const std::array<Vec3, 3> ways{Vec3(0.01, 0, 0), Vec3(0.01, -0.01, 0), Vec3(0, 0, 0.01)};
  for (std::size_t i = 0; i < 5; ++i) {
    keys[i].time = 0.1 * slower * static_cast<double>(i);
    if (i == 0 || i == 4) continue;
    const Eigen::Quaterniond q(Eigen::AngleAxisd(turns[i - 1].norm(), turns[i - 1].normalized()));
    keys[i].rotation_wxyz = {q.w(), q.x(), q.y(), q.z()};
    keys[i].translate = ways[i - 1];
  }
  return std::make_shared<const Motion>(keys, true);
}

/// A shear wave with a wavelength of 0.04 m, a height of 2 mm and a frequency of 10 Hz / `slower`.
class Bend final : public Warp {
 public:
  explicit Bend(double slower) : slower_(slower) {}
  [[nodiscard]] Displacement at(const Vec3& x, double time) const noexcept override {
    const Vec3 along(0.6, 0.64, 0.48);
    const Vec3 aside = Vec3(-0.64, 0.6, 0.0).normalized();
    constexpr double kHeight = 2e-3;
    constexpr double kWave = 2.0 * std::numbers::pi / 0.04;
    const double rate = 20.0 * std::numbers::pi / slower_;
    const double phase = kWave * along.dot(x) - rate * time;
    Displacement u;
    u.shift = kHeight * std::sin(phase) * aside;
    u.slope = kHeight * kWave * std::cos(phase) * aside * along.transpose();
    u.rate = -kHeight * rate * std::cos(phase) * aside;
    return u;
  }
  [[nodiscard]] Box shifts() const override {
    return {Vec3::Constant(-2e-3), Vec3::Constant(2e-3)};
  }
  [[nodiscard]] double topSpeed() const override { return 0.2; }

 private:
  double slower_;
};

/// Returns a motion that translates back and forth in 0.4 s times `slower`, with a warp.
MotionPtr bending(double slower = 1.0) {
  std::vector<Keyframe> keys(3);
  keys[1].time = 0.2 * slower;
  keys[1].translate = Vec3(0.01, 0.0, -0.01);
  keys[2].time = 0.4 * slower;
  return std::make_shared<const Motion>(keys, true, "/keyframes", std::make_shared<Bend>(slower));
}

/// Removes guides, because guides cannot follow volumes that deform. If no mode is left, adds a
/// surface with friction.
std::vector<ModeSpec> guidelessOf(std::vector<ModeSpec> modes) {
  std::erase_if(modes, [](const ModeSpec& mode) { return mode.kind == ModeKind::kGuide; });
  if (modes.empty()) modes.push_back(allModes()[2].mode);
  return modes;
}

/// Builds a scene with a ball that moves. Guides move with it, and so does the flow unless
/// `of_flow` is given.
std::unique_ptr<const Scene> movingScene(std::vector<ModeSpec> modes, const MotionPtr& motion,
                                         const MotionPtr& of_flow = nullptr) {
  GraphSpec spec;
  for (ModeSpec& mode : modes) {
    if (mode.kind == ModeKind::kGuide) mode.in = "ball";
  }
  spec.modes = std::move(modes);
  spec.motions = {{"ball", motion}, {"flow", of_flow == nullptr ? motion : of_flow}};
  return makeScene(spec, fields(), {kStiffness, 0.0});
}

/// A closed path with three harmonics per axis. Its centre is 5 cm from the origin, near the ball's
/// surface.
class ClosedPath {
 public:
  ClosedPath(Random& random, int ticks) : centre_(0.05 * random.direction()), ticks_(ticks) {
    for (Vec3& a : height_) a = random.inCube(0.01);
    for (Vec3& a : phase_) a = random.inCube(std::numbers::pi);
  }
  [[nodiscard]] int ticks() const { return ticks_; }
  [[nodiscard]] Vec3 operator()(int tick) const {
    const double t = 2.0 * std::numbers::pi * (tick % ticks_) / ticks_;
    Vec3 x = centre_;
    for (std::size_t j = 0; j < 3; ++j) {
      for (int a = 0; a < 3; ++a) {
        x[a] += height_[j][a] * std::sin(static_cast<double>(j + 1) * t + phase_[j][a]);
      }
    }
    return x;
  }

 private:
  Vec3 centre_;
  int ticks_;
  std::array<Vec3, 3> height_;
  std::array<Vec3, 3> phase_;
};

/// Moves one hand along a path, and calls `after` after every tick.
template <class After>
void feel(const Scene& scene, const ClosedPath& path, After after) {
  static test::FreshHand fresh(kOpen);
  fresh.restart();
  for (int i = 0; i <= path.ticks(); ++i) {
    const Vec3 hand = path(i);
    const StepReport report = hapticStep(scene, fresh.reader, {hand}, fresh.state, kDt);
    after(i, hand, report, std::as_const(fresh.state));
  }
}

/// Returns the primitives that a mode places if proxy and probe are both at p.
std::vector<Primitive> placed(const ModeSpec& mode, const Vec3& p) {
  const auto scene = sceneOf({mode});
  Reader reader;
  ProxyState state(kOpen);
  (void)hapticStep(*scene, reader, {p}, state, kDt);
  return {state.primitives().items().begin(), state.primitives().items().end()};
}

}  // namespace

TEST_CASE("fronts, tubes, dampings, surfaces and guides place the documented primitives",
          "[modes]") {
  const Vec3 p(0.02, 0.01, 0.03);
  const auto all = fields();
  FieldCache cache;
  const VectorSample flow = std::get<1>(all.at("flow"))->sample(p, cache);
  const Vec3 along = flow.value.normalized();
  const Vec3 core = curl(flow.jacobian).normalized();
  const auto modes = allModes();
  const auto of = [&](const char* name) {
    for (const Named& mode : modes) {
      if (std::strcmp(mode.name, name) == 0) return placed(mode.mode, p);
    }
    FAIL("no mode " << name);
    return std::vector<Primitive>{};
  };
  const auto isA = [](const Primitive& it, PrimitiveKind kind, const Vec3& at, const Vec3& q,
                      double strength) {
    return it.kind == kind && (it.position - at).norm() < 1e-15 &&
           (kind == PrimitiveKind::kPoint || (it.direction - q).norm() < 1e-14) &&
           it.strength == Approx(strength).margin(1e-12);
  };

  const auto front = of("front");
  REQUIRE(front.size() == 2);
  CHECK(isA(front[0], PrimitiveKind::kPlane, p, along, 0.9));
  CHECK(isA(front[1], PrimitiveKind::kPlane, p, -along, 0.9));
  const auto one_sided = of("one-sided front");
  REQUIRE(one_sided.size() == 1);
  CHECK(isA(one_sided[0], PrimitiveKind::kPlane, p, along, 0.9));

  const auto tube = of("vortex tube");
  const Vec3 radial = flow.value.cross(core).normalized();
  REQUIRE(tube.size() == 2);
  CHECK(isA(tube[0], PrimitiveKind::kPlane, p, radial, 0.7));
  CHECK(isA(tube[1], PrimitiveKind::kPlane, p, -radial, 0.7));

  const auto damping = of("transverse damping");
  REQUIRE(damping.size() == 1);
  CHECK(isA(damping[0], PrimitiveKind::kLine, p, along, 0.2));

  const auto rough = of("surface with friction");
  REQUIRE(rough.size() == 3);
  CHECK(isA(rough[0], PrimitiveKind::kPlane, p, rough[0].direction, 1.5));
  CHECK(isA(rough[1], PrimitiveKind::kLine, p, rough[0].direction, 0.0));
  CHECK(isA(rough[2], PrimitiveKind::kPoint, p, {}, 0.1));

  // Inside the solid, an isosurface places only its viscosity.
  const auto inside = of("isosurface with friction");
  REQUIRE(inside.size() == 1);
  CHECK(isA(inside[0], PrimitiveKind::kPoint, p, {}, 0.2));

  const auto guide = of("guide point");
  REQUIRE(guide.empty());  // 3.2 cm away, more than its snap distance
  ModeSpec near;
  near.kind = ModeKind::kGuide;
  near.guide = {PrimitiveKind::kLine, p + Vec3(0.0, 3e-3, 0.0), Vec3(0.0, 0.0, 2.0), 4e-3};
  near.strength = TransferFunction::piecewise({{0, 0}, {0.01, 2}});
  const auto line = placed(near, p);
  REQUIRE(line.size() == 1);
  CHECK(isA(line[0], PrimitiveKind::kLine, p + Vec3(0.0, 3e-3, 0.0), Vec3::UnitZ(), 0.6));
  // The guide's strength curve uses the units of the guide's volume.
  near.guide.metres_per_unit = 0.5;
  REQUIRE(placed(near, p).size() == 1);
  CHECK(placed(near, p)[0].strength == Approx(1.2));
  near.guide.metres_per_unit = 1.0;
  // A plane guide holds a proxy in front of the plane at any distance. It releases a proxy that is
  // more than the snap distance behind the plane.
  near.guide.shape = PrimitiveKind::kPlane;
  near.guide.direction = Vec3::UnitY();
  const auto wall = placed(near, p);
  REQUIRE(wall.size() == 1);
  CHECK(isA(wall[0], PrimitiveKind::kPlane, p + Vec3(0.0, 3e-3, 0.0), Vec3::UnitY(), 0.6));
  near.strength = 1.5;
  CHECK(placed(near, p + Vec3(0.0, 0.02, 0.0)).size() == 1);
  CHECK(placed(near, p - Vec3(0.0, 2e-3, 0.0)).empty());
}

TEST_CASE("a guide releases the hand when the proxy and not the hand is at the snap distance",
          "[modes]") {
  ModeSpec guide;
  guide.kind = ModeKind::kGuide;
  guide.guide = {PrimitiveKind::kPoint, Vec3(0.1, 0, 0), Vec3::UnitX(), 4e-3};
  guide.strength = 2.0;
  const auto scene = sceneOf({guide});
  Reader reader;
  ProxyState state(kOpen);
  double held = 0.0;
  for (int i = 0; i <= 100; ++i) {
    const Vec3 hand(0.1 + 1e-4 * i, 0, 0);
    const StepReport r = hapticStep(*scene, reader, {hand}, state, kDt);
    if (r.wanted.norm() > 1e-9) held = hand.x() - 0.1;
  }
  // At the release, the hand is s/k (4 mm) from the proxy, and the proxy is 4 mm from the point.
  CHECK(held == Approx(8e-3).margin(2e-4));
}

TEST_CASE("a vortex tube holds the proxy on the core or at a constant radius around the core",
          "[modes]") {
  const Vec3 axis = Vec3(1, 2, 2) / 3.0;
  const std::map<std::string, FieldPtr> at{
      {"flow", makeVortex(Vec3::Zero(), 3.0 * axis, 0.2, 0.1)}};
  ModeSpec tube;
  tube.kind = ModeKind::kVortexTube;
  tube.of = "flow";
  tube.strength = TransferFunction::piecewise({{0, 0}, {6, 3}});  // at |curl v| = 6: 3 N
  const auto scene = sceneOf({tube}, at);
  const Vec3 out = axis.cross(Vec3::UnitX()).normalized();
  const Vec3 round = axis.cross(out);
  Reader reader;
  ProxyState state(kOpen);
  const auto step = [&](const Vec3& hand) {
    return hapticStep(*scene, reader, {hand}, state, kDt);
  };
  // The proxy is at a radius of 2 cm and the hand 1 mm farther out. The tube holds the proxy
  // against the spring's 0.5 N. Motion along and around the tube is free.
  const Vec3 start = 0.02 * out + 0.01 * axis;
  (void)step(start);
  CHECK((step(start + 1e-3 * out).wanted + 0.5 * out).norm() < 1e-9);
  CHECK((step(start + 1e-3 * out + 5e-4 * axis).wanted + 0.5 * out).norm() < 1e-9);
  for (int i = 1; i <= 400; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / 400.0;
    step(0.021 * (std::cos(angle) * out + std::sin(angle) * round) + 0.0105 * axis);
  }
  // The plane is tangent to the tube, so a step of length h drifts outwards by h^2 / (2 r): 2 um
  // for h = 0.3 mm and r = 2 cm.
  const double radius = (state.proxy() - state.proxy().dot(axis) * axis).norm();
  CHECK(radius > 0.0199);
  CHECK(radius < 0.0211);
  state.clearFault();
  (void)step(0.02 * axis);
  REQUIRE(state.primitives().size() == 1);
  CHECK(state.primitives().items()[0].kind == PrimitiveKind::kLine);
  CHECK((step(0.02 * axis + 1e-3 * round + 1e-3 * axis).wanted + 0.5 * round).norm() < 1e-9);
  // At 1.25 voxels from the core, the line has three quarters of its strength.
  state.clearFault();
  (void)step(0.02 * axis + 1.25e-3 * out);
  REQUIRE(state.primitives().size() == 3);
  CHECK(state.primitives().items()[0].strength == Approx(2.25));
  CHECK(state.primitives().items()[1].strength == Approx(0.75));
}

TEST_CASE("a vortex tube's force is continuous at its core and rounding errors cause no force",
          "[modes]") {
  const std::map<std::string, FieldPtr> at{{"flow", makeVortex(Vec3::Zero(), {0, 0, 3}, 0.2, 0.1)}};
  ModeSpec tube;
  tube.kind = ModeKind::kVortexTube;
  tube.of = "flow";
  tube.strength = 1.0;
  const auto scene = sceneOf({tube}, at);
  Reader reader;
  ProxyState state(kOpen);
  Vec3 last = Vec3::Zero();
  double worst = 0.0;
  constexpr double kStep = 5e-5;
  for (int i = 0; i <= 2000; ++i) {
    // The hand moves outwards on a spiral, so that it always pulls the proxy.
    const double r = 6e-3 * i / 2000.0;
    const Vec3 hand(r * std::cos(kStep * i / std::max(r, 1e-3)),
                    r * std::sin(kStep * i / std::max(r, 1e-3)), 0.01);
    const Vec3 force = hapticStep(*scene, reader, {hand}, state, kDt).wanted;
    if (i > 0) worst = std::max(worst, (force - last).norm());
    last = force;
  }
  CHECK(worst < 4.0 * kStiffness * kStep);

  // A uniform flow plus a Jacobian that imitates rounding to floats.
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}, 0.0};
  const std::map<std::string, FieldPtr> noise{{"flow", makeVectorField(frame, [](const Vec3& p) {
                                                 Mat3 J = Mat3::Zero();
                                                 J(0, 1) = 6e-5 * std::sin(1e4 * p.x());
                                                 return VectorSample{Vec3::UnitX(), J, true};
                                               })}};
  const auto calm = sceneOf({tube}, noise);
  ProxyState other(kOpen);
  for (int i = 0; i < 100; ++i) {
    const Vec3 hand(1e-4 * i, 2e-4 * i, 0);
    REQUIRE(hapticStep(*calm, reader, {hand}, other, kDt).wanted.norm() <= 1e-12);
  }
}

TEST_CASE("a front with snap-drag releases the proxy at even distances in both directions",
          "[modes]") {
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}, 0.0};
  const std::map<std::string, FieldPtr> at{
      {"flow", makeVectorField(frame, [](const Vec3&) {
         return VectorSample{Vec3::UnitZ(), Mat3::Zero(), true};
       })}};
  ModeSpec front;
  front.kind = ModeKind::kFrontShape;
  front.of = "flow";
  front.strength = 1.0;
  const double way = GENERATE(1.0, -1.0);
  CAPTURE(way);
  const auto drops = [&](double snap) {
    front.snap_voxels = snap;
    const auto scene = sceneOf({front}, at);
    Reader reader;
    ProxyState state(kOpen);
    std::vector<double> where;
    double last = 0.0;
    for (int i = 0; i <= 3000; ++i) {
      const Vec3 hand(0, 0, way * 1e-5 * i);
      const double force = hapticStep(*scene, reader, {hand}, state, kDt).wanted.norm();
      if (last - force > 0.5) where.push_back(way * hand.z());
      last = force;
    }
    CHECK(last > 0.9);
    return where;
  };
  CHECK(drops(0.0).empty());  // without snap-drag, the force never drops
  // A front holds the proxy until the spring is 2 mm long (s/k). The next front is 4 voxels (4 mm)
  // farther along the hand's path, so the releases are 6 mm apart.
  const std::vector<double> fronts = drops(4.0);
  REQUIRE(fronts.size() == 4);  // on a path of 30 mm
  for (std::size_t i = 1; i < fronts.size(); ++i) {
    CHECK(fronts[i] - fronts[i - 1] == Approx(6e-3).margin(2e-4));
  }
}

TEST_CASE("an isosurface with viscosity but without strength drags everywhere in its solid",
          "[modes]") {
  // The plate is 2 mm thick, so the whole plate is within reach of its surfaces.
  const FieldFrame frame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}, 1.0};
  const std::map<std::string, FieldPtr> at{
      {"plate", makeScalarField(frame, [](const Vec3& p) {
         const double side = p.z() < 0.0 ? -1.0 : 1.0;
         return ScalarSample{std::abs(p.z()) - 1e-3, Vec3(0, 0, side), true};
       })}};
  ModeSpec jelly;
  jelly.kind = ModeKind::kIsosurface;
  jelly.of = "plate";
  jelly.solid = Solid::kBelow;
  jelly.viscosity = 0.2;
  const auto scene = sceneOf({jelly}, at);
  Reader reader;
  ProxyState state(kOpen);
  int dragged = 0;
  for (int i = 0; i <= 400; ++i) {
    const Vec3 hand(0, 0, 2e-3 - 1e-5 * i);
    dragged += static_cast<int>(hapticStep(*scene, reader, {hand}, state, kDt).wanted.norm() > 0.1);
  }
  CHECK(dragged > 150);
  CHECK(dragged < 250);
}

TEST_CASE("a user-defined mode receives its state and fields and its primitives act on the hand",
          "[modes]") {
  auto count = std::make_shared<int>(0);
  ModeSpec own;
  own.kind = ModeKind::kUser;
  own.user = {&placeDrag, count, {"ball", "flow"}};
  const auto scene = sceneOf({own});
  Reader reader;
  ProxyState state(kOpen);
  const Vec3 p(0.05, 0.0, 0.0);
  const StepReport first = hapticStep(*scene, reader, {p}, state, kDt);
  const int before = *count;
  const StepReport pulled = hapticStep(*scene, reader, {p + Vec3(0, 0, 1.2e-3)}, state, kDt);
  // The first tick reads at the proxy, then where the balance led the proxy. Each tick balances
  // once with the known primitives, and once per reading.
  CHECK(first.samples == 4);
  CHECK(pulled.samples == 2 * pulled.substeps);
  CHECK(*count - before == 1 + pulled.substeps);
  // At 5 cm, the wave's height is 2 mm sin(3). The pull is 0.4 N plus this height times 1 N/m. The
  // position of the reading changes the pull by up to 1e-5 of its value.
  CHECK(pulled.wanted.norm() == Approx(0.4 + 2e-3 * std::sin(3.0)).epsilon(1e-5));
  own.user.place = nullptr;
  CHECK_THROWS_WITH(sceneOf({own}), Catch::Contains("/modes/0"));
  own.user = {&placeDrag, count, {"bell"}};
  CHECK_THROWS_WITH(sceneOf({own}), Catch::Contains("/modes/0/user/reads") &&
                                        Catch::Contains("did you mean \"ball\""));
}

TEST_CASE("pairs and triples of modes balance as the reference solver does",
          "[modes][eq14][eq15][release]") {
  const std::vector<Named> modes = allModes();
  Random random(71);
  long compared = 0;
  long ticks = 0;
  long limited = 0;
  const auto compare = [&](const std::vector<std::size_t>& which) {
    std::vector<ModeSpec> specs;
    std::string names;
    for (const std::size_t i : which) {
      specs.push_back(modes[i].mode);
      names += std::string(names.empty() ? "" : ", ") + modes[i].name;
    }
    CAPTURE(names);
    const auto scene = sceneOf(specs);
    const ClosedPath path(random, 400);
    const int chosen = 1 + random.integer(399);
    feel(*scene, path,
         [&](int tick, const Vec3& hand, const StepReport& report, const ProxyState& state) {
           REQUIRE(report.status <= StepStatus::kIterationLimit);
           ++ticks;
           limited += static_cast<long>(report.status == StepStatus::kIterationLimit);
           if (tick != chosen || report.status == StepStatus::kSubstepLimit) return;
           const auto items = state.primitives().items();
           const test::Reference reference =
               test::solveReference(hand + report.waiting, kStiffness, items);
           const Vec3 offset = report.wanted / kStiffness - report.waiting;
           // For planes alone, the result is Newton's target, which is within `apart` of the
           // balance of the last reading.
           const bool planes = std::all_of(items.begin(), items.end(), [](const Primitive& one) {
             return one.kind == PrimitiveKind::kPlane;
           });
           const auto& voxels = scene->graph.mode_voxels;
           const double apart = planes ? scene->step.tolerance_voxels *
                                             *std::min_element(voxels.begin(), voxels.end())
                                       : 0.0;
           REQUIRE((offset - reference.offset).norm() <=
                   report.error_bound + reference.error_bound + apart + 1e-17);
           compared += static_cast<long>(!items.empty());
         });
  };
  test::Thinned triples(4);
  for (std::size_t a = 0; a < modes.size(); ++a) {
    for (std::size_t b = a + 1; b < modes.size(); ++b) {
      compare({a, b});
      for (std::size_t c = b + 1; c < modes.size(); ++c) {
        if (triples.runs()) compare({a, b, c});
      }
    }
  }
  // There are 455 sets, or 182 with sanitizers. Some of them place no primitive in the chosen tick.
  CHECK(compared > (test::kSanitized ? 150 : 400));
  // If two planes with friction coincide, rounding decides how the planes share the load. Such
  // ticks may reach the iteration limit.
  CAPTURE(ticks, limited);
  CHECK(limited <= 20);
}

TEST_CASE("a mode of zero strength does not change the result, bit for bit", "[modes]") {
  const std::vector<Named> modes = allModes();
  Random random(72);
  const ModeSpec base = modes[9].mode;  // isosurface with friction
  for (const Named& mode : modes) {
    CAPTURE(mode.name);
    const std::uint64_t seed = 1000 + static_cast<std::uint64_t>(random.integer(1000));
    const auto forces = [&](const std::vector<ModeSpec>& specs) {
      Random own(seed);
      std::vector<double> out;
      int samples = 0;  // counts ticks with primitives only: a free tick may need no sample
      feel(*sceneOf(specs), ClosedPath(own, 400),
           [&](int, const Vec3&, const StepReport& r, const ProxyState&) {
             out.insert(out.end(), {r.force.x(), r.force.y(), r.force.z(), r.error_bound});
             if (r.primitives > 0) samples += r.samples;
           });
      return std::pair(out, samples);
    };
    ModeSpec zero = mode.mode;
    zero.strength = 0.0;
    zero.viscosity = 0.0;
    const auto alone = forces({base});
    CHECK(forces({base, zero}) == alone);
    CHECK(forces({zero, base}) == alone);
    // This strength curve is zero at all positions of the path. The base mode reads the same field.
    if (mode.mode.of == base.of) {
      zero.strength = TransferFunction::piecewise({{10.0, 0.0}, {20.0, 1.0}});
      CHECK(forces({base, zero}) == alone);
    }
  }
}

TEST_CASE("rotating and moving scene and hand together rotates the force in the same way",
          "[modes]") {
  Random random(73);
  for (std::size_t i = 0; i < allModes().size(); ++i) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = Eigen::AngleAxisd(random.uniform(0.1, 3.0), random.direction()).matrix();
    pose.translation() = random.inCube(0.5);
    // A second mode, a surface, gives each balance more than one primitive.
    const std::vector<Named> still = allModes();
    const std::vector<Named> moved = allModes(pose);
    CAPTURE(still[i].name);
    Scene scene = *sceneOf({still[i].mode, still[1].mode});
    Scene turned = *sceneOf({moved[i].mode, moved[1].mode}, fields(pose));
    // The tolerance of the balance limits the precision of the loads, and so that of the friction.
    const bool rough = still[i].mode.friction.highest() > 0.0;
    if (rough) scene.solver.tolerance = turned.solver.tolerance = 1e-9;
    const ClosedPath path(random, 400);
    Reader reader;
    Reader other_reader;
    ProxyState state(kOpen);
    ProxyState other_state(kOpen);
    double worst = 0.0;
    double largest = 1.0;
    for (int tick = 0; tick <= path.ticks(); ++tick) {
      const Vec3 hand = path(tick);
      const Vec3 force = hapticStep(scene, reader, {hand}, state, kDt).wanted;
      const Vec3 other = hapticStep(turned, other_reader, {pose * hand}, other_state, kDt).wanted;
      worst = std::max(worst, (pose.linear() * force - other).norm());
      largest = std::max(largest, force.norm());
    }
    CHECK(worst <= (rough ? 1e-8 : 1e-9) * largest);
  }
}

TEST_CASE("a hand that moves with its scene has the same forces as at rest", "[modes][moving]") {
  Random random(78);
  const MotionPtr motion = tumbling();
  for (std::size_t i = 0; i < allModes().size(); ++i) {
    const std::vector<Named> still = allModes();
    CAPTURE(still[i].name);
    // In a moving volume, the sub-steps are at other positions. If two surfaces coincided, an
    // offset of micrometres would decide which surface bears the load. So this test combines a
    // surface with friction with a front instead.
    const bool rough = still[i].mode.friction.highest() > 0.0;
    const ModeSpec& beside = still[rough ? 5 : 1].mode;
    Scene scene = *sceneOf({still[i].mode, beside});
    Scene moving = *movingScene({still[i].mode, beside}, motion);
    if (rough) scene.solver.tolerance = moving.solver.tolerance = 1e-9;
    const ClosedPath path(random, 400);
    Reader reader;
    Reader other_reader;
    ProxyState state(kOpen);
    ProxyState other_state(kOpen);
    double worst = 0.0;
    double largest = 1.0;
    double time = 0.0;
    for (int tick = 0; tick <= path.ticks(); ++tick) {
      const Vec3 hand = path(tick);
      const Pose pose = motion->poseAt(time);
      time += kDt;
      const Vec3 force = hapticStep(scene, reader, {hand}, state, kDt).wanted;
      const Vec3 other = hapticStep(moving, other_reader, {pose(hand)}, other_state, kDt).wanted;
      worst = std::max(worst, (pose.linear * force - other).norm());
      largest = std::max(largest, force.norm());
    }
    // Friction depends on how the planes share the load. The loads are only as precise as the
    // balance.
    CHECK(worst <= (rough ? 1e-8 : 1e-9) * largest);
  }
}

TEST_CASE("a motion that stands still does not change the forces, bit for bit", "[modes][moving]") {
  const MotionPtr rest = std::make_shared<const Motion>(std::vector<Keyframe>(1));
  for (const Named& mode : allModes()) {
    CAPTURE(mode.name);
    const auto forces = [&](const Scene& scene) {
      Random random(79);
      std::vector<double> out;
      feel(scene, ClosedPath(random, 400),
           [&](int, const Vec3&, const StepReport& r, const ProxyState&) {
             // A free tick among volumes at rest needs no reading.
             const int readings = r.primitives > 0 ? r.substeps : 0;
             out.insert(out.end(), {r.force.x(), r.force.y(), r.force.z(), r.error_bound,
                                    static_cast<double>(readings), r.injected});
           });
      return out;
    };
    CHECK(forces(*sceneOf({mode.mode})) == forces(*movingScene({mode.mode}, rest)));
  }
}

TEST_CASE("among moving volumes the hand gains at most the reported energy plus that of sampling",
          "[modes][moving][passivity][realtime][release]") {
  std::vector<std::vector<ModeSpec>> sets;
  for (const Named& mode : allModes()) sets.push_back({mode.mode});
  std::vector<ModeSpec> all;
  for (const Named& mode : allModes()) all.push_back(mode.mode);
  sets.push_back(all);
  Random random(80);
  double injected_sum = 0.0;
  const long paths = test::cases(kPaths / 50);
  for (const auto& set : sets) {
    // The volumes move together, independently, or also bend.
    for (const int how : {0, 1, 2}) {
      const auto scene = how == 2
                             ? movingScene(guidelessOf(set), bending(), bending(2.0))
                             : movingScene(set, tumbling(), how == 1 ? tumbling(2.0) : nullptr);
      test::FreshHand fresh(kOpen);
      Reader& reader = fresh.reader;
      ProxyState& state = fresh.state;
      for (long i = 0; i < paths; ++i) {
        const ClosedPath path(random, static_cast<int>(random.logUniform(150.0, 3000.0)));
        fresh.restart();
        double work = 0.0;
        double injected = 0.0;
        bool fault = false;
        Vec3 last = path(0);
        Vec3 force = Vec3::Zero();
        const CountScope scope;
        for (int tick = 0; tick <= path.ticks(); ++tick) {
          const Vec3 hand = path(tick);
          const StepReport r = hapticStep(*scene, reader, {hand}, state, kDt);
          // The last force acted along the hand's path dh to this position. Sampling alone adds up
          // to k/2 |dh|^2, which is not counted.
          work += force.dot(hand - last) - 0.5 * kStiffness * (hand - last).squaredNorm();
          force = r.wanted;
          injected += r.injected;
          fault = fault || r.status == StepStatus::kFault;
          last = hand;
        }
        const auto counts = CountScope::counts();
        REQUIRE(counts.allocations == 0);
        REQUIRE(counts.locks == 0);
        REQUIRE_FALSE(fault);
        REQUIRE(work <= injected + 1e-12);
        injected_sum += injected;
      }
    }
  }
  CHECK(injected_sum > 0.0);
}

TEST_CASE("on a closed path the hand gains at most the energy that the ticks count as injected",
          "[modes][passivity][release]") {
  std::vector<std::vector<Named>> sets;
  for (const Named& mode : allModes()) sets.push_back({mode});
  constexpr double kVoxel = 1e-3;
  const auto all = allModes();
  sets.push_back({all[2], all[3], all[7]});   // surface with friction, follow, vortex tube
  sets.push_back({all[9], all[3], all[10]});  // isosurface with friction, follow, snap-drag
  for (const auto& set : sets) {
    std::vector<ModeSpec> specs;
    bool anchored = true;
    std::string names;
    for (const Named& mode : set) {
      specs.push_back(mode.mode);
      anchored = anchored && mode.anchored;
      names += std::string(" ") + mode.name;
    }
    CAPTURE(names);
    const auto scene = sceneOf(specs);
    Random random(74);
    // Enough paths to find every set that injects energy.
    const long paths = std::max(test::cases(kPaths), test::kSanitized ? 10L : 50L);
    double injected_sum = 0.0;
    for (long i = 0; i < paths; ++i) {
      // Top speeds are about 0.05 to 2 m/s.
      const ClosedPath path(random, static_cast<int>(random.logUniform(150.0, 3000.0)));
      double work = 0.0;
      double injected = 0.0;
      double most_of_one = 0.0;
      double most_of_several = 0.0;
      Vec3 last = path(0);
      Vec3 proxy = last;
      feel(*scene, path, [&](int, const Vec3& hand, const StepReport& r, const ProxyState&) {
        work += r.wanted.dot(hand - last);
        injected += r.injected;
        // A tick takes several moves if the hand is more than a voxel from the proxy.
        double& most = (hand - proxy).norm() > kVoxel ? most_of_several : most_of_one;
        proxy = r.proxy;
        most = std::max(most, r.injected);
        last = hand;
      });
      REQUIRE(work <= injected + 1e-12);
      if (anchored) REQUIRE(most_of_one <= 1e-12);
      if (anchored) REQUIRE(most_of_several <= 5e-4);
      injected_sum += injected;
    }
    CHECK((anchored || injected_sum > 0.0 || test::kSanitized));
  }
}

TEST_CASE("a released hand ends at zero force", "[modes][passivity]") {
  Random random(75);
  test::FreshHand fresh(kOpen);
  Reader& reader = fresh.reader;
  ProxyState& state = fresh.state;
  const int hands = test::kSanitized ? 4 : 20;
  for (const Named& mode : allModes()) {
    CAPTURE(mode.name);
    const auto scene = sceneOf({mode.mode});
    for (int i = 0; i < hands; ++i) {
      // The hand moves, then lets go. The released arm is a mass with friction.
      const ClosedPath path(random, 300);
      fresh.restart();
      Vec3 x = path(0);
      for (int tick = 0; tick <= 150; ++tick) {
        x = path(tick);
        (void)hapticStep(*scene, reader, {x}, state, kDt);
      }
      Vec3 v = Vec3::Zero();
      Vec3 force = Vec3::Zero();
      for (int tick = 0; tick < 3000; ++tick) {
        force = hapticStep(*scene, reader, {x}, state, kDt).wanted;
        constexpr double kMass = 0.1;
        constexpr double kViscous = 4.0;
        v += kDt / kMass * (force - kViscous * v);
        x += kDt * v;
      }
      REQUIRE(force.norm() <= 1e-6);
    }
  }
}

TEST_CASE("volumes that no mode needs are not read, and orthogonal sets are solved in closed form",
          "[modes][graph]") {
  const auto box = [](const Vec3& centre, double half) {
    return FieldFrame{1e-3, 1.0, {centre - Vec3::Constant(half), centre + Vec3::Constant(half)}, 1};
  };
  const auto scalar = [&](const Vec3& centre, double half) -> FieldPtr {
    return makeScalarField(box(centre, half), [centre](const Vec3& p) {
      return ScalarSample{(p - centre).z(), Vec3::UnitZ(), true};
    });
  };
  const FieldPtr wind = makeVectorField(box(Vec3::Zero(), 0.05), [](const Vec3&) {
    return VectorSample{Vec3::UnitX(), Mat3::Identity(), true};
  });
  const std::map<std::string, FieldPtr> at{
      {"a", scalar(Vec3::Zero(), 0.05)},        {"b", scalar({0.06, 0, 0}, 0.05)},
      {"pressure", scalar(Vec3::Zero(), 0.05)}, {"wind", wind},
      {"far", scalar({1, 0, 0}, 0.05)},         {"unread", scalar(Vec3::Zero(), 0.05)}};
  const auto make = [](ModeKind kind, const char* of) {
    ModeSpec mode;
    mode.kind = kind;
    mode.of = of;
    mode.solid = Solid::kBelow;
    mode.strength = 1.0;
    return mode;
  };
  GraphSpec spec;
  spec.fields = {{"speed", {Derivation::kMagnitude, "wind"}}};
  spec.modes = {make(ModeKind::kSurface, "a"), make(ModeKind::kIsosurface, "b"),
                make(ModeKind::kFollow, "wind"), make(ModeKind::kViscosity, "far"),
                make(ModeKind::kViscosity, "unread")};
  spec.modes[0].friction = 0.3;
  spec.modes[2].strength = TransferFunction::piecewise({{-1, 1}, {1, 1}});
  spec.modes[2].by = "pressure";
  spec.modes[4].strength = 0.0;
  const auto scene = makeScene(spec, at, {kStiffness, 0.0});
  CHECK(scene->graph.unused == std::vector<std::string>{"unread", "speed"});
  CHECK(scene->graph.silent == std::vector<std::string>{"/modes/4"});
  const auto countAt = [&](const Vec3& p) {
    Reader reader;
    ProxyState state(kOpen);
    (void)hapticStep(*scene, reader, {p}, state, kDt);
    const StepReport r = hapticStep(*scene, reader, {p + Vec3(0, 0, -1e-4)}, state, kDt);
    CHECK(r.samples % r.substeps == 0);
    return r.samples / r.substeps;
  };
  CHECK(countAt({-0.03, 0, 0.03}) == 3);  // a, wind and the pressure, which weights wind
  CHECK(countAt({0.03, 0, 0.03}) == 4);   // the three above, and b
  CHECK(countAt({0.08, 0, 0.03}) == 1);   // b
  CHECK(countAt({1, 0, 0.03}) == 1);      // far
  CHECK(countAt({0.5, 0, 0}) == 0);
  // Where the wind has no data, its mode does not act, so the pressure is not read.
  GraphSpec weighted = spec;
  weighted.modes = {spec.modes[2]};
  std::map<std::string, FieldPtr> apart = at;
  apart["pressure"] = scalar(Vec3::Zero(), 0.2);
  const auto lonely = makeScene(weighted, apart, {kStiffness, 0.0});
  CHECK(fieldsAt(lonely->graph, {0.1, 0, 0}).scalars == 0);
  CHECK(fieldsAt(lonely->graph, {0.01, 0, 0}).scalars == 1);

  // The first three sets are orthogonal: a surface with friction, a line with a front, and a front
  // with a surface. The last set is not.
  const auto kindOfSolve = [&](const std::vector<ModeSpec>& modes) {
    GraphSpec g;
    g.modes = modes;
    const auto s = makeScene(g, at, {kStiffness, 0.0});
    Reader reader;
    ProxyState state(kOpen);
    (void)hapticStep(*s, reader, {Vec3(0, 0, 1e-4)}, state, kDt);
    return hapticStep(*s, reader, {Vec3(2e-3, 1e-3, -3e-3)}, state, kDt).solver;
  };
  CHECK(kindOfSolve({spec.modes[0]}) == SolverKind::kClosedForm);
  CHECK(kindOfSolve({make(ModeKind::kFollow, "wind"), make(ModeKind::kFrontShape, "wind")}) ==
        SolverKind::kClosedForm);
  CHECK(kindOfSolve({make(ModeKind::kFrontShape, "wind"), make(ModeKind::kSurface, "a")}) ==
        SolverKind::kClosedForm);
  CHECK(kindOfSolve({make(ModeKind::kViscosity, "a"), make(ModeKind::kFrontShape, "wind")}) ==
        SolverKind::kPair);
}

TEST_CASE("a tick with 15 modes of nine kinds allocates no memory", "[modes][realtime]") {
  std::vector<ModeSpec> specs;
  for (const Named& mode : allModes()) specs.push_back(mode.mode);
  ModeSpec own;
  own.kind = ModeKind::kUser;
  auto calls = std::make_shared<int>(0);
  own.user = {&placeDrag, calls, {"ball"}};
  specs.push_back(own);
  GraphSpec spec;
  spec.modes = specs;
  spec.stiffness = TransferSpec(std::vector<TransferSpec::Factor>{
      {TransferFunction::piecewise({{-0.02, 200}, {0.02, 900}}), "ball"}});
  const auto scene = makeScene(spec, fields());
  Random random(76);
  const ClosedPath path(random, 500);
  Reader reader;
  ProxyState state(kOpen);
  bool fault = false;
  const CountScope scope;
  for (int i = 0; i <= 1000; ++i) {
    fault = hapticStep(*scene, reader, {path(i)}, state, kDt).status == StepStatus::kFault || fault;
  }
  const auto counts = CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK_FALSE(fault);
  CHECK(*calls > 1000);
}

TEST_CASE("a varying stiffness adds no energy and changes at a limited rate",
          "[coupling][modes][passivity][release]") {
  GraphSpec spec;
  const auto all = allModes();
  spec.modes = {all[9].mode, all[3].mode};
  spec.stiffness = TransferSpec(std::vector<TransferSpec::Factor>{
      {TransferFunction::piecewise({{-0.02, 200}, {0.02, 900}}), "ball"}});
  const auto scene = makeScene(spec, fields());
  CHECK(scene->coupling.stiffness == 200);
  Random random(77);
  double low = 1e9;
  double high = 0.0;
  for (int i = 0; i < 200; ++i) {
    const ClosedPath path(random, 500);
    double work = 0.0;
    double injected = 0.0;
    double stiffness = 0.0;
    Vec3 last = path(0);
    feel(*scene, path, [&](int tick, const Vec3& hand, const StepReport& r, const ProxyState&) {
      work += r.wanted.dot(hand - last);
      injected += r.injected;
      last = hand;
      if (tick > 0) REQUIRE(std::abs(r.stiffness - stiffness) <= kStiffnessRate * kDt * 1.000001);
      stiffness = r.stiffness;
      low = std::min(low, stiffness);
      high = std::max(high, stiffness);
    });
    REQUIRE(work <= injected + 1e-12);
  }
  CHECK(low >= 200.0);
  CHECK(high > 600.0);
  CHECK(high <= 900.0);

  // While the spring is stretched by 3 mm, the stiffness must not grow without energy. After the
  // release, the stiffness grows.
  const Vec3 offset(0, 0, 3e-3);
  VaryingStiffness k{300.0, 0.0};
  k = nextStiffness(k, 800.0, offset, 0.0, kDt);
  CHECK(k.value == 300.0);
  k = nextStiffness(k, 800.0, offset, 1e-6, kDt);
  CHECK(k.value == Approx(300.0 + 2e-6 / 9e-6));
  k = nextStiffness(k, 100.0, offset, 0.0, kDt);
  CHECK(k.value == Approx(295.0 + 2e-6 / 9e-6));
  CHECK(k.tank == Approx(0.5 * 5.0 * 9e-6));
  k = nextStiffness(k, 800.0, offset, 0.0, kDt);
  // Stiffening may use the energy that softening freed.
  CHECK(k.value == Approx(300.0 + 2e-6 / 9e-6));
  k = nextStiffness(k, 800.0, Vec3::Zero(), 0.0, kDt);
  CHECK(k.value == Approx(305.0 + 2e-6 / 9e-6));
  CHECK(nextStiffness({300.0, 0.0}, 800.0, Vec3(1e-17, 0, 0), 0.0, kDt).value ==
        305.0);  // an offset of 1e-17 m counts as zero
  CHECK(nextStiffness(k, 0.0, Vec3::Zero(), 0.0, kDt).value == k.value);  // no data
  CHECK(nextStiffness(k, std::nan(""), Vec3::Zero(), 0.0, kDt).value == k.value);
}

}  // namespace palpate::modes_test
