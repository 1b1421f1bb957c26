/// Tests the path on which a simulated hand explores a scene, for scenes with known surfaces.
#include "palpate/scenes/apps/common/finder.h"

#include <cmath>

#include <catch2/catch.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/formula_fields.h"

namespace palpate::finder_test {

namespace {

constexpr double kHalf = 0.05;   // half the edge of the scene's box [m]
constexpr double kRadius = 0.1;  // radius of the workspace [m]
constexpr double kSeconds = 10.0;
const Box kBox{Vec3::Constant(-kHalf), Vec3::Constant(kHalf)};

FieldFrame frame() {
  FieldFrame frame;
  frame.voxel = 1e-3;
  frame.bounds = kBox;
  return frame;
}

FieldPtr ballAt(const Vec3& centre, double radius) {
  return makeScalarField(frame(), [=](const Vec3& p) noexcept {
    const Vec3 r = p - centre;
    const double distance = r.norm();
    return ScalarSample{distance - radius, distance > 0.0 ? Vec3(r / distance) : Vec3::UnitX(),
                        true};
  });
}

ModeSpec mode(ModeKind kind, const std::string& of, const TransferSpec& strength) {
  ModeSpec mode;
  mode.kind = kind;
  mode.of = mode.name = of;
  mode.strength = strength;
  mode.solid = kind == ModeKind::kIsosurface ? Solid::kBelow : Solid::kAbove;
  return mode;
}

/// Forces and positions of a run.
struct Run {
  double share = 0.0;        ///< Share of ticks with more than 0.2 N.
  double most = 0.0;         ///< Largest force [N].
  double farthest = 0.0;     ///< Largest distance of the arm from the origin [m].
  std::vector<double> held;  ///< Largest force of each mode [N].
  /// Unit directions from which the hand touched the scene, each far from the last one.
  std::vector<Vec3> came;
};

Run feel(const Scene& scene, const Vec3& about = Vec3::Zero()) {
  cli::Search search;
  SimulatedDevice device({}, {}, cli::findingHand(scene, kBox, kRadius, kSeconds, &search), 1000.0);
  INFO(search.rays << " rays, " << search.met << " met something, " << search.visits << " visits, "
                   << search.ms << " ms");
  Reader reader;
  ProxyState state(device.info().limits);
  Run run;
  run.held.resize(scene.graph.modes.size());
  int strong = 0;
  int ticks = 0;
  for (; ticks < kSeconds * 1000; ++ticks) {
    const HandState hand = device.read();
    const StepReport r = hapticStep(scene, reader, hand, state, 1e-3);
    device.write(r.force);
    strong += r.force.norm() > 0.2 ? 1 : 0;
    run.most = std::max(run.most, r.force.norm());
    run.farthest = std::max(run.farthest, hand.position.norm());
    std::size_t next = 0;
    for (std::size_t i = 0; i < run.held.size(); ++i) {
      Vec3 force = Vec3::Zero();
      for (int k = 0; k < state.memory(i).emitted; ++k) force += state.forces()[next++];
      run.held[i] = std::max(run.held[i], force.norm());
    }
    const bool fresh =
        run.came.empty() || run.came.back().dot((hand.position - about).normalized()) < 0.7;
    if (r.force.norm() > 0.2 && fresh) run.came.push_back((hand.position - about).normalized());
  }
  run.share = static_cast<double>(strong) / ticks;
  return run;
}

}  // namespace

TEST_CASE(
    "the exploration path touches a small ball far from the middle of a large box from two sides",
    "[finder]") {
  const Vec3 centre(0.03, -0.027, 0.021);
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0)};
  const auto scene = makeScene(spec, {{"ball", ballAt(centre, 4e-3)}});
  const Run run = feel(*scene, centre);
  CAPTURE(run.share, run.most);
  CHECK(run.share > 0.3);
  CHECK(run.most > 1.0);
  CHECK(run.most < 4.0);
  CHECK(run.came.size() >= 2);
  CHECK(run.farthest < kRadius);
}

TEST_CASE(
    "the exploration path finds a ball that gives more than 5 N within one step of the search",
    "[finder]") {
  constexpr double kWide = 0.3;
  const Box box{Vec3::Constant(-kWide), Vec3::Constant(kWide)};
  FieldFrame wide = frame();
  wide.bounds = box;
  const FieldPtr ball = makeScalarField(wide, [](const Vec3& p) noexcept {
    return ScalarSample{p.norm() - 0.1, p.normalized(), true};
  });
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 50.0)};
  const CouplingParams stiff{.stiffness = 1000.0};
  cli::Search search;
  (void)cli::findingHand(*makeScene(spec, {{"ball", ball}}, stiff), box, 0.4, 1.0, &search);
  CAPTURE(search.rays);
  CHECK(search.met >= 32);
}

TEST_CASE("the exploration path finds smoke where it is dense", "[finder]") {
  const Vec3 centre(-0.02, 0.015, -0.01);
  const FieldPtr smoke = makeScalarField(frame(), [=](const Vec3& p) noexcept {
    constexpr double kWidth = 0.012;
    const Vec3 r = (p - centre) / kWidth;
    const double value = std::exp(-0.5 * r.squaredNorm());
    return ScalarSample{value, Vec3(-value / kWidth * r), true};
  });
  GraphSpec spec;
  const TransferFunction grows = TransferFunction::piecewise({{0.1, 0.0}, {1.0, 0.6}});
  spec.modes = {mode(ModeKind::kSurface, "smoke", grows),
                mode(ModeKind::kViscosity, "smoke", grows)};
  const Run run = feel(*makeScene(spec, {{"smoke", smoke}}));
  CAPTURE(run.share, run.most, run.held[0], run.held[1]);
  CHECK(run.share > 0.3);
  CHECK(run.held[0] > 0.4);
  CHECK(run.held[1] > 0.4);
}

TEST_CASE("the exploration path finds forces in a scene that has only a flow", "[finder]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kFollow, "flow", 1.0)};
  const FieldPtr flow = makeVortex({0.02, 0.02, 0.0}, {0.0, 0.0, 5.0}, 0.01, 0.02);
  const Run run = feel(*makeScene(spec, {{"flow", flow}}));
  CAPTURE(run.share, run.most);
  CHECK(run.share > 0.3);
  CHECK(run.most > 0.9);
}

TEST_CASE("the exploration path visits a strong and a weak ball that are apart from each other",
          "[finder]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "left", 3.0),
                mode(ModeKind::kIsosurface, "right", 0.5)};
  const auto scene = makeScene(spec, {{"left", ballAt({-0.03, 0.0, 0.0}, 0.012)},
                                      {"right", ballAt({0.035, 0.01, 0.0}, 0.006)}});
  const Run run = feel(*scene);
  CAPTURE(run.share, run.held[0], run.held[1]);
  CHECK(run.share > 0.3);
  CHECK(run.held[0] > 2.0);
  CHECK(run.held[1] > 0.4);
}

TEST_CASE("the exploration path finds a moving ball and the parts of a scene", "[finder]") {
  SECTION("a ball that turns about the origin") {
    const std::vector<Keyframe> turn{{0.0, {1, 0, 0, 0}, Vec3::Zero()},
                                     {5.0, {0.7071, 0, 0, 0.7071}, Vec3::Zero()},
                                     {10.0, {0.02, 0, 0, 0.9998}, Vec3::Zero()}};
    GraphSpec spec;
    spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0)};
    spec.motions["ball"] = std::make_shared<const Motion>(turn);
    const Run run = feel(*makeScene(spec, {{"ball", ballAt({0.03, 0.0, 0.0}, 0.01)}}));
    CAPTURE(run.share, run.most);
    CHECK(run.share > 0.3);
  }
  SECTION("a scene of two parts") {
    std::vector<Part> parts;
    for (const double x : {-0.03, 0.03}) {
      GraphSpec spec;
      spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0)};
      parts.push_back(makePart(spec, {{"ball", ballAt({x, 0.0, 0.0}, 0.01)}}));
    }
    const Run run = feel(*makeScene({}, {}, {}, {}, std::move(parts)));
    CAPTURE(run.share, run.most);
    CHECK(run.share > 0.3);
  }
}

TEST_CASE("the exploration path is reproducible, at most 0.1 m/s fast, and within the workspace",
          "[finder]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0)};
  const auto scene = makeScene(spec, {{"ball", ballAt({0.02, 0.0, 0.0}, 0.015)}});
  // At 0.04 m, the scene is larger than the workspace.
  const double radius = GENERATE(0.1, 0.04);
  HandTarget a = cli::findingHand(*scene, kBox, radius, 5.0);
  HandTarget b = cli::findingHand(*scene, kBox, radius, 200.0);
  double fastest = 0.0;
  double farthest = 0.0;
  double apart = 0.0;
  Vec3 last = b.at(0.0);
  for (double t = 0.0; t < 200.0; t += 0.01) {
    const Vec3 p = b.at(t);
    if (t < 5.0) apart = std::max(apart, (a.at(t) - p).norm());
    fastest = std::max(fastest, (p - last).norm() / 0.01);
    farthest = std::max(farthest, p.norm());
    last = p;
  }
  CHECK(apart == 0.0);
  CHECK(fastest <= 0.1 + 1e-9);
  CHECK(farthest <= radius);
}

TEST_CASE(
    "a search for a surface takes bounded work and stays in the workspace if it finds no surface",
    "[finder]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0)};
  const auto scene = makeScene(spec, {{"ball", ballAt({0.5, 0.0, 0.0}, 0.01)}});
  cli::Search search;
  HandTarget target = cli::findingHand(*scene, kBox, kRadius, 10.0, &search);
  CHECK(search.met == 0);
  CHECK(search.rays <= 4096);
  CHECK(search.reads < 1200000);
  for (double t = 0.0; t <= 10.0; t += 0.01) REQUIRE(target.at(t).norm() <= kRadius);
}

}  // namespace palpate::finder_test
