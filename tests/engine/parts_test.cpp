/// Tests scenes of many parts: distant parts are not read, and near parts give the same forces as a
/// scene without parts.
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/formula_fields.h"
#include "tests/support/hand.h"
#include "tests/support/random.h"

namespace palpate::parts_test {
using palpate::test::CountScope;
using palpate::test::Hand;
using palpate::test::Random;
using palpate::test::wander;

namespace {

constexpr double kDt = 1e-3;
const ForceLimits kOpen{1000.0, 1e9};

/// A ball. Its field has data in a cube whose edge is twice the ball's diameter.
struct Ball {
  Vec3 centre = Vec3::Zero();
  double radius = 0.02;
  double strength = 3.0;
  double friction = 0.0;
};

FieldPtr fieldOf(const Ball& ball) {
  return makeSphere(ball.centre, ball.radius);
}

/// Returns the field of a ball. Its data fill a cube that ends 3 mm outside the ball's surface.
FieldPtr tightFieldOf(const Ball& ball) {
  FieldFrame frame;
  const Vec3 size = Vec3::Constant(ball.radius + 3e-3);
  frame.bounds = {ball.centre - size, ball.centre + size};
  frame.background = 3e-3;
  return makeScalarField(frame, [ball](const Vec3& p) noexcept -> ScalarSample {
    const Vec3 d = p - ball.centre;
    return {d.norm() - ball.radius, d.normalized(), true};
  });
}

/// Returns a vector field of 1 along x. Its voxels are so large that a path needs one reading.
FieldPtr makeWind() {
  FieldFrame frame;
  frame.voxel = 0.1;
  frame.bounds = {Vec3::Constant(-1.0), Vec3::Constant(1.0)};
  return makeVectorField(frame, [](const Vec3&) noexcept -> VectorSample {
    return {Vec3::UnitX(), Mat3::Zero(), true};
  });
}

GraphSpec specOf(const Ball& ball, const std::string& name = "ball") {
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = name;
  spec.modes[0].solid = Solid::kBelow;
  spec.modes[0].strength = ball.strength;
  spec.modes[0].friction = ball.friction;
  return spec;
}

Part partOf(const Ball& ball) {
  return makePart(specOf(ball), {{"ball", fieldOf(ball)}});
}

/// Builds a scene in which each ball is a part.
std::unique_ptr<const Scene> asParts(const std::vector<Ball>& balls,
                                     const CouplingParams& coupling = {}) {
  std::vector<Part> parts;
  parts.reserve(balls.size());
  for (const Ball& ball : balls) parts.push_back(partOf(ball));
  return makeScene({}, {}, coupling, {}, std::move(parts));
}

/// Builds a scene in which all balls are volumes of one graph, so each tick evaluates all of them.
std::unique_ptr<const Scene> asOne(const std::vector<Ball>& balls,
                                   const CouplingParams& coupling = {}) {
  GraphSpec spec;
  std::map<std::string, FieldPtr> fields;
  for (std::size_t i = 0; i < balls.size(); ++i) {
    const std::string name = "ball" + std::to_string(1000 + i);
    fields[name] = fieldOf(balls[i]);
    spec.modes.push_back(specOf(balls[i], name).modes[0]);
  }
  return makeScene(spec, fields, coupling);
}

/// Builds a scene with this graph and a wall that blocks the proxy. If `as_part` is true, the wall
/// is a part; otherwise the wall is one of the graph's volumes.
std::unique_ptr<const Scene> besideWall(GraphSpec spec, std::map<std::string, FieldPtr> fields,
                                        const Ball& wall, bool as_part,
                                        const CouplingParams& coupling = {}) {
  std::vector<Part> parts;
  if (as_part) {
    parts.push_back(makePart(specOf(wall), {{"ball", tightFieldOf(wall)}}));
  } else {
    spec.modes.push_back(specOf(wall, "wall").modes[0]);
    fields["wall"] = tightFieldOf(wall);
  }
  return makeScene(spec, fields, coupling, {}, std::move(parts));
}

std::vector<Ball> someBalls(std::size_t count, double room, Random& random) {
  std::vector<Ball> balls(count);
  for (Ball& ball : balls) {
    ball.centre = random.inCube(room);
    ball.radius = random.uniform(0.01, 0.03);
    ball.strength = random.uniform(1.0, 4.0);
    ball.friction = random.uniform() < 0.5 ? 0.0 : random.uniform(0.1, 0.6);
  }
  return balls;
}

}  // namespace

TEST_CASE("parts give the same forces as volumes that are read in every tick", "[scale]") {
  Random random(11);
  long felt = 0;
  for (int room = 0; room < 8; ++room) {
    const std::vector<Ball> balls = someBalls(30, 0.08, random);
    Hand parts(asParts(balls));
    Hand one(asOne(balls));
    long near = 0;
    for (int i = 0; i < 4000; ++i) {
      const Vec3 hand = wander(i * kDt * (room % 2 == 0 ? 1.0 : 5.0) + room, 0.08);
      const StepReport a = parts.step(hand);
      const StepReport b = one.step(hand);
      CAPTURE(room, i);
      REQUIRE(a.left_out == 0);
      REQUIRE(a.status == b.status);
      felt += b.wanted.norm() > 0.1 ? 1 : 0;
      near += a.parts;
      REQUIRE((a.wanted - b.wanted).norm() <= 1e-9);
    }
    CHECK(near < 4000 * 25);
  }
  CHECK(felt > 2000);
}

TEST_CASE("a fast hand feels the same force from a part's stream as from a volume's stream",
          "[scale]") {
  // At 2 m/s the proxy makes several moves per tick.
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kFollow;
  spec.modes[0].of = "flow";
  spec.modes[0].strength = 1.0;
  FieldFrame frame;
  frame.bounds = {Vec3::Constant(-0.1), Vec3::Constant(0.1)};
  frame.voxel = 1e-3;
  const FieldPtr flow = makeVectorField(frame, [](const Vec3& p) noexcept -> VectorSample {
    return {Vec3(-p.y(), p.x(), 0.0), Mat3::Zero(), true};
  });
  std::vector<Part> parts;
  parts.push_back(makePart(spec, {{"flow", flow}}));
  Hand part(makeScene({}, {}, CouplingParams{}, {}, std::move(parts)));
  Hand volume(makeScene(spec, {{"flow", flow}}, CouplingParams{}));
  for (int i = 0; i < 400; ++i) {
    const double turn = 2e-3 * i / 0.02;
    const Vec3 hand = 0.0205 * Vec3(std::cos(turn), std::sin(turn), 0.0);
    const StepReport a = part.step(hand);
    const StepReport b = volume.step(hand);
    CAPTURE(i);
    REQUIRE(a.substeps == b.substeps);
    REQUIRE((a.wanted - b.wanted).norm() <= 1e-9);
    if (i > 1) CHECK(a.substeps >= 3);
  }
}

TEST_CASE("only the parts near the hand are read among ten thousand parts", "[scale]") {
  Random random(3);
  std::vector<Ball> balls = someBalls(test::cases(10000), 1.0, random);
  // Two balls overlap, far from all others.
  const Vec3 at(0.0, 0.0, 1.5);
  balls[17] = {at, 0.02, 3.0, 0.2};
  balls[balls.size() - 5] = {at + Vec3(0.015, 0, 0), 0.02, 2.0, 0.0};
  Hand many(asParts(balls));
  Hand two(asParts({balls[17], balls[balls.size() - 5]}));
  const auto hand = [&](int i) {
    const double turn = 2e-3 * i;
    return Vec3(at + 0.018 *
                         Vec3(std::cos(turn), std::sin(turn) * std::cos(0.3 * turn),
                              std::sin(turn) * std::sin(0.3 * turn)) *
                         (1.2 - 0.3 * std::min(1.0, i / 500.0)));
  };
  for (int i = 0; i < 500; ++i) (void)many.step(hand(i)), (void)two.step(hand(i));
  long allocations = 0;
  double felt = 0.0;
  for (int i = 500; i < 3000; ++i) {
    StepReport a;
    {
      const CountScope scope;
      a = many.step(hand(i));
      allocations += CountScope::counts().allocations;
    }
    const StepReport b = two.step(hand(i));
    REQUIRE(a.parts == 2);
    REQUIRE(a.samples == b.samples);
    REQUIRE(a.iterations == b.iterations);
    REQUIRE(a.wanted == b.wanted);
    felt = std::max(felt, a.wanted.norm());
  }
  CHECK(felt > 1.0);
  CHECK(allocations == 0);
  for (int i = 0; i < 500; ++i) (void)many.step({0, 0, 1.5 + 2e-3 * i});
  const StepReport away = many.step({0, 0, 2.5});
  CHECK(away.wanted == Vec3::Zero());
  CHECK(away.samples == 0);
  CHECK(away.parts == 0);
}

TEST_CASE("a fast hand feels every part on its path", "[scale]") {
  Random random(9);
  const std::vector<Ball> balls = someBalls(30, 0.3, random);
  long allocations = 0;
  long felt = 0;
  long most = 0;
  for (int run = 0; run < 30; ++run) {
    Hand parts(asParts(balls));
    Hand one(asOne(balls));
    // The hand moves at 2 m/s through a ball's centre.
    const Vec3 from = random.inCube(0.3);
    const Vec3 through = balls[static_cast<std::size_t>(run)].centre;
    const Vec3 way = 2.0 * kDt * (through - from).normalized();
    for (int i = 0; i < 400; ++i) {
      StepReport a;
      {
        const CountScope scope;
        a = parts.step(from + i * way);
        allocations += CountScope::counts().allocations;
      }
      const StepReport b = one.step(from + i * way);
      CAPTURE(run, i);
      REQUIRE((a.wanted - b.wanted).norm() <= 1e-9);
      felt += b.wanted.norm() > 0.1 ? 1 : 0;
      most = std::max<long>(most, a.parts);
    }
  }
  CHECK(allocations == 0);
  CHECK(felt > 100);
  CHECK(most < 30);
}

TEST_CASE("a part stops a proxy that a force pushes beyond the hand", "[scale]") {
  // A wind of 3 N or 12 N pushes the proxy up to 6 or 24 mm beyond the hand, but a wall blocks the
  // proxy.
  for (const double wind : {3.0, 12.0}) {
    for (const double gap : {1e-3, 4e-3, 5.5e-3, 0.011, 0.02}) {
      CAPTURE(wind, gap);
      const Ball wall{Vec3(0.1, 0, 0), 0.04, 20.0, 0.0};
      const auto scene_of = [&](bool parts) {
        GraphSpec spec;
        spec.modes.resize(1);
        spec.modes[0].kind = ModeKind::kForce;
        spec.modes[0].of = "wind";
        spec.modes[0].strength = wind;
        return besideWall(spec, {{"wind", makeWind()}}, wall, parts);
      };
      Hand apart(scene_of(true));
      Hand together(scene_of(false));
      StepReport a;
      StepReport b;
      for (int i = 0; i < 20; ++i) {
        // The hand rests in front of the ball. Only the wind moves the proxy.
        a = apart.step({0.06 - gap, 0, 0});
        b = together.step({0.06 - gap, 0, 0});
        REQUIRE(a.proxy.x() < 0.0601);
      }
      // If the proxy reaches the wall, the spring is as long as the gap, and the wall bears the
      // wind's force minus the spring's force.
      CHECK((a.wanted - b.wanted).norm() < 1e-6);
      if (wind / 500.0 > gap) CHECK(a.parts == 1);
    }
  }
}

TEST_CASE("a moving body pushes the proxy against a part but not through it", "[scale]") {
  // A plane that moves at 1 m/s pushes the proxy against a ball at rest.
  const Ball wall{Vec3(0.1, 0, 0), 0.04, 30.0, 0.0};
  const auto scene_of = [&](bool parts) {
    GraphSpec spec = specOf({Vec3::Zero(), 0.0, 8.0, 0.0}, "pusher");
    std::vector<Keyframe> path(2);
    path[1].time = 0.08;
    path[1].translate = Vec3(0.08, 0, 0);
    spec.motions["pusher"] = std::make_shared<const Motion>(path);
    CouplingParams soft;
    soft.stiffness = 100.0;
    return besideWall(spec, {{"pusher", makeHalfSpace({-0.02, 0, 0}, Vec3::UnitX())}}, wall, parts,
                      soft);
  };
  Hand apart(scene_of(true));
  Hand together(scene_of(false));
  double most = 0.0;
  double off = 0.0;
  for (int i = 0; i < 200; ++i) {
    const Vec3 hand(0.0, 0.0, 0.0);
    const StepReport a = apart.step(hand);
    const StepReport b = together.step(hand);
    CAPTURE(i);
    REQUIRE(a.proxy.x() < 0.0601);
    off = std::max(off, (a.wanted - b.wanted).norm());
    most = std::max(most, b.proxy.x());
  }
  CHECK(most > 0.055);
  CHECK(off < 1e-6);
}

TEST_CASE("only the strongest parts are evaluated if more parts than the limit are near the hand",
          "[scale]") {
  // Seventy balls overlap. In scene `crowd` all are parts, in `chosen` only the 64 strongest. In
  // `all`, thirty are volumes of the graph and forty are parts.
  Random random(5);
  std::vector<Ball> balls(70);
  for (std::size_t i = 0; i < balls.size(); ++i) {
    balls[i].centre = random.inCube(0.002);
    balls[i].radius = 0.02;
    balls[i].strength = i % 11 == 3 ? 0.02 : 0.2 + 1e-3 * static_cast<double>(i);
  }
  std::vector<Ball> strong = balls;
  std::stable_sort(strong.begin(), strong.end(),
                   [](const Ball& a, const Ball& b) { return a.strength > b.strength; });
  const std::vector<Ball> weak(strong.begin() + 64, strong.end());
  strong.resize(64);
  double most = 0.0;
  for (const Ball& ball : weak) most += partOf(ball).most;

  CouplingParams stiff;
  stiff.stiffness = 1000.0;
  Hand crowd(asParts(balls, stiff));
  Hand chosen(asParts(strong, stiff));
  std::vector<Part> rest;
  GraphSpec spec;
  std::map<std::string, FieldPtr> fields;
  for (std::size_t i = 0; i < balls.size(); ++i) {
    if (i >= 30) {
      rest.push_back(partOf(balls[i]));
      continue;
    }
    const std::string name = "ball" + std::to_string(1000 + i);
    fields[name] = fieldOf(balls[i]);
    spec.modes.push_back(specOf(balls[i], name).modes[0]);
  }
  Hand all(makeScene(spec, fields, stiff, {}, std::move(rest)));
  double off = 0.0;
  double felt = 0.0;
  for (int i = 0; i < 1500; ++i) {
    const Vec3 hand(0.001, 0.002 * std::sin(0.01 * i), 0.04 - 2e-5 * std::min(i, 1100));
    const StepReport c = crowd.step(hand);
    const StepReport s = chosen.step(hand);
    const StepReport a = all.step(hand);
    CAPTURE(i);
    REQUIRE(c.parts == 64);
    REQUIRE(c.left_out == 6);
    REQUIRE(c.missing == Approx(most));
    REQUIRE(a.left_out == 0);
    REQUIRE((c.wanted - s.wanted).norm() <= 1e-6);
    off = std::max(off, (c.wanted - a.wanted).norm());
    felt = std::max(felt, a.wanted.norm());
  }
  INFO("off " << off << " N of " << felt << ", bound " << most);
  CHECK(felt > 2.5);
  CHECK(off > 1e-3);
  CHECK(off <= most);
}

TEST_CASE("the bound of a part's force includes the friction that grooves add", "[scale]") {
  const auto most = [](double friction, bool distance) {
    FieldFrame frame;
    frame.bounds = {Vec3::Constant(-0.1), Vec3::Constant(0.1)};
    frame.distance = distance;
    const FieldPtr field = makeScalarField(frame, [](const Vec3& p) noexcept -> ScalarSample {
      return {p.z(), Vec3::UnitZ(), true};
    });
    return makePart(specOf({Vec3::Zero(), 0.02, 2.0, friction}), {{"ball", field}}).most;
  };
  CHECK(most(0.0, true) == 2.0);
  // If the field is not a distance field, the friction counts with mu. In a distance field, the
  // walls of a groove bear up to three times the load, so the friction counts with 3 mu, at most
  // 10.
  CHECK(most(0.5, false) == Approx(2.0 * (1.0 + 0.5)));
  CHECK(most(0.5, true) == Approx(2.0 * (1.0 + 3.0 * 0.5)));
  CHECK(most(9.0, true) == Approx(2.0 * (1.0 + 10.0)));
}

TEST_CASE("a part with an unsupported property is refused with the reason", "[scale]") {
  const auto says = [](const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields,
                       const char* words) {
    CHECK_THROWS_WITH(makePart(spec, fields), Catch::Contains(words));
  };
  const FieldPtr field = fieldOf({});
  GraphSpec moving = specOf({});
  const std::vector<Keyframe> still(1);
  moving.motions["ball"] = std::make_shared<const Motion>(still);
  says(moving, {{"ball", field}}, "a part has a volume that moves");
  GraphSpec varying = specOf({});
  varying.stiffness = TransferSpec(500.0);
  says(varying, {{"ball", field}}, "stiffness");
  GraphSpec many = specOf({});
  many.modes.resize(kMaxPartModes + 1, many.modes[0]);
  says(many, {{"ball", field}}, "17 modes");
  GraphSpec wide;
  std::map<std::string, FieldPtr> fields;
  for (std::size_t i = 0; i <= kMaxPartFields; ++i) {
    const std::string name(1, static_cast<char>('a' + i));
    fields[name] = field;
    wide.modes.push_back(specOf({}, name).modes[0]);
  }
  says(wide, fields, "more than 8");
  GraphSpec guide;
  guide.modes.resize(1);
  guide.modes[0].kind = ModeKind::kGuide;
  guide.modes[0].strength = 1.0;
  says(guide, {}, "a guide or a user-defined mode");
  CHECK_THROWS_WITH(makeScene({}, {}), Catch::Contains("the scene has no modes"));
}

}  // namespace palpate::parts_test
