/// Tests the map of free space in a grid: the distances of the map, the distances that fields
/// report, and the readings that a tick saves.
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/free_map.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/counters.h"
#include "tests/support/hand.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/thinned.h"
#include "tests/support/vdb_grids.h"

namespace palpate::free_space_test {
using namespace palpate::test;
using openvdb::Coord;
using openvdb::math::Transform;

namespace {

using ScalarPtr = std::shared_ptr<const ScalarField>;

/// Returns scattered values, an active tile and an inactive tile, far apart.
template <class GridT>
typename GridT::Ptr scattered(const typename GridT::ValueType& background,
                              const typename GridT::ValueType& value) {
  openvdb::initialize();
  Random random(3);
  auto grid = GridT::create(background);
  auto accessor = grid->getAccessor();
  for (int blob = 0; blob < 4; ++blob) {
    const Vec3 at = random.inCube(150.0);
    for (int i = 0; i < 30; ++i) {
      const Vec3 p = at + random.inCube(12.0);
      accessor.setValue(Coord::round(openvdb::Vec3d(p.x(), p.y(), p.z())), value);
    }
  }
  accessor.setValueOff(Coord(-60, 70, -80), value);
  grid->tree().addTile(1, Coord(-200, 0, 64), value, true);
  grid->tree().addTile(1, Coord(96, -64, -160), value, false);
  grid->setTransform(Transform::createLinearTransform(0.5));
  grid->setName("scattered");
  return grid;
}

FieldPtr fieldOf(const openvdb::GridPtrVec& grids, const Placement& placement = {},
                 const Sampling& sampling = {}) {
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", grids);
  const std::string name = grids.size() == 3 ? "v" : "";
  return makeVdbField(loadVolume(folder / "a.vdb", name), placement, sampling);
}

/// A field that needs attend(), so that a tick on a free path also reads the field. If `map` is
/// false, the field has no map of free space, so every tick in the field's bounds reads it.
class Attentive : public ScalarField {
 public:
  Attentive(ScalarPtr field, bool map)
      : ScalarField(field->frame()), field_(std::move(field)), map_(map) {}

  [[nodiscard]] bool attends() const noexcept override { return true; }
  [[nodiscard]] double freeWithin(const Vec3& p_W) const noexcept override {
    return map_ ? field_->freeWithin(p_W) : 0.0;
  }
  void reset(FieldCache& cache) const noexcept override { field_->reset(cache); }
  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& cache) const noexcept override {
    return field_->sample(p_W, cache);
  }
  [[nodiscard]] Vec3 cellGradient(const Vec3& p_W, FieldCache& cache) const noexcept override {
    return field_->cellGradient(p_W, cache);
  }
  [[nodiscard]] Mat3 gradientJacobian(const Vec3& p_W, FieldCache& cache) const noexcept override {
    return field_->gradientJacobian(p_W, cache);
  }
  [[nodiscard]] Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                   FieldCache& cache) const noexcept override {
    return field_->firstFall(a_W, b_W, level, sign, cache);
  }

 private:
  ScalarPtr field_;
  bool map_;
};

GraphSpec skinOf(const std::string& name) {
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = name;
  spec.modes[0].solid = Solid::kBelow;
  spec.modes[0].strength = 3.0;
  spec.modes[0].friction = 0.3;
  return spec;
}

}  // namespace

TEST_CASE(
    "the map of free space never exceeds the distance to data, is at most 16 voxels less with "
    "blocks of 8 voxels, and takes at most 4 MB for a large extent",
    "[scale]") {
  Random random(7);
  for (int round = 0; round < 60; ++round) {
    CAPTURE(round);
    std::vector<FreeMap::Voxels> data(1 + static_cast<std::size_t>(random.uniform(0.0, 6.0)));
    const double room = round % 3 == 0 ? 40.0 : 200.0;
    for (FreeMap::Voxels& box : data) {
      const Vec3 at = random.inCube(room);
      for (std::size_t a = 0; a < 3; ++a) {
        box.lower[a] = static_cast<int>(std::floor(at[static_cast<Eigen::Index>(a)]));
        box.upper[a] = box.lower[a] + static_cast<int>(random.uniform(0.0, 20.0));
      }
    }
    const FreeMap map(data);
    for (int i = 0; i < 300; ++i) {
      const Vec3 p = random.inCube(1.5 * room);
      double nearest = 1e9;
      std::array<double, 3> low{1e9, 1e9, 1e9};
      std::array<double, 3> high{-1e9, -1e9, -1e9};
      for (const FreeMap::Voxels& box : data) {
        double far = 0.0;
        for (std::size_t a = 0; a < 3; ++a) {
          const double x = p[static_cast<Eigen::Index>(a)];
          far = std::max({far, box.lower[a] - x, x - box.upper[a]});
          low[a] = std::min(low[a], box.lower[a] - x);
          high[a] = std::max(high[a], box.upper[a] - x);
        }
        nearest = std::min(nearest, far);
      }
      const double said = map.around(p);
      REQUIRE(said <= std::max(0.0, nearest));
      // The point and the data can be anywhere in their blocks. So the map's distance is less than
      // the true distance by at most two edges of a block.
      const double outside = std::max({low[0], low[1], low[2], -high[0], -high[1], -high[2]});
      REQUIRE(said >= (outside > 0.0 ? outside - 15.0 : nearest - 16.0));
    }
  }
  CHECK(FreeMap().around({1, 2, 3}) > 1e8);
  const std::array<FreeMap::Voxels, 1> one{{{{0, 0, 0}, {7, 7, 7}}}};
  CHECK(FreeMap(one).around({std::nan(""), 0, 0}) == 0.0);
  CHECK(FreeMap(one).around({100, 0, std::nan("")}) == 0.0);
  CHECK(FreeMap(one).around({HUGE_VAL, 0, 0}) > 1e8);

  // The map takes at most 4 MB, so a larger extent gets larger blocks.
  const std::array<FreeMap::Voxels, 2> far{{{{-2000000, -2000, 0}, {-2000000, -2000, 0}},
                                            {{2000000, 3000, 9000}, {2000000, 3000, 9000}}}};
  const FreeMap large(far);
  CHECK(large.memory() <= 4U << 20U);
  CHECK(large.around({-2000000, -2000, 0}) == 0.0);
  CHECK(large.around({0, 0, 0}) > 1e5);
  CHECK(large.around({0, 0, 0}) <= 2e6);
}

TEST_CASE("a field has no data within the distance that it reports as free", "[scale]") {
  struct Case {
    const char* what;
    FieldPtr field;
    double voxel;
  };
  const auto ball = [] { return makeBall(40.0, 1.0); };
  const auto moved = [](const char* name, double by) {
    auto grid = scattered<openvdb::FloatGrid>(0.0F, 2.0F);
    grid->setName(name);
    grid->transform().postTranslate(openvdb::Vec3d(by, 0.3 * by, 0));
    return grid;
  };
  const auto rough = scattered<openvdb::FloatGrid>(0.25F, -1.0F);
  const auto flow = scattered<openvdb::Vec3SGrid>({0, 0, 0}, {1, 2, 3});
  const std::vector<Case> fields{
      {"scattered", fieldOf({rough}), 0.5},
      {"slanted", fieldOf({rough}, slanted()), 0.005},
      {"nearest", fieldOf({rough}, slanted(), {Interpolation::kNearest}), 0.005},
      {"quadratic", fieldOf({rough}, slanted(), {Interpolation::kQuadratic}), 0.005},
      {"cubic", fieldOf({rough}, {}, {Interpolation::kCubic}), 0.5},
      {"level set", fieldOf({ball()}, slanted()), 0.01},
      {"double", fieldOf({scattered<openvdb::DoubleGrid>(-1.0, 1.0)}), 0.5},
      {"vectors", fieldOf({flow}, slanted()), 0.005},
      {"components", fieldOf({moved("v.x", 0.0), moved("v.y", 7.0), moved("v.z", -5.0)}), 0.5}};
  for (const Case& c : fields) {
    CAPTURE(c.what);
    Random random(13);
    Probe probe(c.field);
    const bool scalar = c.field.index() == 0;
    const FieldFrame frame = std::visit([](const auto& field) { return field->frame(); }, c.field);
    const auto free_within = [&](const Vec3& p) {
      return std::visit([&](const auto& field) { return field->freeWithin(p); }, c.field);
    };
    double most = 0.0;
    int said = 0;
    for (int i = 0; i < 400; ++i) {
      const Vec3 size = frame.bounds.size();
      const Vec3 p = frame.bounds.centre() + random.inCube(0.6).cwiseProduct(size);
      const double free = free_within(p);
      most = std::max(most, free);
      said += free > 0.0 ? 1 : 0;
      for (int j = 0; j < 60 && free > 0.0; ++j) {
        const double share = j % 2 == 0 ? 0.999999 : random.uniform();
        const Vec3 q = p + share * free * random.inCube(1.0).normalized();
        if (scalar) {
          const ScalarSample s = probe.scalar(q);
          REQUIRE_FALSE(s.inside);
          REQUIRE(s.value == frame.background);
          REQUIRE(s.gradient == Vec3::Zero());
        } else {
          const VectorSample s = probe.vector(q);
          REQUIRE_FALSE(s.inside);
          REQUIRE(s.value == Vec3::Zero());
          REQUIRE(s.jacobian == Mat3::Zero());
        }
      }
    }
    // The field must often report free space, and sometimes a free distance above 20 voxels.
    CHECK(said > 100);
    CHECK(most > 20.0 * c.voxel);
  }
}

TEST_CASE("the map of free space saves sub-steps and samples and does not change forces",
          "[scale]") {
  // The centres of two balls of radius 2 cm are 31 cm apart, with empty space between the balls.
  openvdb::initialize();
  openvdb::FloatGrid::Ptr grid = makeBall(20.0, 1.0);
  openvdb::FloatGrid::Ptr other = makeBall(20.0, 1.0);
  for (auto value = other->cbeginValueAll(); value; ++value) {
    if (value.isVoxelValue() && value.isValueOn()) {
      grid->tree().setValue(value.getCoord().offsetBy(300, 64, 16), *value);
    }
  }
  Placement placement;
  placement.scale = 1e-3;
  placement.translate = Vec3(-0.15, -0.03, 0.0);
  const auto field = std::get<ScalarPtr>(fieldOf({grid}, placement));
  const auto blind = std::make_shared<const Attentive>(field, false);
  for (const bool parts : {false, true}) {
    CAPTURE(parts);
    const auto scene_of = [&](const ScalarPtr& felt) {
      if (!parts) return makeScene(skinOf("ball"), {{"ball", felt}});
      std::vector<Part> one;
      one.push_back(makePart(skinOf("ball"), {{"ball", felt}}));
      return makeScene({}, {}, {}, {}, std::move(one));
    };
    Hand seeing(scene_of(std::make_shared<const Attentive>(field, true)));
    Hand groping(scene_of(blind));
    long moves = 0;
    long moves_of_blind = 0;
    long samples = 0;
    long samples_of_blind = 0;
    int held = 0;
    double time = 0.0;
    for (int i = 0; i < 6000; ++i) {
      time += i / 1000 % 2 == 0 ? 4e-3 : 1e-3;  // up to 2 m/s
      const Vec3 hand = wander(time, 0.03) + Vec3(0.14 * std::sin(2.9 * time), 0, 0);
      const StepReport a = seeing.step(hand);
      const StepReport b = groping.step(hand);
      CAPTURE(i);
      REQUIRE(a.status == b.status);
      REQUIRE((a.wanted - b.wanted).norm() <= 1e-9);
      held += b.wanted.norm() > 0.01 ? 1 : 0;
      moves += a.substeps;
      moves_of_blind += b.substeps;
      samples += a.samples;
      samples_of_blind += b.samples;
    }
    INFO(moves << " moves of " << moves_of_blind << ", " << samples << " samples of "
               << samples_of_blind);
    CHECK(held > 100);
    // In a scene of parts, each tick has at least one move.
    const long least = parts ? 6000 : 0;
    CHECK(2 * (moves - least) < moves_of_blind - least);
    CHECK(2 * samples < samples_of_blind);
  }
}

/// A scene in which many ticks need no reading.
struct FreeScene {
  const char* name;
  GraphSpec graph;
  ScalarPtr field;
  double reach;   ///< Extent of the hand's motion [m].
  double unread;  ///< Least share of ticks without a reading.
};

std::vector<FreeScene> freeScenes() {
  Placement placement;
  placement.scale = 1e-3;
  const auto ball = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}, placement));
  Sampling cubic;
  cubic.interpolation = Interpolation::kCubic;
  const auto smooth = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}, placement, cubic));
  const auto place = Transform::createLinearTransform(1.0);
  place->postTranslate(openvdb::Vec3d(-24.0));
  Random random(5);
  const auto rough = std::get<ScalarPtr>(fieldOf(
      {makeGrid<openvdb::FloatGrid>(48, place,
                                    [&](const openvdb::Vec3d& p) {
                                      const double waves = std::sin(p.x() / 3.0) +
                                                           std::sin(p.y() / 4.0) +
                                                           std::sin(p.z() / 5.0);
                                      return static_cast<float>(waves +
                                                                0.5 * random.inCube(1.0).x());
                                    })},
      placement));
  GraphSpec rough_skin = skinOf("ball");
  rough_skin.modes[0].value = 0.8;
  rough_skin.modes[0].solid = Solid::kAbove;
  GraphSpec skin = skinOf("ball");
  GraphSpec smooth_skin = skinOf("ball");
  smooth_skin.modes[0].friction = 0.0;
  GraphSpec layers = skinOf("ball");
  layers.modes[0].strength = 0.5;  // yields
  layers.modes.push_back(layers.modes[0]);
  layers.modes[1].value = -2.0;
  layers.modes[1].strength = 3.0;
  ModeSpec drag;
  drag.kind = ModeKind::kViscosity;
  drag.of = "ball";
  drag.strength = TransferFunction::piecewise({{-1.0, 0.2}, {0.0, 0.0}});
  layers.modes.push_back(drag);
  return {{"friction", skin, ball, 0.035, 0.5},
          {"no friction, cubic", smooth_skin, smooth, 0.035, 0.5},
          {"two surfaces and a drag behind the first", layers, ball, 0.03, 0.3},
          {"rough", rough_skin, rough, 0.02, 0.02}};
}

TEST_CASE("a tick on a free path reads nothing and has the results of a tick that reads",
          "[scale]") {
  openvdb::initialize();
  for (const FreeScene& scene : freeScenes()) {
    const auto read = std::make_shared<const Attentive>(scene.field, false);
    Hand fast(makeScene(scene.graph, {{"ball", scene.field}}));
    Hand full(makeScene(scene.graph, {{"ball", read}}));
    const Box& bounds = scene.field->frame().bounds;
    int unread = 0;
    int within = 0;
    int held = 0;
    int returns = 0;
    bool was_unread = false;
    double time = 0.0;
    for (int i = 0; i < 20000; ++i) {
      // The hand moves at up to 0.4 m/s, out of the bounds and back to the ball. It rests for a
      // quarter of the time.
      if (i / 500 % 4 != 3) time += 3e-3;
      const Vec3 at = wander(time, scene.reach);
      if (i == 9000) {
        fast.state.release();
        full.state.release();
      }
      const StepReport a = fast.step(at);
      const StepReport b = full.step(at);
      CAPTURE(i, scene.name);
      REQUIRE(a.status == b.status);
      const bool is_unread = a.substeps == 0 && a.primitives == 0;
      REQUIRE((a.proxy - b.proxy).norm() <= 1e-9);
      REQUIRE((a.wanted - b.wanted).norm() <= 1e-6);
      REQUIRE(a.primitives == b.primitives);
      if (is_unread) {
        REQUIRE(a.proxy == at);
        REQUIRE(a.wanted == Vec3::Zero());
        REQUIRE(a.solver == b.solver);
        REQUIRE(a.samples + a.primitives == 0);
      }
      unread += is_unread ? 1 : 0;
      within += is_unread && (at.array().abs() < bounds.upper.array().abs()).all() ? 1 : 0;
      held += a.primitives > 0 ? 1 : 0;
      returns += was_unread && !is_unread ? 1 : 0;
      was_unread = is_unread;
    }
    INFO(scene.name << ": " << unread << " unread, " << within << " of them within the bounds, "
                    << held << " held, " << returns << " returns");
    CHECK(unread > scene.unread * 20000);
    CHECK(within > 100);
    CHECK(held > 500);
    CHECK(returns > 10);
  }
}

TEST_CASE(
    "on a surface without friction a tick reads nothing at rest and rarely if the hand trembles",
    "[scale][motion]") {
  openvdb::initialize();
  Placement placement;
  placement.scale = 1e-3;
  const auto ball = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}, placement));
  GraphSpec skin = skinOf("ball");
  skin.modes[0].friction = 0.0;
  Hand hand(makeScene(skin, {{"ball", ball}}));
  const Vec3 out = Vec3(1.0, 2.0, 3.0).normalized();
  for (int i = 0; i < 60; ++i) (void)hand.step((0.024 - 1e-4 * i) * out);
  const Vec3 at = 0.018 * out;
  for (int i = 0; i < 3; ++i) (void)hand.step(at);
  const StepReport first = hand.step(at);
  CHECK(first.substeps == 0);
  CHECK(first.primitives == 1);
  CHECK(first.status == StepStatus::kConverged);
  CHECK((first.proxy - 0.02 * out).norm() < 1e-5);
  for (int i = 0; i < 10000; ++i) {
    const StepReport r = hand.step(at);
    REQUIRE(r.substeps == 0);
    REQUIRE((r.proxy - first.proxy).norm() < 1e-12);
  }
  Random random(21);
  int readings = 0;
  for (int i = 0; i < 10000; ++i) {
    const Vec3 trembling = at + 4e-6 * random.inCube(1.0);
    const StepReport r = hand.step(trembling);
    readings += r.substeps;
    REQUIRE((r.proxy - 0.02 * trembling.normalized()).norm() < 1e-5);
  }
  CHECK(readings < 500);
  // Every tick reads a field that streams or plays its data, because new data may have arrived.
  Hand streams(makeScene(skin, {{"ball", std::make_shared<const Attentive>(ball, true)}}));
  for (int i = 0; i < 60; ++i) (void)streams.step((0.024 - 1e-4 * i) * out);
  for (int i = 0; i < 10; ++i) CHECK(streams.step(at).substeps > 0);
  // If the hand moves far beyond the tolerance, the tick reads.
  CHECK(hand.step(0.018 * (out + Vec3(0.01, 0, 0)).normalized()).substeps > 0);
}

TEST_CASE("the proxy of a hand that drifts slowly along a surface does not enter a second surface",
          "[scale][motion][safety]") {
  openvdb::initialize();
  Placement left;
  left.scale = 1e-3;
  Placement right = left;
  right.translate = Vec3(0.03, 0, 0);
  const auto a = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}, left));
  const auto b = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}, right));
  GraphSpec skins = skinOf("a");
  skins.modes[0].friction = 0.0;
  skins.modes[0].strength = 30.0;
  skins.modes.push_back(skins.modes[0]);
  skins.modes[1].of = "b";
  Hand hand(makeScene(skins, {{"a", a}, {"b", b}}));
  Random random(23);
  for (int i = 0; i < 60; ++i) (void)hand.step(Vec3(0.005, 0.0, 0.024 - 1e-4 * i));
  int unread = 0;
  int both = 0;
  // The hand moves from the first ball's top over the seam between the balls, by 1 um per tick.
  for (int i = 0; i < 20000; ++i) {
    const StepReport r = hand.step(Vec3(0.005 + 1e-6 * i, 0.0, 0.01) + 2e-6 * random.inCube(1.0));
    CAPTURE(i);
    REQUIRE(r.proxy.norm() > 0.02 - 2e-5);
    REQUIRE((r.proxy - right.translate).norm() > 0.02 - 2e-5);
    unread += r.substeps == 0 ? 1 : 0;
    both += r.primitives == 2 ? 1 : 0;
  }
  CHECK(unread > 10000);
  CHECK(both > 1000);
}

TEST_CASE("a tick in the data without a contact takes readings only if a mode acts there",
          "[scale]") {
  openvdb::initialize();
  const auto ball = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}));
  const auto readings = [&](const GraphSpec& spec) {
    Hand hand(makeScene(spec, {{"ball", ball}}));
    StepReport report;
    for (int i = 0; i < 10; ++i) report = hand.step(Vec3(22.0 + 1e-3 * i, 0, 0));
    return report.substeps;
  };
  CHECK(readings(skinOf("ball")) == 0);
  GraphSpec drag = skinOf("ball");
  drag.modes.emplace_back();
  drag.modes[1].kind = ModeKind::kViscosity;
  drag.modes[1].of = "ball";
  // The drag acts, in turn: only outside of the solid; only inside; inside and just outside.
  drag.modes[1].strength = TransferFunction::piecewise({{0.0, 0.0}, {5.0, 0.1}});
  CHECK(readings(drag) == 1);
  drag.modes[1].strength = TransferFunction::piecewise({{-1.0, 0.1}, {0.0, 0.0}});
  CHECK(readings(drag) == 0);
  drag.modes[1].strength = TransferFunction::piecewise({{-1.0, 0.1}, {0.5, 0.0}});
  CHECK(readings(drag) == 1);
  GraphSpec varies = skinOf("ball");
  varies.fields["steepness"] = {Derivation::kMagnitude, "slope"};
  varies.fields["slope"] = {Derivation::kGradient, "ball"};
  varies.modes[0].by = "steepness";
  varies.modes[0].strength = TransferFunction::piecewise({{0.0, 0.0}, {1.0, 3.0}});
  CHECK(readings(varies) == 1);
  GraphSpec inside = skinOf("ball");
  inside.modes[0].solid = Solid::kAbove;  // the background is solid
  CHECK(readings(inside) == 1);
}

TEST_CASE("a tick evaluates guides and moving volumes however far the hand is", "[scale]") {
  openvdb::initialize();
  const auto ball = std::get<ScalarPtr>(fieldOf({makeBall(20.0, 1.0)}));
  const Vec3 far = Vec3::Constant(1000.0);
  const auto readings = [&](const GraphSpec& spec) {
    Hand hand(makeScene(spec, {{"ball", ball}}));
    StepReport report;
    for (int i = 0; i < 10; ++i) report = hand.step(far + Vec3(1e-3 * i, 0, 0));
    return report.substeps;
  };
  CHECK(readings(skinOf("ball")) == 0);
  GraphSpec guided = skinOf("ball");
  guided.modes.emplace_back();
  guided.modes[1].kind = ModeKind::kGuide;
  guided.modes[1].strength = 1.0;
  CHECK(readings(guided) > 0);
  GraphSpec moving = skinOf("ball");
  const std::array<Keyframe, 2> keys{Keyframe{0.0}, Keyframe{1.0, {1, 0, 0, 0}, Vec3(0.1, 0, 0)}};
  moving.motions["ball"] = std::make_shared<const Motion>(keys);
  CHECK(readings(moving) > 0);
}

/// Returns a field with scattered active voxels that have the value of the background, in a space
/// of 600 x 600 x 192 voxels with edges `voxel` [m]. They leave no free space as large as a fast
/// hand's path in a tick. If `ball` is true, adds a ball of radius 20 voxels about the origin.
ScalarPtr ballInDust(double voxel, bool ball) {
  Random random(11);
  openvdb::initialize();
  openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(10.0F);
  if (ball) grid = makeBall(20.0, 1.0);
  auto accessor = grid->getAccessor();
  for (int x = -300; x < 300; x += 8) {
    for (int y = -300; y < 300; y += 8) {
      for (int z = -96; z < 96; z += 8) {
        const Coord at = Coord(x, y, z).offsetBy(4);
        if (!accessor.isValueOn(at) && accessor.getValue(at) > 0.0F) accessor.setValue(at, 10.0F);
      }
    }
  }
  Placement placement;
  placement.scale = voxel;
  return std::get<ScalarPtr>(fieldOf({grid}, placement));
}

TEST_CASE("a free proxy is at the hand in every tick, however far the hand moves in a tick",
          "[scale][motion][safety][release]") {
  constexpr double kFine = 1e-7;  // [m]; at 10 mm/s and 1 kHz the hand moves by 100 voxels per tick
  const ScalarPtr dust = ballInDust(kFine, false);
  for (const bool parts : {false, true}) {
    std::vector<Part> one;
    if (parts) one.push_back(makePart(skinOf("it"), {{"it", dust}}));
    Hand hand(parts ? makeScene({}, {}, {}, {}, std::move(one))
                    : makeScene(skinOf("it"), {{"it", dust}}));
    Random random(12);
    long late = 0;
    const int ticks = test::kSanitized ? 400 : 2000;
    for (int i = 0; i < ticks; ++i) {
      const Vec3 way = random.uniform(1.0, i % 10 == 0 ? 2000.0 : 300.0) * random.direction();
      const Vec3 at = (200.0 * kFine) * (kFine * way / (200.0 * kFine)).array().sin().matrix();
      const StepReport r = hand.step(at);
      late += r.status == StepStatus::kSubstepLimit ? 1 : 0;
      REQUIRE(r.primitives == 0);
      REQUIRE(r.proxy == at);
      REQUIRE(r.wanted == Vec3::Zero());
    }
    CHECK(late > ticks / 20);  // some ticks must be unable to read the whole path
  }
}

TEST_CASE(
    "on a path that a tick cannot read completely, a surface holds the hand if the tick reads it",
    "[scale][motion][safety]") {
  constexpr double kFine = 1e-7;  // [m]
  const auto field = ballInDust(kFine, true);
  Random random(13);
  for (int i = 0; i < (test::kSanitized ? 40 : 200); ++i) {
    Hand hand(makeScene(skinOf("ball"), {{"ball", field}}));
    const Vec3 out = random.direction();
    (void)hand.step(kFine * random.uniform(60.0, 180.0) * out);
    const Vec3 at = kFine * 15.0 * out;  // five voxels deep
    StepReport r;
    for (int tick = 0; tick < 5; ++tick) {
      r = hand.step(at);
      REQUIRE(r.primitives > 0);
    }
    REQUIRE((r.proxy - 20.0 * kFine * out).norm() < 0.05 * kFine);
  }
  // A surface beyond the range of a tick's readings has no effect. The hand crosses such a surface
  // from outside and gets no force inside.
  Hand hand(makeScene(skinOf("ball"), {{"ball", field}}));
  (void)hand.step(kFine * Vec3(2000, 1500, 0));
  for (int i = 0; i < 5; ++i) {
    const StepReport r = hand.step(kFine * Vec3(i, 0, 0));
    REQUIRE(r.wanted == Vec3::Zero());
    REQUIRE(r.proxy == kFine * Vec3(i, 0, 0));
  }
  CHECK(hand.step(kFine * Vec3(60, 0, 0)).wanted == Vec3::Zero());
  for (int x = 60; x >= 15; --x) (void)hand.step(kFine * Vec3(x, 0, 0));
  CHECK(hand.state.proxy().x() == Approx(20.0 * kFine).epsilon(0.01));
}

TEST_CASE("a tick takes no sample if the hand is near the boxes of parts but far from their data",
          "[scale]") {
  // All parts have the same grid, each at a slightly different position. The grid has data only at
  // the edges of a cube.
  openvdb::initialize();
  auto frame = openvdb::FloatGrid::create(0.0F);
  for (int axis = 0; axis < 3; ++axis) {
    for (int corner = 0; corner < 4; ++corner) {
      Coord from(0, 0, 0);
      from[(axis + 1) % 3] = (corner & 1) * 196;
      from[(axis + 2) % 3] = (corner >> 1) * 196;
      Coord to = from.offsetBy(3);
      to[axis] = 199;
      frame->fill(openvdb::CoordBBox(from, to), 1.0F, true);
    }
  }
  frame->setName("frame");
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {frame});
  const auto volume = loadVolume(folder / "a.vdb", "");
  GraphSpec spec = skinOf("frame");
  spec.modes[0].solid = Solid::kAbove;
  spec.modes[0].value = 0.5;
  // With 100 boxes, which exceeds the limit of near parts, only the few parts with near data must
  // act.
  const int count = GENERATE(40, 100);
  CAPTURE(count);
  Random random(17);
  std::vector<Part> seeing;
  std::vector<Part> groping;
  for (int i = 0; i < count; ++i) {
    Placement placement;
    placement.scale = 1e-3;
    placement.translate = Vec3::Constant(-0.1) + random.inCube(count == 40 ? 0.01 : 0.04);
    const auto field = std::get<ScalarPtr>(makeVdbField(volume, placement, {}));
    seeing.push_back(makePart(spec, {{"frame", field}}));
    groping.push_back(makePart(spec, {{"frame", std::make_shared<const Attentive>(field, false)}}));
  }
  Hand a(makeScene({}, {}, {}, {}, std::move(seeing)));
  Hand b(makeScene({}, {}, {}, {}, std::move(groping)));
  // In the middle, all boxes overlap but no data are near.
  const StepReport middle = a.step(Vec3::Zero());
  CHECK(middle.parts == 0);
  CHECK(middle.samples == 0);
  CHECK(middle.left_out == 0);
  CHECK(b.step(Vec3::Zero()).left_out == std::max(0, count - 64));
  CHECK(b.step(Vec3::Zero()).samples >= 40);
  a.state.release();
  b.state.release();
  // With 40 parts, both scenes must give the same forces while the hand enters and leaves the
  // edges.
  double most = 0.0;
  int crowded = 0;
  int fewer = 0;
  for (int i = 0; i < 8000; ++i) {
    const Vec3 hand = wander(i * 5e-4, 0.11);
    const StepReport with = a.step(hand);
    const StepReport without = b.step(hand);
    if (with.left_out > 0) crowded += 1;
    fewer += 2 * with.samples < without.samples ? 1 : 0;
    // Above the limit of parts, scene `b` may have left out a part, so the hand may have entered
    // its solid.
    if (count > 40) continue;
    CAPTURE(i);
    REQUIRE(with.status == without.status);
    REQUIRE((with.wanted - without.wanted).norm() <= 1e-9);
    most = std::max(most, without.wanted.norm());
  }
  CHECK(fewer > 2000);
  if (count == 40) CHECK(most > 1.0);
  CHECK(crowded == 0);

  const CountScope scope;
  for (int i = 0; i < 2000; ++i) (void)a.step(wander(i * 5e-4, 0.11));
  CHECK(CountScope::counts().allocations == 0);
}

}  // namespace palpate::free_space_test
