#include "palpate/engine/scene/graph.h"

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/formula_fields.h"

namespace palpate::graph_test {
using Catch::Contains;
using palpate::test::CountScope;

namespace {

std::map<std::string, FieldPtr> fields() {
  return {{"head", makeSphere(Vec3::Zero(), 0.05)},
          {"flow", makeVortex(Vec3::Zero(), {0, 0, 2}, 0.1, 0.1)}};
}

ModeSpec mode(ModeKind kind, const std::string& of, TransferFunction strength = 1.0) {
  ModeSpec spec;
  spec.kind = kind;
  spec.of = of;
  spec.strength = std::move(strength);
  return spec;
}

}  // namespace

TEST_CASE("a property that two modes read is sampled only once", "[graph]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "head"), mode(ModeKind::kSurface, "head"),
                mode(ModeKind::kViscosity, "head", TransferFunction::window(0, 1, 1))};
  const Graph graph = compileGraph(spec, fields());
  CHECK(graph.scalar_reads.size() == 1);
  CHECK(graph.vector_reads.empty());
  CHECK(graph.scalar_properties == std::vector<std::string>{"head"});
  CHECK(graph.vector_properties ==
        std::vector<std::string>{"gradient of head", "cell gradient of head"});
  CHECK(graph.unused == std::vector<std::string>{"flow"});
}

TEST_CASE("a property that no mode reads is not sampled", "[graph]") {
  GraphSpec spec;
  spec.fields = {{"speed", {Derivation::kMagnitude, "flow"}},
                 {"spin", {Derivation::kCurl, "flow"}}};
  spec.modes = {mode(ModeKind::kFollow, "flow")};
  const Graph graph = compileGraph(spec, fields());
  REQUIRE(graph.vector_reads.size() == 1);
  CHECK(graph.vector_reads[0].curl == -1);
  CHECK(graph.vector_reads[0].divergence == -1);
  CHECK(graph.magnitudes.empty());
  CHECK(graph.unused == std::vector<std::string>{"head", "speed", "spin"});
}

TEST_CASE("modes read derived fields with the correct values", "[graph]") {
  GraphSpec spec;
  spec.fields = {{"spin", {Derivation::kCurl, "flow"}},
                 {"swirl", {Derivation::kMagnitude, "spin"}},
                 {"source", {Derivation::kDivergence, "flow"}},
                 {"slope", {Derivation::kGradient, "head"}}};
  spec.modes = {mode(ModeKind::kForce, "spin"), mode(ModeKind::kForce, "slope"),
                mode(ModeKind::kViscosity, "source")};
  spec.modes[0].by = "swirl";
  spec.modes[0].strength = TransferFunction::piecewise({{0, 0}, {8, 8}});
  const auto scene = makeScene(spec, fields());
  Reader reader;
  reader.bind(*scene);
  Properties at;
  CHECK(reader.sample(*scene, {0.01, 0.02, 0}, at) == 2);
  const auto& force = std::get<ForceMode>(scene->graph.modes[0]);
  CHECK((at.vectors[static_cast<std::size_t>(force.vector)].value - Vec3(0, 0, 4)).norm() < 1e-12);
  CHECK(force.strength(at) == Approx(4.0));
  const auto& slope = std::get<ForceMode>(scene->graph.modes[1]);
  CHECK(at.vectors[static_cast<std::size_t>(slope.vector)].value.norm() == Approx(1.0));
}

TEST_CASE("a strength is a product of transfer functions, each of its own scalar", "[graph]") {
  GraphSpec spec;
  spec.fields = {{"speed", {Derivation::kMagnitude, "flow"}}};
  const auto ramp = TransferFunction::piecewise({{0, 0}, {1, 10}});
  spec.modes = {mode(ModeKind::kFollow, "flow"), mode(ModeKind::kFollow, "flow")};
  // The factors are a number, a curve of the flow's speed, and a curve of the distance to the
  // head's surface.
  spec.modes[0].strength = TransferSpec(std::vector<TransferSpec::Factor>{
      {0.5, ""}, {ramp, ""}, {TransferFunction::window(0, 0.1, 2), "head"}});
  // A factor without a property uses the mode's `by`.
  spec.modes[1].by = "head";
  spec.modes[1].strength = TransferSpec(std::vector<TransferSpec::Factor>{
      {ramp, "speed"}, {TransferFunction::window(0, 0.1, 2), ""}});
  const auto scene = makeScene(spec, fields());
  Reader reader;
  reader.bind(*scene);
  Properties at;
  const Vec3 p(0.02, 0.03, 0.01);
  CHECK(reader.sample(*scene, p, at) == 2);            // each property is read once
  const double speed = Vec3(-0.06, 0.04, 0.1).norm();  // |omega x p plus the flow along the axis|
  const double share = 2.0 * ((p.norm() - 0.05) / 0.1 + 0.5);
  CHECK(std::get<FollowMode>(scene->graph.modes[0]).strength(at) ==
        Approx(0.5 * 10.0 * speed * share));
  CHECK(std::get<FollowMode>(scene->graph.modes[1]).strength(at) == Approx(10.0 * speed * share));

  const auto refused = [&](std::vector<TransferSpec::Factor> factors, const std::string& by) {
    GraphSpec bad;
    bad.modes = {mode(ModeKind::kFollow, "flow")};
    bad.modes[0].by = by;
    bad.modes[0].strength = TransferSpec(std::move(factors));
    try {
      (void)compileGraph(bad, fields());
    } catch (const SceneError& e) {
      return std::string(e.what());
    }
    return std::string("accepted");
  };
  CHECK_THAT(refused({{1.0, ""}, {ramp, "nothing"}}, ""),
             Contains("/modes/0/strength/product/1/by"));
  CHECK_THAT(refused({{1.0, ""}, {ramp, "flow"}}, ""), Contains("is a vector"));
  CHECK_THAT(refused({{2.0, ""}, {3.0, ""}}, "head"), Contains("no curve of"));
  CHECK_THAT(refused({{1e6, ""}, {1e6, ""}}, ""), Contains("exceed"));
  CHECK_THAT(refused({}, ""), Contains("no factors"));
  CHECK(refused({{2.0, ""}, {3.0, ""}}, "") == "accepted");
}

TEST_CASE("a product of transfer functions is zero if one of its scalars has no data", "[graph]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kViscosity, "flow")};
  spec.modes[0].strength =
      TransferSpec(std::vector<TransferSpec::Factor>{{1.0, "head"}, {2.0, ""}});
  const auto scene = makeScene(spec, fields());
  Properties at;
  at.scalars[0].inside = true;
  at.scalars[1].inside = true;
  const Transfer& strength = std::get<ViscosityMode>(scene->graph.modes[0]).strength;
  CHECK(strength(at) == 2.0);
  at.scalars[static_cast<std::size_t>(strength.factors[0].scalar)].inside = false;
  CHECK(strength(at) == 0.0);
}

TEST_CASE("a vector's direction, Q and lambda2 come from one reading of the volume", "[graph]") {
  GraphSpec spec;
  spec.fields = {{"way", {Derivation::kUnit, "flow"}},       {"spin", {Derivation::kCurl, "flow"}},
                 {"axis", {Derivation::kUnit, "spin"}},      {"again", {Derivation::kUnit, "axis"}},
                 {"one", {Derivation::kMagnitude, "again"}}, {"q", {Derivation::kQ, "flow"}},
                 {"core", {Derivation::kLambda2, "flow"}}};
  spec.modes = {mode(ModeKind::kFollow, "way"),  mode(ModeKind::kForce, "again"),
                mode(ModeKind::kViscosity, "q"), mode(ModeKind::kViscosity, "core"),
                mode(ModeKind::kForce, "axis"),  mode(ModeKind::kViscosity, "one")};
  const auto scene = makeScene(spec, fields());
  const Graph& graph = scene->graph;
  REQUIRE(graph.vector_reads.size() == 1);
  CHECK(graph.scalar_reads.empty());
  CHECK(graph.units.size() == 3);
  CHECK(graph.unused == std::vector<std::string>{"head"});

  // The vortex rotates at 2 rad/s about z and flows along z at 0.1 m/s.
  Reader reader;
  reader.bind(*scene);
  Properties at;
  {
    const CountScope count;
    const int reads = reader.sample(*scene, {0.01, 0.02, 0}, at);
    const long allocations = CountScope::counts().allocations;
    CHECK(reads == 1);
    CHECK(allocations == 0);
  }
  const auto scalar = [&](std::size_t i) {
    const auto& viscosity = std::get<ViscosityMode>(graph.modes[i]);
    return at.scalars[static_cast<std::size_t>(viscosity.scalar)];
  };
  const auto vector = [&](int index) { return at.vectors[static_cast<std::size_t>(index)]; };
  const Vec3 way = vector(std::get<FollowMode>(graph.modes[0]).vector).value;
  CHECK((way - Vec3(-0.04, 0.02, 0.1).normalized()).norm() < 1e-12);
  CHECK((vector(std::get<ForceMode>(graph.modes[1]).vector).value - Vec3::UnitZ()).norm() < 1e-12);
  CHECK(scalar(2).value == Approx(4.0));
  CHECK(scalar(3).value == Approx(-4.0));
  CHECK(scalar(5).value == Approx(1.0));
  CHECK(scalar(3).inside);

  // Outside of a volume's data, its derived properties have no data either.
  (void)reader.sample(*scene, {9, 9, 9}, at);
  for (const std::size_t i : {2, 3, 5}) CHECK_FALSE(scalar(i).inside);
  CHECK_FALSE(vector(std::get<FollowMode>(graph.modes[0]).vector).inside);
}

TEST_CASE("an error in a graph is reported with its cause", "[graph]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "heda")};
  const auto error = [&] {
    try {
      (void)compileGraph(spec, fields());
    } catch (const SceneError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  CHECK(error() == "/modes/0/of: there is no volume or field \"heda\": did you mean \"head\"?");
  spec.modes = {mode(ModeKind::kFollow, "head")};
  CHECK_THAT(error(), Contains("/modes/0/of") && Contains("needs a vector"));
  spec.modes = {mode(ModeKind::kIsosurface, "flow")};
  CHECK_THAT(error(), Contains("needs a scalar volume"));
  spec.modes = {mode(ModeKind::kViscosity, "head")};
  spec.modes[0].by = "flow";
  CHECK_THAT(error(), Contains("/modes/0/by") && Contains("is a vector"));
  spec.modes = {};
  CHECK_THAT(error(), Contains("/modes") && Contains("no mode"));

  spec.modes = {mode(ModeKind::kFollow, "flow")};
  spec.fields = {{"a", {Derivation::kMagnitude, "b"}}, {"b", {Derivation::kMagnitude, "a"}}};
  CHECK_THAT(error(), Contains("/fields/") && Contains("derived from itself"));
  spec.fields = {{"a", {Derivation::kMagnitude, "head"}}};
  CHECK_THAT(error(), Contains("/fields/a") && Contains("is a scalar"));
  spec.fields = {{"a", {Derivation::kCurl, "head"}}};
  CHECK_THAT(error(), Contains("give a vector volume"));
  spec.fields = {{"a", {Derivation::kUnit, "head"}}};
  CHECK(error() == "/fields/a: unit needs a vector, but \"head\" is a scalar: give a vector");
  spec.fields = {{"a", {Derivation::kQ, "head"}}};
  CHECK_THAT(error(),
             Contains("/fields/a: q needs a vector volume") && Contains("give a vector volume"));
  spec.fields = {{"a", {Derivation::kLambda2, "b"}}, {"b", {Derivation::kCurl, "flow"}}};
  CHECK_THAT(error(), Contains("/fields/a: lambda2 needs a volume, but \"b\" is derived"));
  spec.fields = {{"head", {Derivation::kMagnitude, "flow"}}};
  CHECK_THAT(error(), Contains("same name"));
}

TEST_CASE("an isosurface on a 33rd volume is refused with the limit of 32 volumes", "[graph]") {
  std::map<std::string, FieldPtr> balls;
  GraphSpec spec;
  const auto add = [&](ModeKind kind) {
    const std::string name = "ball " + std::to_string(balls.size());
    balls[name] = makeSphere(Vec3::Zero(), 0.05);
    spec.modes.push_back(mode(kind, name));
  };
  for (int i = 0; i < 32; ++i) add(ModeKind::kIsosurface);
  CHECK(compileGraph(spec, balls).vector_properties.size() == 64);
  // A viscosity mode reads only the value, so it adds no vector.
  for (int i = 0; i < 32; ++i) add(ModeKind::kViscosity);
  CHECK(compileGraph(spec, balls).scalar_fields.size() == 64);
  spec.modes.back().kind = ModeKind::kIsosurface;
  CHECK_THROWS_WITH(compileGraph(spec, balls),
                    Contains("/modes: ") && Contains("more than 64 vectors") &&
                        Contains("isosurface takes two") &&
                        Contains("use surface and isosurface on at most 32 volumes"));
}

TEST_CASE("a bad coupling or sub-step limit is refused when the scene is made", "[graph]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kSurface, "head")};
  CHECK_THROWS_WITH(makeScene(spec, fields(), {0.0, 0.0}), Contains("/coupling/stiffness"));
  CHECK_THROWS_WITH(makeScene(spec, fields(), {500.0, -1.0}), Contains("/coupling/damping"));
  CHECK_THROWS_WITH(makeScene(spec, fields(), {}, {0}), Contains("/accuracy/max_substeps"));
}

TEST_CASE("the error for an unknown name suggests a name only if it is similar", "[graph]") {
  CHECK(nearestName("denisty", {"heat", "density"}) == "density");
  CHECK(nearestName("velocity", {"heat", "density"}).empty());
}

}  // namespace palpate::graph_test
