#include <array>
#include <chrono>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <sstream>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/devices/json/json_node.h"
#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/formula_fields.h"
#include "tests/support/json_schema.h"
#include "tests/support/random.h"
#include "tests/support/source_dir.h"
#include "tests/support/vdb_grids.h"

namespace palpate::scene_test {
using namespace palpate::test;
using Catch::Contains;
using Json = nlohmann::json;

namespace {

/// Returns a scene with most features of the format, on linear.vdb.
Json fullScene() {
  return Json::parse(R"({
    "$schema": "scene.schema.json", "description": "all of it", "palpate": 1,
    "coupling": {"stiffness": 400, "damping": 0.5},
    "accuracy": {"max_substeps": 16, "max_iterations": 90, "slope_reach": 1},
    "volumes": {
      "head": {"file": "linear.vdb", "grid": "density", "place": {"fit": 0.1}, "interpolation": "trilinear"},
      "flow": {"file": "linear.vdb", "grid": "velocity", "place": {"like": "head"}},
      "true": {"file": "linear.vdb", "grid": "density", "place": {"unit": "mm",
               "keyframes": [{"time": 0}, {"time": 2, "rotation_wxyz": [0.7071, 0, 0, 0.7071]},
                             {"time": 3.5, "translate": [0, 0, 0]}], "repeat": true}},
      "many": {"file": "linear.vdb", "grid": "density",
               "instances": [{"fit": 0.1}, {"scale": 0.02, "translate": [0.3, 0, 0]}]},
      "turned": {"file": "linear.vdb", "grid": "density",
                 "place": {"scale": 0.01, "rotation_wxyz": [0.7071, 0, 0, 0.7071], "translate": [0, 0, 0.1],
                           "keyframes": [{"time": 1, "translate": [0.1, 0, 0]}]}}
    },
    "fields": {
      "speed": {"magnitude": "flow"}, "spin": {"curl": "flow"}, "source": {"divergence": "flow"},
      "slope": {"gradient": "head"}, "swirl": {"magnitude": "spin"}, "way": {"unit": "flow"},
      "vortex": {"q": "flow"}, "core": {"lambda2": "flow"}
    },
    "modes": [
      {"name": "bone", "mode": "isosurface", "of": "head", "value": 1, "solid": "above", "strength": 3, "depth": 2},
      {"mode": "surface", "of": "head", "solid": "below", "strength": {"window": {"level": 1, "width": 2, "max": 1}}},
      {"mode": "viscosity", "of": "head", "strength": 0.1, "by": "swirl"},
      {"name": "stream", "mode": "follow", "of": "flow", "strength": {"piecewise": [[0, 0], [0.3, 1], [1, 2]]}, "by": "speed"},
      {"mode": "force", "of": "spin", "strength": 0.2, "sense": "repel"},
      {"mode": "force", "of": "slope", "strength": {"window": {"level": 0, "width": 1, "max": 1}}, "by": "source"},
      {"mode": "follow", "of": "way", "strength": 0.1, "by": "vortex"},
      {"mode": "viscosity", "of": "core", "strength": 0.1}
    ]})");
}

/// Writes flow.vdb: a vortex about z with speed r exp(-r^2 / 2), 41^3 voxels of 0.1 about the
/// origin.
void writeVortex(const std::filesystem::path& folder) {
  const auto transform = openvdb::math::Transform::createLinearTransform(0.1);
  transform->postTranslate(openvdb::Vec3d(-2.0));
  const auto flow = makeGrid<openvdb::Vec3SGrid>(
      41, transform,
      [](const openvdb::Vec3d& p) {
        const double f = std::exp(-0.5 * (p.x() * p.x() + p.y() * p.y()));
        return openvdb::Vec3f(-p.y() * f, p.x() * f, 0.0);
      },
      "flow");
  writeVdb(folder / "flow.vdb", {flow});
}

/// Returns a scene of one isosurface in the vortex, at 10 mm per unit.
Json vortexScene(const char* of, double value, const char* solid) {
  Json scene = Json::parse(R"({
    "palpate": 1, "coupling": {"stiffness": 500},
    "volumes": {"flow": {"file": "flow.vdb", "place": {"scale": 0.01}}},
    "fields": {
      "speed": {"magnitude": "flow"}, "spin": {"curl": "flow"}, "swirl": {"magnitude": "spin"},
      "core": {"lambda2": "flow"}, "vortex": {"q": "flow"}
    },
    "modes": [{"name": "wall", "mode": "isosurface", "strength": 3}]})");
  scene["modes"][0]["of"] = of;
  scene["modes"][0]["value"] = value;
  scene["modes"][0]["solid"] = solid;
  return scene;
}

DeviceInfo arm(double stiffness) {
  DeviceInfo info;
  info.name = "arm";
  info.max_stiffness = stiffness;
  info.max_damping = 5.0;
  return info;
}

bool schemaAccepts(const Json& json) {
  return !schemaComplaint(json, sceneSchema());
}

std::string parseError(const std::string& text) {
  try {
    (void)parseScene(text, "s.json", ".");
  } catch (const SceneError& e) {
    return e.what();
  }
  return "no error";
}

}  // namespace

TEST_CASE("a scene file with most kinds of entries is read, placed and compiled", "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  const SceneSpec spec = parseScene(fullScene().dump(), "s.json", folder.path());
  CHECK(spec.coupling.stiffness == 400);
  CHECK(spec.step.max_substeps == 16);
  CHECK(spec.slope_reach == 1.0);
  CHECK(spec.step.max_iterations == 90);
  CHECK(spec.graph.modes[0].depth_voxels == 2);
  CHECK(spec.graph.modes[4].sense == Sense::kRepel);
  const BuiltScene built = buildScene(spec);
  CHECK(built.scene->graph.modes.size() == 8);
  CHECK(built.scene->graph.unused == std::vector<std::string>{"many", "true", "turned"});

  // "fit": 4 units become 0.1 m, centred at the origin.
  CHECK(built.placements.at("head").scale == Approx(0.1 / 4.0));
  CHECK(built.placements.at("head")(Vec3::Constant(2.0)).norm() < 1e-15);
  CHECK(built.placements.at("flow")({1, 2, 3}) == built.placements.at("head")({1, 2, 3}));
  CHECK(built.placements.at("true").scale == 1e-3);
  CHECK((built.placements.at("turned")({1, 0, 0}) - Vec3(0, 0.01, 0.1)).norm() < 1e-6);
}

TEST_CASE("a moving or deforming instance and instances in a scene of one graph are refused",
          "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  Json json = fullScene();
  json["modes"].push_back(
      {{"mode", "isosurface"}, {"of", "many"}, {"value", 1}, {"solid", "above"}, {"strength", 1}});
  const SceneSpec good = parseScene(json.dump(), "s.json", folder.path());
  CHECK(buildScene(good).scene->parts.size() == 2);
  const auto with = [&](const std::function<void(SceneSpec & spec, PlaceSpec & instance)>& spoil) {
    SceneSpec spec = good;
    spoil(spec, spec.volumes.at("many").instances[1]);
    return spec;
  };
  const std::string at = "s.json: /volumes/many/instances";
  CHECK_THROWS_WITH(buildScene(with([](SceneSpec&, PlaceSpec& p) { p.warp.emplace(); })),
                    Contains(at + "/1: an instance cannot move or deform"));
  CHECK_THROWS_WITH(buildScene(with([](SceneSpec&, PlaceSpec& p) { p.repeat = true; })),
                    Contains(at + "/1: an instance cannot move or deform"));
  CHECK_THROWS_WITH(buildScene(with([](SceneSpec& s, PlaceSpec&) { s.one_graph = true; })),
                    Contains(at + ": a scene of one graph has no parts"));
}

TEST_CASE("the schema and the reader of scenes accept and refuse the same files",
          "[scene][schema]") {
  REQUIRE(parseError(fullScene().dump()) == "no error");
  REQUIRE(schemaAccepts(fullScene()));
  struct Bad {
    const char* pointer;
    Json value;
    const char* says;
  };
  const std::vector<Bad> cases{
      {"/palpate", 2, "/palpate: 2 is a version"},
      {"/extra", 1, "/extra: unknown key"},
      {"/volumes", Json::object(), "/volumes: the scene has no volume"},
      {"/volumes/head/fil", "a", "/volumes/head/fil: unknown key: did you mean \"file\"?"},
      {"/volumes/head/file", 3, "/volumes/head/file: 3 is not a text"},
      {"/volumes/head/file", "", "/volumes/head/file: the text is empty"},
      {"/volumes/head/interpolation", "quintic", "cubic"},
      {"/volumes/head/axial", 1, "/volumes/head/axial: 1 is not true or false"},
      {"/volumes/head/non_finite", "ignore", "use one of refuse, fill"},
      {"/volumes/head/smooth", 32.5, "/volumes/head/smooth"},
      {"/volumes/head/smooth", -1, "/volumes/head/smooth"},
      {"/volumes/head/smooth", "1.5 inch", "/volumes/head/smooth: it is not a width"},
      {"/volumes/head/smooth", true, "/volumes/head/smooth"},
      {"/volumes/head/instances", Json::parse(R"([{"scale": 1}])"),
       "the volume also has \"place\""},
      {"/volumes/many/instances", Json::array(), "it is not a list of places"},
      {"/volumes/many/instances/0", 3, "/volumes/many/instances/0: it is not an object"},
      {"/volumes/many/instances/0", {{"like", "head"}}, "an instance cannot move"},
      {"/volumes/many/instances/1/keyframes", Json::array(), "an instance cannot move"},
      {"/volumes/many/instances/1/scale", 0, "/volumes/many/instances/1/scale: 0 is not > 0"},
      {"/volumes/many/instances/1/turn", 1, "instances/1/turn: unknown key"},
      {"/volumes/head/place/fit", -1, "/volumes/head/place/fit: -1 is not > 0"},
      {"/volumes/head/place/unit", "mm", "none or several of the keys"},
      {"/volumes/head/place", Json::object(), "none or several of the keys"},
      {"/volumes/turned/place/translate", {1, 2}, "not a list of 3 numbers"},
      {"/volumes/true/place/unit", "inch", "\"inch\" is not known: use one of m, cm, mm, um"},
      {"/volumes/true/place/keyframes", Json::array(), "not a list of keyframes"},
      {"/volumes/true/place/keyframes", {{"time", 0}}, "not a list of keyframes"},
      {"/volumes/true/place/keyframes/1/time", "late", "\"late\" is not a number"},
      {"/volumes/true/place/keyframes/1/turn", 1, "keyframes/1/turn: unknown key"},
      {"/volumes/true/place/keyframes/1", {{"translate", {0, 0, 0}}}, "\"time\" is missing"},
      {"/volumes/true/place/keyframes/1/rotation_wxyz", {1, 0, 0}, "not a list of 4 numbers"},
      {"/volumes/true/place/keyframes/2/translate", {1, 0}, "not a list of 3 numbers"},
      {"/volumes/true/place/repeat", 1, "/volumes/true/place/repeat: 1 is not true or false"},
      {"/volumes/head/place/repeat", true, "\"repeat\" needs keyframes"},
      {"/volumes/flow/place/keyframes", Json::parse(R"([{"time": 0}])"), "moves with it"},
      {"/modes/0/label", 7, "several of the keys value, label: give one"},
      {"/fields/speed", Json::object(), "give one of them"},
      {"/fields/speed/curl", "flow", "give one of them"},
      {"/fields/way/q", "flow", "give one of them"},
      {"/fields/core/lambda2", 2, "/fields/core/lambda2: 2 is not a text"},
      {"/fields/core/lamda2", "flow", "did you mean \"lambda2\"?"},
      {"/modes", Json::object(), "/modes: it is not a list"},
      {"/modes/0/mode", "isosurfce", "did you mean \"isosurface\"?"},
      {"/modes/0/strength", -1, "/modes/0/strength: -1 is negative"},
      {"/modes/0/strength", "strong", "\"strong\" is neither a number nor an object"},
      {"/modes/0/strength", {{"product", Json::array()}}, "not a list of factors"},
      {"/modes/0/strength", {{"product", {1, {{"gain", 2}}}}}, "/modes/0/strength/product/1"},
      {"/modes/0/strength", {{"piecewise", Json::array()}}, "it is not a list of points"},
      {"/modes/1/strength/window/width", 0, "/modes/1/strength/window/width: 0 is not > 0"},
      {"/modes/0/friction", -0.3, "/modes/0/friction: -0.3 is negative"},
      {"/modes/3/friction", 0.3, "mode follow does not have this key"},
      {"/modes/3/two_sided", true, "mode follow does not have this key"},
      {"/modes/3/shape", "line", "mode follow does not have this key"},
      {"/modes/0/viscosity", {{"window", {{"level", 1}}}}, "\"width\" is missing"},
      {"/modes/0/solid", "inside", "\"inside\" is not known"},
      {"/modes/0/sense", "repel", R"(mode isosurface, "value" does not have this key)"},
      {"/modes/3/value", 1, "mode follow does not have this key"},
      {"/modes/0/depth", 0, "/modes/0/depth: 0 is not > 0"},
      {"/coupling/stiffness", 0, "/coupling/stiffness: 0 is not > 0"},
      {"/coupling/stiffness", nullptr, "null is neither a number nor an object"},
      {"/coupling/stiffness", {{"window", 1}}, "/coupling/stiffness/window: it is not an object"},
      {"/coupling/damping", -0.1, "/coupling/damping: -0.1 is negative"},
      {"/accuracy/slope_reach", 0, "0 is not > 0"},
      {"/accuracy/slope_reach", 1.5, "more than one voxel"},
      {"/accuracy/max_substeps", 2.5, "not a whole number"},
      {"/accuracy/max_substeps", 0, "not a whole number"},
      {"/accuracy/max_iterations", 0, "not a whole number"},
  };
  for (const Bad& bad : cases) {
    Json scene = fullScene();
    scene[Json::json_pointer(bad.pointer)] = bad.value;
    CAPTURE(bad.pointer, bad.value.dump());
    const std::string error = parseError(scene.dump());
    CHECK_THAT(error, Contains("s.json") && Contains(bad.says));
    CHECK(error.find('\n') == std::string::npos);
    CHECK_FALSE(schemaAccepts(scene));
  }
  for (const char* needed :
       {"/palpate", "/volumes", "/modes", "/volumes/head/file", "/modes/0/mode", "/modes/0/of",
        "/modes/0/strength", "/modes/1/strength/window/max"}) {
    const Json::json_pointer pointer(needed);
    Json scene = fullScene();
    scene[pointer.parent_pointer()].erase(pointer.back());
    CAPTURE(needed);
    CHECK_THAT(parseError(scene.dump()), Contains("is missing"));
    CHECK_FALSE(schemaAccepts(scene));
  }
}

TEST_CASE("the shipped schema of scenes equals the one that the program prints",
          "[scene][schema]") {
  std::ifstream in(sourceDir() + "/scenes/scene.schema.json");
  std::ostringstream shipped;
  shipped << in.rdbuf();
  // If this check fails, run: build/release/bin/palpate schema scene > scenes/scene.schema.json
  CHECK(shipped.str() == sceneSchema());
}

TEST_CASE("each instance of a volume acts at its own place, and all instances share one volume",
          "[scene][scale]") {
  const TemporaryFolder folder;
  openvdb::FloatGrid::Ptr ball = makeBall(2.0, 0.1);
  ball->setName("ball");
  writeVdb(folder.path() / "ball.vdb", {ball});
  // The instances are balls of radius 2 cm, 10 cm apart, with a drag inside. "alone" is one more
  // ball.
  Json scene = Json::parse(R"({"palpate": 1, "volumes": {
      "ball": {"file": "ball.vdb", "instances": []},
      "again": {"file": "ball.vdb", "place": {"like": "ball"}},
      "alone": {"file": "ball.vdb", "place": {"scale": 0.01, "translate": [0, 0, 1]}}},
    "modes": [{"name": "skin", "mode": "isosurface", "of": "ball", "value": 0, "solid": "below", "strength": 3},
              {"mode": "viscosity", "of": "again", "strength": 0.1},
              {"mode": "isosurface", "of": "alone", "value": 0, "solid": "below", "strength": 2}]})");
  Json& instances = scene["volumes"]["ball"]["instances"];
  constexpr int kMany = 200;
  for (int i = 0; i < kMany; ++i) {
    instances.push_back({{"scale", 0.01}, {"translate", {0.1 * i, 0, 0}}});
  }
  std::vector<double> told;
  const BuiltScene built = buildScene(parseScene(scene.dump(), "s.json", folder.path()),
                                      [&](double done) { told.push_back(done); });
  CHECK(built.scene->parts.size() == kMany);
  REQUIRE(built.parts.size() == 1);
  CHECK(built.parts[0].count == kMany);
  CHECK(built.scene->graph.modes.size() == 1);
  CHECK(built.scene->graph.unused.empty());
  CHECK(built.bounds.upper.x() > 0.1 * (kMany - 1));
  CHECK(told.back() == 1.0);
  CHECK(built.volumes.at("ball") == built.volumes.at("again"));

  Reader reader;
  ProxyState state;
  const auto press = [&](const Vec3& from, const Vec3& to) {
    StepReport r;
    const int n = static_cast<int>((to - from).norm() / 2e-4);
    for (int i = 0; i <= n; ++i) {
      r = hapticStep(*built.scene, reader, {from + (to - from) * (static_cast<double>(i) / n)},
                     state, 1e-3);
    }
    return r;
  };
  for (const int i : {0, 57, kMany - 1}) {
    CAPTURE(i);
    const Vec3 at(0.1 * i, 0, 0);
    state.release();
    const StepReport r = press(at + Vec3(0, 0, 0.03), at + Vec3(0, 0, 0.018));
    CHECK(r.parts == 1);
    CHECK(r.force.z() == Approx(500.0 * 0.002).epsilon(0.02));
    CHECK(press(at + Vec3(0, 0, 0.018), at + Vec3(0, 0, 0.05)).force == Vec3::Zero());
  }
  state.release();
  CHECK(press({0, 0, 1.03}, {0, 0, 1.019}).force.z() == Approx(0.5).epsilon(0.02));

  const auto error = [&](const Json& bad) {
    try {
      (void)buildScene(parseScene(bad.dump(), "s.json", folder.path()));
    } catch (const Error& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  Json bad = scene;
  bad["modes"][0]["by"] = "alone";
  CHECK_THAT(error(bad), Contains("s.json: /modes/0") && Contains("which has instances"));
  // The error must name the mode that joins the volumes, not the first mode.
  bad["modes"][0].erase("by");
  bad["modes"].push_back({{"mode", "viscosity"}, {"of", "alone"}, {"by", "ball"}, {"strength", 1}});
  CHECK_THAT(error(bad), Contains("s.json: /modes/" + std::to_string(bad["modes"].size() - 1)) &&
                             Contains("which has instances"));
  bad["modes"].back()["by"] = "bal";
  CHECK_THAT(error(bad), Contains("/by: there is no") && Contains("did you mean \"ball\"?"));
  bad["modes"].erase(bad["modes"].size() - 1);
  bad["fields"]["edge"] = {{"gradient", "bal"}};
  CHECK_THAT(error(bad), Contains("/fields/edge") && Contains("did you mean \"ball\"?"));
  bad = scene;
  bad["modes"].push_back(
      {{"mode", "guide"}, {"shape", "point"}, {"at", {0, 0, 0}}, {"in", "ball"}, {"strength", 1}});
  CHECK_THAT(error(bad), Contains("/volumes/ball/instances") && Contains("cannot have instances"));
  bad = scene;
  bad["modes"][1]["strength"] = 1e13;
  CHECK_THAT(error(bad), Contains("s.json: /modes/1/strength"));
  bad = scene;
  bad["modes"][0]["of"] = "bal";
  CHECK_THAT(error(bad), Contains("/modes/0/of") && Contains("did you mean \"ball\"?"));
  // Only a scene that is built in C++ can have "like" together with instances.
  SceneSpec both = parseScene(scene.dump(), "s.json", folder.path());
  for (auto& [name, volume] : both.volumes) {
    if (!volume.instances.empty()) continue;
    volume.place.kind = PlaceSpec::Kind::kLike;
    volume.place.like = "ball";
    volume.instances = both.volumes.at("ball").instances;
    break;
  }
  CHECK_THROWS_WITH(buildScene(both),
                    Contains("/instances: the volume has instances and is also placed"));
  // An exception of the progress function cancels the load, also while parts are built.
  int calls = 0;
  CHECK_THROWS_AS(buildScene(parseScene(scene.dump(), "s.json", folder.path()),
                             [&](double) {
                               if (++calls > 1) throw SceneError("test", "cancelled", "");
                             }),
                  SceneError);
}

TEST_CASE("a folder of many volumes gives a scene in which each volume is a part",
          "[scene][scale]") {
  const TemporaryFolder folder;
  constexpr int kFiles = 80;  // more volumes than one graph may have
  for (int i = 0; i < kFiles; ++i) {
    openvdb::FloatGrid::Ptr ball = makeBall(2.0, 0.2);
    ball->transform().postTranslate(openvdb::Vec3d(5.0 * i, 0, 0));
    ball->setName("ball");
    const std::string number = std::to_string(1000 + i);
    writeVdb(folder.path() / (number + ".vdb"), {ball});
  }
  const BuiltScene built = buildScene(sceneFromVdb(folder.path()));
  CHECK(built.scene->parts.size() == kFiles);
  CHECK(built.scene->graph.modes.empty());
  // The first grid is scaled to 0.1 m. The others get the same placement.
  const double unit = built.placements.at("1000.ball").scale;
  CHECK(built.bounds.size().x() == Approx(unit * 5.0 * (kFiles - 1) + 0.1).epsilon(0.1));
  Reader reader;
  ProxyState state;
  const Vec3 at(unit * 5.0 * 50, 0, 0);
  StepReport r;
  for (double z = 0.08; z > 2.0 * unit - 0.002; z -= 2e-4) {
    r = hapticStep(*built.scene, reader, {at + Vec3(0, 0, z)}, state, 1e-3);
  }
  CHECK(r.parts == 1);
  CHECK(r.force.z() > 0.5);
}

TEST_CASE("isosurfaces of derived fields hold the hand within 0.1 mm of their exact radius",
          "[scene][derive]") {
  const TemporaryFolder folder;
  writeVortex(folder.path());
  struct Wall {
    const char* of;
    double value;
    const char* solid;
    double (*truth)(double r);
  };
  const std::vector<Wall> walls{
      {"speed", 0.4, "above", [](double r) { return r * std::exp(-0.5 * r * r); }},
      {"swirl", 1.0, "below", [](double r) { return (2.0 - r * r) * std::exp(-0.5 * r * r); }},
      {"core", -0.5, "above", [](double r) { return (r * r - 1.0) * std::exp(-r * r); }},
      {"vortex", 0.5, "below", [](double r) { return (1.0 - r * r) * std::exp(-r * r); }}};
  for (const Wall& wall : walls) {
    CAPTURE(wall.of);
    // All fields are monotonic up to r = 1.
    double low = 0.0;
    double high = 1.0;
    while (high - low > 1e-9) {
      const double r = 0.5 * (low + high);
      const bool beyond = (wall.truth(r) > wall.value) == (wall.truth(1.0) > wall.value);
      (beyond ? high : low) = r;
    }
    const Json scene = vortexScene(wall.of, wall.value, wall.solid);
    const BuiltScene built = buildScene(parseScene(scene.dump(), "s.json", folder.path()));
    REQUIRE(built.computed.count(wall.of) == 1);
    CHECK(built.computed.at(wall.of).from == "flow");
    CHECK(built.computed.at(wall.of).why == "mode \"wall\" needs its gradient");
    CHECK(built.volumes.at(wall.of)->info().memory > 41 * 41 * 41 * 4);
    CHECK(built.scene->graph.scalar_names == std::vector<std::string>{wall.of});
    CHECK(built.scene->graph.vector_reads.empty());

    // The hand moves outwards, to 0.5 mm beyond the wall. There the force is 0.25 N towards the
    // axis.
    Reader reader;
    ProxyState state;
    const double wall_at = 0.01 * low;
    StepReport r;
    for (double x = 0.002; x < wall_at + 5e-4; x += 5e-5) {
      r = hapticStep(*built.scene, reader, {{x, 0, 1e-4}}, state, 1e-3);
      if (x < wall_at - 1e-4) CHECK(r.force.norm() < 1e-9);
    }
    r = hapticStep(*built.scene, reader, {{wall_at + 5e-4, 0, 1e-4}}, state, 1e-3);
    // The wall may be off by a tenth of a voxel, 0.1 mm.
    CHECK(r.force.x() == Approx(-0.25).margin(0.05));
    CHECK(std::abs(r.force.y()) + std::abs(r.force.z()) < 0.02);
  }
}

TEST_CASE(
    "a derived field is computed at load only if a mode or another field needs its derivatives",
    "[scene][derive]") {
  const TemporaryFolder folder;
  writeVortex(folder.path());
  const auto build = [&](const Json& scene) {
    return buildScene(parseScene(scene.dump(), "s.json", folder.path()));
  };
  const auto error = [&](const Json& scene) {
    try {
      (void)build(scene);
    } catch (const SceneError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  Json scene = vortexScene("speed", 0.4, "above");
  scene["modes"] =
      Json::parse(R"([{"mode": "viscosity", "of": "swirl", "strength": 1, "by": "core"},
                                   {"mode": "force", "of": "spin", "strength": 1}])");
  CHECK(build(scene).computed.empty());
  scene["modes"].push_back({{"mode", "surface"}, {"of", "speed"}, {"strength", 1}});
  CHECK(build(scene).computed.at("speed").why == "mode /modes/2 needs its gradient");
  // If another field needs a field's derivatives, the field is computed at load, because only grids
  // have derivatives.
  scene = vortexScene("speed", 0.4, "above");
  scene["fields"]["slope"] = {{"gradient", "swirl"}};
  scene["modes"] = Json::parse(R"([{"mode": "force", "of": "slope", "strength": 1}])");
  const BuiltScene built = build(scene);
  CHECK(built.computed.at("swirl").why == "field \"slope\" needs its derivatives");
  CHECK(built.scene->graph.vector_properties == std::vector<std::string>{"gradient of swirl"});

  // The chain needs 65 computed fields, one more than the limit.
  scene = vortexScene("f63", 0.4, "above");
  for (int i = 0; i < 65; ++i) {
    const std::string of = i == 0 ? "flow" : "f" + std::to_string(i - 1);
    scene["fields"]["f" + std::to_string(i)] = {{i % 2 == 0 ? "magnitude" : "gradient", of}};
  }
  scene["modes"][0]["of"] = "f64";
  CHECK_THAT(error(scene), Contains("more than 64 fields have to be computed at load"));

  scene = vortexScene("spin", 0.4, "above");
  CHECK_THAT(error(scene), Contains("s.json: /modes/0/of"));
  scene = vortexScene("speed", 0.4, "above");
  scene["fields"]["speed"] = {{"magnitude", "speed"}};
  CHECK_THAT(error(scene), Contains("derived from itself"));
  scene["fields"]["speed"] = {{"magnitude", "flaw"}};
  CHECK_THAT(error(scene), Contains("did you mean \"flow\"?"));
  scene["fields"]["speed"] = {{"gradient", "flow"}};
  CHECK_THAT(error(scene),
             Contains("/fields/speed: gradient needs a scalar volume, but \"flow\" is a vector"));
  scene = vortexScene("core", 0.4, "above");
  scene["volumes"]["flow"]["axial"] = true;
  CHECK_THAT(error(scene), Contains("s.json: /fields/core") && Contains("axial"));
  scene["modes"][0]["of"] = "speed";
  CHECK(error(scene) == "no error");

  // A user's own field has no voxels, so a field derived from it cannot be computed at load.
  SceneSpec spec;
  spec.volumes["flow"].field = makeVortex(Vec3::Zero(), {0, 0, 2}, 0.1, 0.1);
  spec.graph.fields = {{"speed", {Derivation::kMagnitude, "flow"}}};
  ModeSpec wall;
  wall.kind = ModeKind::kIsosurface;
  wall.of = "speed";
  spec.graph.modes = {wall};
  CHECK_THROWS_WITH(buildScene(spec), Contains("/modes/0/of") && Contains("is a derived field"));
}

TEST_CASE("a scene file with invalid JSON or duplicate keys is rejected", "[scene]") {
  CHECK_THAT(parseError("{\n\"palpate\": 1,,\n}"),
             Contains("not valid JSON") && Contains("line 2"));
  CHECK_THAT(parseError(""), Contains("not valid JSON"));
  CHECK_THAT(parseError("[1, 2]"), Contains("it is not an object"));
  CHECK_THAT(parseError(R"({"palpate": 1, "palpate": 1})"),
             Contains("\"palpate\" occurs twice in one object"));
  CHECK_THAT(parseError(R"({"palpate": 1e999})"), Contains("not valid JSON"));
  CHECK_THAT(parseError(R"({"palpate": NaN})"), Contains("not valid JSON"));
  CHECK_THAT(parseError(std::string(100000, '[') + std::string(100000, ']')),
             Contains("nested deeper"));
}

TEST_CASE("JSON of 8 times the length takes less than 24 times as long to read", "[scene]") {
  // Takes the fastest of three runs. A parser of quadratic cost takes 64 times as long for 8 times
  // the text.
  const auto seconds = [](int objects) {
    std::string text = "[{\"a\": [1, 2]}";
    for (int i = 1; i < objects; ++i) text += ", {\"a\": [1, 2]}";
    text += "]";
    double least = 1e9;
    for (int run = 0; run < 3; ++run) {
      const std::clock_t start = std::clock();
      const Json json = parseJson(text, "text", raiseAs<SceneError>);
      REQUIRE(json.size() == static_cast<std::size_t>(objects));
      least = std::min(least, static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
    }
    return least;
  };
  CHECK(seconds(32000) < 24.0 * seconds(4000));
}

TEST_CASE("an error found at load names the scene file and the JSON path", "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  const auto error = [&](const char* pointer, const Json& value) {
    Json scene = fullScene();
    scene[Json::json_pointer(pointer)] = value;
    try {
      (void)buildScene(parseScene(scene.dump(), "s.json", folder.path()));
    } catch (const SceneError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  CHECK_THAT(error("/volumes/head/file", "b.vdb"),
             Contains("s.json: /volumes/head: ") && Contains("no such file"));
  CHECK_THAT(error("/volumes/head/grid", "dense"),
             Contains("/volumes/head") && Contains("there is no grid \"dense\""));
  CHECK_THAT(error("/volumes/head/interpolation", "nearest"),
             Contains("s.json: /modes/0/of: mode isosurface needs a gradient"));
  Json pushed = fullScene();
  pushed["volumes"]["head"]["interpolation"] = "nearest";
  pushed["modes"] = Json::array({{{"mode", "force"}, {"of", "head"}, {"strength", 1}}});
  CHECK_THROWS_WITH(buildScene(parseScene(pushed.dump(), "s.json", folder.path())),
                    Contains("/modes/0/of: mode force needs a gradient"));
  CHECK_THAT(error("/volumes/flow",
                   {{"file", "linear.vdb"}, {"grid", "velocity"}, {"axial", true}, {"smooth", 1}}),
             Contains("/volumes/flow/smooth") && Contains("cancel"));
  CHECK_THAT(error("/volumes/head/axial", true),
             Contains("s.json: /volumes/head: ") && Contains("only vectors can be axial"));
  CHECK_THAT(error("/volumes/flow/place/like", "haed"),
             Contains("/volumes/flow/place/like") && Contains("did you mean \"head\"?"));
  CHECK_THAT(error("/volumes/head/place", {{"like", "flow"}}), Contains("form a circle"));
  const auto keyframes = [&](const char* list, bool repeat = false) {
    return error("/volumes/head/place",
                 {{"fit", 0.1}, {"keyframes", Json::parse(list)}, {"repeat", repeat}});
  };
  CHECK(keyframes(R"([{"time": 2}])") == "no error");
  CHECK_THAT(keyframes(R"([{"time": 2}, {"time": 1}])"),
             Contains("s.json: /volumes/head/place/keyframes/1/time") && Contains("not later"));
  CHECK_THAT(keyframes(R"([{"time": 2, "rotation_wxyz": [0, 0, 0, 0]}])"),
             Contains("keyframes/0/rotation_wxyz: the quaternion is zero or not finite"));
  CHECK_THAT(keyframes(R"([{"time": 0}, {"time": 1, "translate": [0, 0, 1]}])", true),
             Contains("keyframes/1: a repeated motion must end where it began"));
  CHECK_THAT(error("/modes/0/of", "flow"), Contains("s.json: /modes/0/of"));
  CHECK_THAT(error("/modes/0/of", "heads"), Contains("did you mean \"head\"?"));
  CHECK_THAT(error("/fields/swirl/magnitude", "swirl"), Contains("derived from itself"));
}

TEST_CASE("smoothing of a volume is applied and stated in the scene's notes", "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  Json scene = fullScene();
  CHECK(buildScene(parseScene(scene.dump(), "s.json", folder.path())).notes.empty());
  scene["volumes"]["head"]["smooth"] = 1.5;
  scene["volumes"]["head"]["non_finite"] = "fill";
  const SceneSpec spec = parseScene(scene.dump(), "s.json", folder.path());
  CHECK(spec.notes.empty());
  const BuiltScene built = buildScene(spec);
  REQUIRE(built.notes.size() == 1);
  CHECK_THAT(built.notes.front(),
             Contains("s.json: /volumes/head: smoothed with a Gaussian of 1.5 voxels"));
  CHECK(built.volumes.at("head")->info().smoothing.sigma == 1.5);
  // Smoothing must not change the placement.
  CHECK(built.placements.at("head").scale == Approx(0.1 / 4.0));
}

TEST_CASE(
    "a small smoothing width that is written as an integer gets a note: older versions smoothed "
    "more",
    "[scene]") {
  const auto notes = [](const char* smooth) {
    Json scene = fullScene();
    scene["volumes"]["head"]["smooth"] = Json::parse(smooth);
    const SceneSpec spec = parseScene(scene.dump(), "s.json", ".");
    CHECK(spec.volumes.at("head").smooth == SmoothWidth{Json::parse(smooth), false});
    return spec.notes;
  };
  REQUIRE(notes("2").size() == 1);
  CHECK_THAT(notes("2").front(), Contains("s.json: /volumes/head/smooth: 2 is now") &&
                                     Contains("write 2.83 for the older result, or 2.0"));
  CHECK_THAT(notes("1").front(), Contains("write 1.63"));
  CHECK(notes("0").empty());
  CHECK(notes("2.0").empty());
  CHECK(notes("17").empty());  // older versions refused this width
}

TEST_CASE("a smoothing length in metres is converted to the file's unit by the volume's scale",
          "[scene]") {
  const auto width = [](const char* volume, const char* text) {
    Json scene = fullScene();
    REQUIRE(schemaAccepts(scene));
    scene["volumes"][volume]["smooth"] = text;
    CHECK(schemaAccepts(scene));
    const SceneSpec spec = parseScene(scene.dump(), "s.json", ".");
    CHECK(spec.notes.empty());
    CHECK(spec.volumes.at(volume).smooth.in_file_units);
    return spec.volumes.at(volume).smooth.sigma;
  };
  CHECK(width("head", "1.5 file") == 1.5);
  CHECK(width("true", "1.5 mm") == Approx(1.5));
  CHECK(width("true", "0.2cm") == Approx(2.0));
  CHECK(width("turned", "5 mm") == Approx(0.5));
  CHECK(width("turned", "20000 um") == Approx(2.0));
  CHECK(width("turned", "0.02 m") == Approx(2.0));
  // A volume that is placed like another one has its scale. The scale of a fitted volume is
  // unknown here, because it depends on the bounds.
  Json scene = fullScene();
  scene["volumes"]["head"]["place"] = {{"unit", "cm"}};
  scene["volumes"]["flow"]["smooth"] = "5 mm";
  CHECK(parseScene(scene.dump(), "s.json", ".").volumes.at("flow").smooth.sigma == Approx(0.5));
  for (const char* volume : {"head", "flow", "many"}) {
    scene = fullScene();
    scene["volumes"][volume]["smooth"] = "1 mm";
    CHECK_THAT(parseError(scene.dump()), Contains(std::string("/volumes/") + volume +
                                                  "/smooth: a width in m, cm, mm or um needs"));
  }
  scene = fullScene();
  scene["volumes"]["head"]["place"] = {{"like", "flow"}};
  scene["volumes"]["head"]["smooth"] = "1 mm";
  CHECK_THAT(parseError(scene.dump()), Contains("/volumes/head/smooth"));
}

TEST_CASE("a mask gives the same surface with and without active surroundings", "[scene]") {
  const TemporaryFolder folder;
  std::array<double, 2> radius{};
  for (std::size_t kind = 0; kind < 2; ++kind) {
    const auto grid = openvdb::FloatGrid::create(0.0F);
    grid->setName("mask");
    for (auto c = openvdb::CoordBBox(openvdb::Coord(-16), openvdb::Coord(16)).begin(); c; ++c) {
      const bool in = (*c).asVec3d().length() < 7.2;
      if (in || kind == 0) grid->tree().setValueOn(*c, in ? 1.0F : 0.0F);
    }
    writeVdb(folder / "mask.vdb", {grid});
    Json scene = Json::parse(R"({"palpate": 1,
        "volumes": {"v": {"file": "mask.vdb", "place": {"scale": 0.001}, "smooth": 1.0}},
        "modes": [{"mode": "isosurface", "of": "v", "value": 0.5, "solid": "above", "strength": 3}]})");
    const BuiltScene built = buildScene(parseScene(scene.dump(), "s.json", folder.path()));
    const auto field = std::get<0>(built.fields.at("v"));
    FieldCache cache;
    field->reset(cache);
    double x = 0.012;
    while (x > 0.0 && field->sample({x, 0, 0}, cache).value < 0.5) x -= 1e-6;
    radius[kind] = x / 0.001;
  }
  CHECK(radius[1] == Approx(radius[0]).margin(0.02));
  CHECK(radius[0] > 6.7);
}

TEST_CASE("unchanged volumes and fields are reused from the previous scene", "[scene]") {
  const TemporaryFolder folder;
  writeVortex(folder.path());
  SceneCache cache;
  Json json = vortexScene("swirl", 1.0, "above");
  const auto build = [&] {
    return buildScene(parseScene(json.dump(), "s.json", folder.path()), nullptr, &cache);
  };
  const BuiltScene first = build();
  // If only numbers change, volumes and computed fields are reused.
  json["modes"][0]["strength"] = 2;
  json["coupling"]["stiffness"] = 300;
  const BuiltScene edited = build();
  CHECK(edited.scene->shape == first.scene->shape);
  CHECK(edited.scene->id != first.scene->id);
  CHECK(edited.volumes == first.volumes);
  CHECK(edited.fields == first.fields);
  CHECK(edited.computed.size() == first.computed.size());
  // The volume is moved. It is not loaded again, but the scene's shape changes.
  json["volumes"]["flow"]["place"]["scale"] = 0.02;
  const BuiltScene moved = build();
  CHECK(moved.volumes == first.volumes);
  CHECK(moved.scene->shape != first.scene->shape);
  // An invalid scene in between adds nothing to the cache.
  const std::size_t kept = cache.size();
  json["fields"]["more"] = {{"gradient", "swirl"}};
  json["fields"]["most"] = {{"magnitude", "more"}};
  json["modes"].push_back({{"mode", "surface"}, {"of", "most"}, {"strength", 1}});
  json["modes"].push_back({{"mode", "surface"}, {"of", "nothing"}, {"strength", 1}});
  CHECK_THROWS_AS(build(), SceneError);
  CHECK(cache.size() == kept);
  json["modes"].erase(2);
  CHECK(build().computed.size() > moved.computed.size());
  CHECK(cache.size() > kept);
  json["modes"].erase(1);
  CHECK(build().volumes == moved.volumes);
  CHECK(cache.size() == kept);
  // The file is overwritten.
  const auto file = folder / "flow.vdb";
  const auto time = std::filesystem::last_write_time(file);
  writeVortex(folder.path());
  std::filesystem::last_write_time(file, time + std::chrono::seconds(1));
  BuiltScene renewed = build();
  CHECK(renewed.volumes.at("flow") != first.volumes.at("flow"));
  CHECK(renewed.scene->shape != moved.scene->shape);
  // Volumes that no scene uses are freed.
  const std::weak_ptr<const Volume> gone = renewed.volumes.at("flow");
  renewed = {};
  SceneCache::Building(cache).done();
  CHECK(gone.expired());
}

TEST_CASE("the bounds of a scene enclose a volume far from the origin", "[scene]") {
  SceneSpec spec;
  spec.volumes["far"].field = makeSphere(Vec3::Constant(-5.0), 0.04);
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "far";
  spec.graph.modes = {skin};
  const BuiltScene built = buildScene(spec);
  CHECK((built.bounds.centre() - Vec3::Constant(-5.0)).norm() < 1e-12);
}

TEST_CASE(
    "keyframes of a volume also move its derived fields and the volumes that are placed like it",
    "[scene][moving]") {
  const TemporaryFolder folder;
  writeVortex(folder.path());
  Json scene = vortexScene("speed", 0.4, "above");
  scene["volumes"]["flow"]["place"] = Json::parse(R"({"scale": 0.01, "keyframes": [
      {"time": 1}, {"time": 2, "translate": [0.3, 0, 0]}]})");
  scene["volumes"]["with"] = Json::parse(R"({"file": "flow.vdb", "place": {"like": "then"}})");
  scene["volumes"]["then"] = Json::parse(R"({"file": "flow.vdb", "place": {"like": "flow"}})");
  scene["modes"].push_back(Json::parse(R"({"mode": "follow", "of": "with", "strength": 1})"));
  scene["modes"].push_back(Json::parse(
      R"({"mode": "guide", "shape": "point", "at": [0, 0, 1], "in": "flow", "strength": 1})"));
  const BuiltScene built = buildScene(parseScene(scene.dump(), "s.json", folder.path()));
  CHECK(built.motions.size() == 4);
  CHECK(built.motions.at("with") == built.motions.at("flow"));
  CHECK(built.motions.at("speed") == built.motions.at("flow"));
  const Graph& graph = built.scene->graph;
  CHECK(graph.motions.size() == 1);
  CHECK(graph.mode_motions == std::vector<int>{0, 0, 0});
  CHECK(built.bounds.size().x() == Approx(built.bounds.size().y() + 0.3));

  // A user's own field moves, too. A volume without keyframes is at rest.
  SceneSpec spec;
  spec.volumes["ball"].field = makeSphere(Vec3::Zero(), 0.04);
  spec.volumes["ball"].place.keyframes = {{0.0, {1, 0, 0, 0}, Vec3::Zero()},
                                          {0.1, {1, 0, 0, 0}, Vec3(0, 0, 0.01)}};
  spec.volumes["rock"].field = makeSphere(Vec3(0.2, 0, 0), 0.04);
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "ball";
  skin.solid = Solid::kBelow;
  skin.strength = 3.0;
  spec.graph.modes = {skin, skin};
  spec.graph.modes[1].of = "rock";
  const BuiltScene own = buildScene(spec);
  CHECK(own.scene->graph.mode_motions == std::vector<int>{0, -1});
  Reader reader;
  ProxyState state;
  StepReport r;
  for (int i = 0; i <= 100; ++i) {
    r = hapticStep(*own.scene, reader, {{0, 0, 0.048}}, state, 1e-3);
  }
  CHECK(r.proxy.z() == Approx(0.05));
  CHECK(r.force.z() == Approx(1.0));
  spec.volumes["rock"].place.repeat = true;
  CHECK_THROWS_WITH(buildScene(spec), Contains("/volumes/rock/place/repeat"));
}

/// Returns a random scene that is valid except for some numbers of extreme magnitudes.
Json extremeScene(Random& random) {
  const auto number = [&](double usual) {
    if (random.integer(4) != 0) return usual;
    const double size = std::pow(10.0, random.uniform(-300.0, 300.0));
    return random.integer(3) == 0 ? std::pow(10.0, random.uniform(-12.0, 12.0)) : size;
  };
  const auto signedNumber = [&](double usual) {
    return random.integer(2) == 0 ? number(usual) : -number(usual);
  };
  const auto vector = [&](double usual) {
    return Json{signedNumber(usual), signedNumber(usual), signedNumber(usual)};
  };
  const auto property = [&](double usual) -> Json {
    switch (random.integer(4)) {
      case 0:
        return {
            {"window", {{"level", signedNumber(1)}, {"width", number(2)}, {"max", number(usual)}}},
            {"by", "flow speed"}};
      case 1: {
        const double from = signedNumber(1);
        const double width = number(1);
        return {{"piecewise", {{from, number(usual)}, {from + width, number(usual)}}},
                {"by", "flow speed"}};
      }
      case 2:
        return {{"product", {number(usual), number(1.0)}}};
      default:
        return number(usual);
    }
  };
  const auto place = [&]() -> Json {
    switch (random.integer(3)) {
      case 0:
        return {{"fit", number(0.1)}};
      case 1:
        return {{"unit", "mm"}};
      default:
        return {{"scale", number(0.01)},
                {"rotation_wxyz", {signedNumber(1), signedNumber(0.1), signedNumber(0.1), 0.0}},
                {"translate", vector(0.01)}};
    }
  };
  const char* const words[] = {"trilinear", "nearest", "quadratic", "cubic"};
  Json head = {{"file", "linear.vdb"}, {"grid", "density"}, {"place", place()}};
  if (random.integer(2) == 0) head["interpolation"] = words[random.integer(4)];
  if (random.integer(3) == 0) {
    head["place"]["keyframes"] = {
        {{"time", signedNumber(0)}, {"translate", vector(0.001)}},
        {{"time", number(20)},
         {"rotation_wxyz", {signedNumber(1), signedNumber(0.1), 0.0, 0.0}},
         {"translate", vector(0.002)}}};
    head["place"]["repeat"] = random.integer(2) == 0;
  }
  Json scene = {
      {"palpate", 1},
      {"volumes",
       {{"head", head},
        {"flow",
         {{"file", "linear.vdb"},
          {"grid", "velocity"},
          {"place", random.integer(2) == 0 ? Json{{"like", "head"}} : place()}}}}},
      {"fields", {{"flow speed", {{"magnitude", "flow"}}}, {"turn", {{"curl", "flow"}}}}}};
  if (random.integer(2) == 0) {
    scene["coupling"] = {{"stiffness", number(500)}, {"damping", number(0.5)}};
  }
  if (random.integer(3) == 0) {
    scene["accuracy"] = {{"tolerance_voxels", std::min(number(0.01), 1.0)},
                         {"max_substeps", 1 + random.integer(64)}};
  }
  Json modes = Json::array();
  const int count = 1 + random.integer(3);
  for (int i = 0; i < count; ++i) {
    Json mode = {{"strength", property(1.0)}};
    switch (random.integer(8)) {
      case 0:
        mode.update({{"mode", "force"}, {"of", random.integer(2) == 0 ? "head" : "flow"}});
        break;
      case 1:
        mode.update({{"mode", "viscosity"}, {"of", "head"}});
        break;
      case 2:
        mode.update({{"mode", "surface"},
                     {"of", "head"},
                     {"friction", property(0.3)},
                     {"viscosity", property(0.1)}});
        break;
      case 3:
        mode.update({{"mode", "isosurface"},
                     {"of", random.integer(3) == 0 ? "flow speed" : "head"},
                     {"value", signedNumber(0.5)},
                     {"solid", "above"},
                     {"friction", property(0.3)},
                     {"depth", number(2)}});
        break;
      case 4:
        mode.update({{"mode", "follow"}, {"of", random.integer(2) == 0 ? "flow" : "turn"}});
        break;
      case 5:
        mode.update({{"mode", "transverse_damping"}, {"of", "flow"}});
        break;
      case 6:
        mode.update({{"mode", "front_shape"}, {"of", "flow"}, {"snap_drag", number(1)}});
        break;
      default:
        mode.update({{"mode", "guide"},
                     {"shape", "line"},
                     {"at", vector(0.01)},
                     {"along", vector(1)},
                     {"snap", number(0.02)}});
        if (random.integer(2) == 0) mode["in"] = "head";
    }
    modes.push_back(mode);
  }
  scene["modes"] = modes;
  return scene;
}

TEST_CASE("a scene with extreme numbers is refused or gives finite forces without a fault",
          "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  SceneCache cache;
  long felt = 0;
  long refused = 0;
  const long count = cases(400);
  for (long i = 0; i < count; ++i) {
    Random random(static_cast<std::uint64_t>(i) + 1);
    const Json json = extremeScene(random);
    CAPTURE(i, json.dump());
    BuiltScene built;
    try {
      built = buildScene(parseScene(json.dump(), "a.json", folder.path()), nullptr, &cache);
    } catch (const SceneError& e) {
      const std::string why = e.what();
      CHECK_THAT(why, Catch::StartsWith("a.json: /"));
      ++refused;
      continue;
    }
    ++felt;
    Reader reader;
    ProxyState state;
    const Box& box = built.bounds;
    // Makes two ticks near the centre of the bounds, then two near the head's translation.
    const Vec3 from = built.placements.at("head").translate;
    const Vec3 step = 1e-4 * (box.centre() - from).stableNormalized();
    for (int tick = 0; tick < 4; ++tick) {
      const Vec3 hand = tick < 2 ? Vec3(box.centre() + tick * step) : Vec3(from + tick * step);
      const StepReport r = hapticStep(*built.scene, reader, {hand}, state, 1e-3);
      CAPTURE(tick, hand.transpose());
      REQUIRE(r.status != StepStatus::kFault);
      REQUIRE(r.force.allFinite());
      REQUIRE(r.proxy.allFinite());
    }
  }
  INFO("felt " << felt << ", refused " << refused);
  CHECK(felt > 0);
}

TEST_CASE("a coupling that is stiffer than the device allows is refused with its path", "[scene]") {
  SceneSpec spec;
  spec.source = "s.json";
  spec.coupling.stiffness = 1500;
  CHECK_THROWS_WITH(
      checkDevice(spec, arm(1000)),
      Contains("s.json: /coupling/stiffness: 1500 N/m") && Contains("use at most 1000"));
  CHECK_NOTHROW(checkDevice(spec, arm(1500)));
  spec.coupling.damping = 5.1;
  CHECK_THROWS_WITH(checkDevice(spec, arm(1500)),
                    Contains("/coupling/damping: 5.1 N s/m") && Contains("use at most 5"));
}

TEST_CASE("the default coupling is lowered to the stiffness that the device can render",
          "[scene]") {
  SceneSpec spec;
  spec.any_stiffness = true;
  DeviceInfo weak = arm(100);
  weak.source = "untested";
  CHECK_THAT(fitCoupling(spec, weak), Contains("100 N/m instead of the default 500") &&
                                          Contains("\"arm\"") && Contains("untested"));
  CHECK(spec.coupling.stiffness == 100);
  CHECK_NOTHROW(checkDevice(spec, weak));
  // A stronger device must not raise the stiffness again.
  CHECK(fitCoupling(spec, arm(1000)).empty());
  CHECK(spec.coupling.stiffness == 100);
  // A stiffness in the scene's file is not changed. If it can exceed the device's limit, the scene
  // is refused.
  Json scene = vortexScene("speed", 0.5, "above");
  scene.erase("coupling");
  CHECK(parseScene(scene.dump(), "s.json", ".").any_stiffness);
  for (const char* stiffness : {"500", R"({"by": "speed", "piecewise": [[0, 100], [1, 600]]})"}) {
    Json asked = scene;
    asked["coupling"]["stiffness"] = Json::parse(stiffness);
    SceneSpec as_asked = parseScene(asked.dump(), "s.json", ".");
    CHECK(fitCoupling(as_asked, weak).empty());
    CHECK_THROWS_AS(checkDevice(as_asked, weak), SceneError);
  }
}

TEST_CASE("a .vdb file without a scene gets modes for its usable grids and notes about the others",
          "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  SceneSpec spec = openScene(folder / "mixed.vdb");
  REQUIRE(spec.graph.modes.size() == 1);
  CHECK(spec.graph.modes[0].kind == ModeKind::kIsosurface);
  CHECK(spec.graph.modes[0].solid == Solid::kBelow);
  REQUIRE(spec.notes.size() == 1);
  CHECK_THAT(spec.notes[0], Contains("grid \"labels\"") && Contains("int32"));

  // A flow, and a ramp from -4 to 12. The ramp is so short that it could be a blurred step, so it
  // gets a surface at its middle value.
  spec = openScene(folder / "linear.vdb");
  REQUIRE(spec.graph.modes.size() == 3);
  CHECK(spec.graph.modes[0].kind == ModeKind::kFollow);
  CHECK(spec.graph.modes[1].kind == ModeKind::kIsosurface);
  CHECK(spec.graph.modes[1].value == Approx(4.0).margin(0.2));
  CHECK(spec.graph.modes[1].solid == Solid::kAbove);
  CHECK(spec.graph.modes[2].kind == ModeKind::kViscosity);

  // The scene of a folder has every usable grid, placed like the first one.
  spec = openScene(folder.path());
  CHECK(spec.volumes.size() == 4);
  CHECK(spec.volumes.count("linear.density") == 1);
  CHECK(spec.notes.size() == 3);
  const BuiltScene built = buildScene(spec);
  CHECK(built.placements.at("ball.ball").scale == built.placements.at("linear.density").scale);

  CHECK_THROWS_WITH(openScene(folder / "labels.vdb"), Contains("none of its grids is usable"));
  CHECK_THROWS_WITH(openScene(folder / "none.vdb"), Contains("no such file"));
}

TEST_CASE("a scene built in C++ is checked like a scene file", "[scene]") {
  SceneSpec spec;
  spec.volumes["ball"].field = makeSphere(Vec3::Zero(), 0.04);
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "bal";
  skin.solid = Solid::kBelow;
  skin.strength = 3.0;
  spec.graph.modes = {skin};
  CHECK_THROWS_WITH(buildScene(spec),
                    "/modes/0/of: there is no volume or field \"bal\": did you "
                    "mean \"ball\"?");
  spec.graph.modes[0].of = "ball";
  const BuiltScene built = buildScene(spec);
  Reader reader;
  ProxyState state;
  (void)hapticStep(*built.scene, reader, {{0, 0, 0.041}}, state, 1e-3);
  const StepReport r = hapticStep(*built.scene, reader, {{0, 0, 0.039}}, state, 1e-3);
  CHECK(r.force.z() == Approx(0.5));
  spec.coupling.stiffness = std::nan("");
  CHECK_THROWS_AS(buildScene(spec), SceneError);
}

TEST_CASE("all example scenes are valid", "[scene][schema]") {
  for (const auto& entry :
       std::filesystem::directory_iterator(test::sourceDir() + "/scenes/examples")) {
    if (entry.path().extension() != ".json") continue;
    CAPTURE(entry.path().string());
    CHECK_NOTHROW(readSceneFile(entry.path()));
  }
}

TEST_CASE("the reader and the schema agree on the keys of surfaces, fronts, tubes and guides",
          "[scene][graph]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  Json scene = fullScene();
  const Json by_head = {{"window", {{"level", 0}, {"width", 1}, {"max", 0.5}}}, {"by", "head"}};
  scene["coupling"]["stiffness"] = {
      {"product", {2, {{"piecewise", {{-1, 100}, {1, 300}}}, {"by", "head"}}}}};
  scene["modes"] = {
      {{"mode", "surface"},
       {"of", "head"},
       {"strength", 1},
       {"friction", 0.4},
       {"viscosity", by_head}},
      {{"mode", "isosurface"},
       {"of", "head"},
       {"value", 0},
       {"strength", by_head},
       {"friction", {{"product", {0.5, by_head}}}}},
      {{"mode", "transverse_damping"}, {"of", "flow"}, {"strength", 0.1}},
      {{"mode", "front_shape"},
       {"of", "flow"},
       {"strength", 0.5},
       {"two_sided", false},
       {"snap_drag", 4}},
      {{"mode", "vortex_tube"}, {"of", "flow"}, {"strength", {{"product", {1, by_head}}}}},
      {{"mode", "guide"},
       {"shape", "point"},
       {"at", {2, 2, 2}},
       {"strength", by_head},
       {"in", "head"},
       {"snap", 1}},
      {{"mode", "guide"},
       {"shape", "line"},
       {"at", {0, 0, 0.01}},
       {"along", {0, 0, 3}},
       {"strength", {{"piecewise", {{0, 1}, {0.01, 0}}}}}},
      {{"mode", "guide"},
       {"shape", "plane"},
       {"at", {0, 0, 0}},
       {"along", {1, 0, 0}},
       {"strength", 1},
       {"snap", 0.01},
       {"name", "lid"}}};
  REQUIRE(schemaAccepts(scene));
  const SceneSpec spec = parseScene(scene.dump(), "s.json", folder.path());
  const BuiltScene built = buildScene(spec);
  const Graph& graph = built.scene->graph;
  REQUIRE(graph.modes.size() == 8);
  CHECK(built.scene->coupling.stiffness == 200);
  CHECK_THROWS_WITH(checkDevice(spec, arm(599)), Contains("/coupling/stiffness: 600 N/m"));
  SceneSpec asked = spec;
  CHECK(fitCoupling(asked, arm(100)).empty());
  checkDevice(spec, arm(600));
  CHECK(std::get<SurfaceMode>(graph.modes[0]).friction(Properties{}) == 0.4);
  CHECK_FALSE(std::get<FrontShapeMode>(graph.modes[3]).two_sided);
  CHECK(std::get<FrontShapeMode>(graph.modes[3]).snap == Approx(4 * graph.vector_frames[0].voxel));
  // Positions are in the head's units. The head's centre is W's origin, and a unit is 25 mm.
  const auto& point = std::get<GuideMode>(graph.modes[5]);
  CHECK(point.position.norm() < 1e-15);
  CHECK(point.snap == Approx(0.025));
  CHECK(point.metres_per_unit == Approx(0.025));
  CHECK(std::get<GuideMode>(graph.modes[6]).direction == Vec3::UnitZ());

  // Guides turn with their volume, here by 90 degrees about z.
  Json turned = scene;
  turned["volumes"]["head"]["place"] = {{"scale", 0.025},
                                        {"rotation_wxyz", {std::sqrt(0.5), 0, 0, std::sqrt(0.5)}}};
  turned["modes"][5] = {{"mode", "guide"},    {"shape", "line"}, {"at", {1, 0, 0}},
                        {"along", {1, 0, 0}}, {"in", "head"},    {"strength", 1}};
  const BuiltScene other = buildScene(parseScene(turned.dump(), "s.json", folder.path()));
  const auto& line = std::get<GuideMode>(other.scene->graph.modes[5]);
  CHECK((line.direction - Vec3::UnitY()).norm() < 1e-12);
  CHECK((line.position - Vec3(0, 0.025, 0)).norm() < 1e-12);
  // A fitted volume turns about its centre, and `translate` is the place of the centre.
  turned["volumes"]["head"]["place"]["fit"] = 0.1;
  turned["volumes"]["head"]["place"]["translate"] = {0.01, 0, 0.02};
  turned["volumes"]["head"]["place"].erase("scale");
  const BuiltScene fitted = buildScene(parseScene(turned.dump(), "s.json", folder.path()));
  const Placement& place = fitted.placements.at("head");
  const Vec3 centre = fitted.volumes.at("head")->info().bounds.centre();
  CHECK((place(centre) - Vec3(0.01, 0, 0.02)).norm() < 1e-12);
  const Vec3 along_x = place(centre + Vec3::UnitX()) - place(centre);
  CHECK((along_x - place.scale * Vec3::UnitY()).norm() < 1e-12);
  CHECK(place.scale * fitted.volumes.at("head")->info().bounds.size().maxCoeff() == Approx(0.1));

  const auto refused = [&](int mode, const char* key, const Json& value, const char* says) {
    Json bad = scene;
    if (value.is_null()) {
      bad["modes"][static_cast<std::size_t>(mode)].erase(key);
    } else {
      bad["modes"][static_cast<std::size_t>(mode)][key] = value;
    }
    CAPTURE(bad["modes"][static_cast<std::size_t>(mode)].dump());
    CHECK_THAT(parseError(bad.dump()), Contains(says));
    CHECK_FALSE(schemaAccepts(bad));
  };
  refused(0, "friction", "rough", "is neither a number nor an object");
  refused(2, "friction", 0.1, "mode transverse_damping does not have this key");
  refused(3, "snap_drag", 0, "0 is not > 0");
  refused(3, "two_sided", 1, "1 is not true or false");
  refused(4, "of", nullptr, "\"of\" is missing");
  refused(5, "of", "head", "mode guide, shape point does not have this key");
  refused(5, "along", {0, 0, 1}, "a point has no direction");
  refused(5, "at", nullptr, "\"at\" is missing");
  refused(6, "along", nullptr, "\"along\" is missing");
  refused(6, "at", {1, 2}, "not a list of 3 numbers");
  refused(7, "snap", -1, "-1 is not > 0");
  refused(7, "shape", "force", "is not known");
  Json bad = scene;
  bad["modes"][5]["in"] = "haed";
  CHECK_THROWS_WITH(buildScene(parseScene(bad.dump(), "s.json", folder.path())),
                    Contains("s.json: /modes/5/in") && Contains("did you mean \"head\"?"));
  bad = scene;
  bad["modes"][6]["along"] = {0, 0, 0};
  CHECK_THROWS_WITH(buildScene(parseScene(bad.dump(), "s.json", folder.path())),
                    Contains("s.json: /modes/6/along"));
  bad = scene;
  bad["coupling"]["stiffness"] = {{"window", {{"level", 0}, {"width", 1}, {"max", 500}}},
                                  {"by", "head"}};
  CHECK_THROWS_WITH(buildScene(parseScene(bad.dump(), "s.json", folder.path())),
                    Contains("s.json: /coupling/stiffness: its lowest value is zero"));
  bad["coupling"]["stiffness"] = {{"piecewise", {{0, 100}, {1, 200}}}};
  CHECK_THROWS_WITH(buildScene(parseScene(bad.dump(), "s.json", folder.path())),
                    Contains("s.json: /coupling/stiffness") && Contains("\"by\""));
}

TEST_CASE(
    "a transfer function reads the same values, in the file's units, at two sizes of the scene",
    "[scene][graph]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  Json scene = fullScene();
  const auto built = [&](double fit) {
    scene["volumes"]["head"]["place"] = {{"fit", fit}};
    return buildScene(parseScene(scene.dump(), "s.json", folder.path()));
  };
  const BuiltScene small = built(0.1);
  const BuiltScene large = built(0.37);
  Reader small_reader;
  Reader large_reader;
  small_reader.bind(*small.scene);
  large_reader.bind(*large.scene);
  Properties a;
  Properties b;
  int inside = 0;
  for (int i = 0; i < 1000; ++i) {
    // p is in the file's space, so both scenes read the same point.
    const Vec3 p = 4.0 * Vec3(std::fmod(0.754877 * i, 1.0), std::fmod(0.569840 * i, 1.0),
                              std::fmod(0.381966 * i, 1.0));
    (void)small_reader.sample(*small.scene, small.placements.at("head")(p), a);
    (void)large_reader.sample(*large.scene, large.placements.at("head")(p), b);
    for (std::size_t j = 0; j < small.scene->graph.scalar_properties.size(); ++j) {
      CAPTURE(p, small.scene->graph.scalar_properties[j]);
      REQUIRE(a.scalars[j].inside == b.scalars[j].inside);
      if (!a.scalars[j].inside) continue;
      ++inside;
      REQUIRE(a.scalars[j].value == Approx(b.scalars[j].value).epsilon(1e-9).margin(1e-9));
    }
  }
  CHECK(inside > 1000);
}

}  // namespace palpate::scene_test
