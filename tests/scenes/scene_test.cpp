#include <fstream>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validator.hpp>

#include "engine/error.h"
#include "engine/step.h"
#include "samplers/analytic_field.h"
#include "scenes/scene_file.h"
#include "tests/support/vdb_files.h"

using namespace palpate;
using namespace palpate::test;
using Catch::Contains;
using Json = nlohmann::json;

namespace {

/// A scene with all that this version has, over linear.vdb.
Json fullScene() {
  return Json::parse(R"({
    "$schema": "scene.schema.json", "description": "all of it", "palpate": 1,
    "coupling": {"stiffness": 400, "damping": 0.5},
    "accuracy": {"max_substeps": 16},
    "volumes": {
      "head": {"file": "linear.vdb", "grid": "density", "place": {"fit": 0.1}, "interpolation": "trilinear"},
      "flow": {"file": "linear.vdb", "grid": "velocity", "place": {"like": "head"}},
      "true": {"file": "linear.vdb", "grid": "density", "place": {"unit": "mm"}},
      "turned": {"file": "linear.vdb", "grid": "density",
                 "place": {"scale": 0.01, "rotation_wxyz": [0.7071, 0, 0, 0.7071], "translate": [0, 0, 0.1]}}
    },
    "fields": {
      "speed": {"magnitude": "flow"}, "spin": {"curl": "flow"}, "source": {"divergence": "flow"},
      "slope": {"gradient": "head"}, "swirl": {"magnitude": "spin"}
    },
    "modes": [
      {"name": "bone", "mode": "isosurface", "of": "head", "value": 1, "solid": "above", "strength": 3, "depth": 2},
      {"mode": "surface", "of": "head", "solid": "below", "strength": {"window": {"level": 1, "width": 2, "max": 1}}},
      {"mode": "viscosity", "of": "head", "strength": 0.1, "by": "swirl"},
      {"name": "stream", "mode": "follow", "of": "flow", "strength": {"piecewise": [[0, 0], [0.3, 1], [1, 2]]}, "by": "speed"},
      {"mode": "force", "of": "spin", "strength": 0.2, "sense": "repel"},
      {"mode": "force", "of": "slope", "strength": {"window": {"level": 0, "width": 1, "max": 1}}, "by": "source"}
    ]})");
}

bool schemaAccepts(const Json& json) {
  const Json text = Json::parse(sceneSchema());
  valijson::Schema schema;
  valijson::SchemaParser parser;
  parser.populateSchema(valijson::adapters::NlohmannJsonAdapter(text), schema);
  valijson::Validator validator;
  return validator.validate(schema, valijson::adapters::NlohmannJsonAdapter(json), nullptr);
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

TEST_CASE("a scene with everything is read, placed and compiled", "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  const SceneSpec spec = parseScene(fullScene().dump(), "s.json", folder.path());
  CHECK(spec.coupling.stiffness == 400);
  CHECK(spec.step.max_substeps == 16);
  CHECK(spec.graph.modes[0].depth_voxels == 2);
  CHECK(spec.graph.modes[4].sense == Sense::kRepel);
  const BuiltScene built = buildScene(spec);
  CHECK(built.scene->graph.modes.size() == 6);
  CHECK(built.scene->graph.unused == std::vector<std::string>{"true", "turned"});

  // fit: 4 units become 0.1 m, centred.
  CHECK(built.placements.at("head").scale == Approx(0.1 / 4.0));
  CHECK(built.placements.at("head")(Vec3::Constant(2.0)).norm() < 1e-15);
  CHECK(built.placements.at("flow")({1, 2, 3}) == built.placements.at("head")({1, 2, 3}));
  CHECK(built.placements.at("true").scale == 1e-3);
  CHECK((built.placements.at("turned")({1, 0, 0}) - Vec3(0, 0.01, 0.1)).norm() < 1e-6);
}

TEST_CASE("the schema and the reader accept and refuse the same files", "[scene][schema]") {
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
      {"/volumes", Json::object(), "/volumes: there is no volume"},
      {"/volumes/head/fil", "a", "/volumes/head/fil: unknown key: did you mean \"file\"?"},
      {"/volumes/head/file", 3, "/volumes/head/file: 3 is not a text"},
      {"/volumes/head/file", "", "/volumes/head/file: it is empty"},
      {"/volumes/head/interpolation", "quintic", "cubic"},
      {"/volumes/head/axial", 1, "/volumes/head/axial: 1 is not true or false"},
      {"/volumes/head/non_finite", "ignore", "use one of refuse, fill"},
      {"/volumes/head/smooth", 1.5, "not a whole number from 0 to 16"},
      {"/volumes/head/instances", Json::array(), "this version does not have it yet"},
      {"/volumes/head/place/fit", -1, "/volumes/head/place/fit: -1 is not > 0"},
      {"/volumes/head/place/unit", "mm", "none or several of its kinds"},
      {"/volumes/head/place", Json::object(), "none or several of its kinds"},
      {"/volumes/turned/place/translate", {1, 2}, "not a list of 3 numbers"},
      {"/volumes/true/place/unit", "inch", "\"inch\" is not known: use one of m, cm, mm, um"},
      {"/fields/speed", Json::object(), "give one of magnitude"},
      {"/fields/speed/curl", "flow", "give one of magnitude"},
      {"/modes", Json::object(), "/modes: it is not a list"},
      {"/modes/0/mode", "isosurfce", "did you mean \"isosurface\"?"},
      {"/modes/0/strength", -1, "/modes/0/strength: -1 is negative"},
      {"/modes/0/strength", "strong", "it is not an object"},
      {"/modes/0/strength", {{"product", {1, 2}}}, "this version does not have it yet"},
      {"/modes/0/strength", {{"piecewise", Json::array()}}, "it is not a list of points"},
      {"/modes/1/strength/window/width", 0, "/modes/1/strength/window/width: 0 is not > 0"},
      {"/modes/0/friction", 0.3, "/modes/0/friction: this version does not have it yet"},
      {"/modes/0/solid", "inside", "\"inside\" is not known"},
      {"/modes/0/sense", "repel", "mode isosurface has no such key"},
      {"/modes/3/value", 1, "mode follow has no such key"},
      {"/modes/0/depth", 0, "/modes/0/depth: 0 is not > 0"},
      {"/coupling/stiffness", 0, "/coupling/stiffness: 0 is not > 0"},
      {"/coupling/stiffness", nullptr, "null is not a number"},
      {"/coupling/stiffness", {{"window", 1}}, "does not have a varying stiffness yet"},
      {"/coupling/damping", -0.1, "/coupling/damping: -0.1 is negative"},
      {"/accuracy/max_substeps", 2.5, "not a whole number"},
      {"/accuracy/max_substeps", 0, "not a whole number"},
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
        "/modes/0/strength", "/modes/0/value", "/modes/1/strength/window/max"}) {
    const Json::json_pointer pointer(needed);
    Json scene = fullScene();
    scene[pointer.parent_pointer()].erase(pointer.back());
    CAPTURE(needed);
    CHECK_THAT(parseError(scene.dump()), Contains("is missing"));
    CHECK_FALSE(schemaAccepts(scene));
  }
}

TEST_CASE("bad JSON is one line, and no key may stand twice", "[scene]") {
  CHECK_THAT(parseError("{\n\"palpate\": 1,,\n}"),
             Contains("not valid JSON") && Contains("line 2"));
  CHECK_THAT(parseError(""), Contains("not valid JSON"));
  CHECK_THAT(parseError("[1, 2]"), Contains("it is not an object"));
  CHECK_THAT(parseError(R"({"palpate": 1, "palpate": 1})"),
             Contains("\"palpate\" stands twice in one object"));
  CHECK_THAT(parseError(R"({"palpate": 1e999})"), Contains("not valid JSON"));
  CHECK_THAT(parseError(R"({"palpate": NaN})"), Contains("not valid JSON"));
  CHECK_THAT(parseError(std::string(100000, '[') + std::string(100000, ']')),
             Contains("nested deeper"));
}

TEST_CASE("what only loading can see is named by file and path too", "[scene]") {
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
  CHECK_THAT(error("/volumes/head/axial", true),
             Contains("s.json: /volumes/head: ") && Contains("only a vector"));
  CHECK_THAT(error("/volumes/flow/place/like", "haed"),
             Contains("/volumes/flow/place/like") && Contains("did you mean \"head\"?"));
  CHECK_THAT(error("/volumes/head/place", {{"like", "flow"}}), Contains("in a circle"));
  CHECK_THAT(error("/modes/0/of", "flow"), Contains("s.json: /modes/0/of"));
  CHECK_THAT(error("/modes/0/of", "heads"), Contains("did you mean \"head\"?"));
  CHECK_THAT(error("/fields/swirl/magnitude", "swirl"), Contains("derived from itself"));
}

TEST_CASE("what smoothing takes away is noted, and changes what is felt", "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  Json scene = fullScene();
  CHECK(buildScene(parseScene(scene.dump(), "s.json", folder.path())).notes.empty());
  scene["volumes"]["head"]["smooth"] = 2;
  scene["volumes"]["head"]["non_finite"] = "fill";
  const BuiltScene built = buildScene(parseScene(scene.dump(), "s.json", folder.path()));
  REQUIRE(built.notes.size() == 1);
  CHECK_THAT(built.notes.front(), Contains("s.json: /volumes/head: smoothed over 2 voxels"));
  CHECK(built.volumes.at("head")->info().smoothing.width == 2);
}

TEST_CASE("the bounds of a scene hold its volumes wherever they are", "[scene]") {
  SceneSpec spec;
  spec.volumes["far"].field = makeSphere(Vec3::Constant(-5.0), 0.04);
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "far";
  spec.graph.modes = {skin};
  const BuiltScene built = buildScene(spec);
  CHECK((built.bounds.centre() - Vec3::Constant(-5.0)).norm() < 1e-12);
}

TEST_CASE("a coupling stiffer than the device is refused with its path", "[scene]") {
  SceneSpec spec;
  spec.source = "s.json";
  spec.coupling.stiffness = 1500;
  CHECK_THROWS_WITH(
      checkDevice(spec, "arm", 1000),
      Contains("s.json: /coupling/stiffness: 1500 N/m") && Contains("use at most 1000"));
  CHECK_NOTHROW(checkDevice(spec, "arm", 1500));
}

TEST_CASE("a bare .vdb gets a mode that suits each grid", "[scene]") {
  const TemporaryFolder folder;
  writeTestVolumes(folder.path());
  SceneSpec spec = openScene(folder / "mixed.vdb");
  REQUIRE(spec.graph.modes.size() == 1);
  CHECK(spec.graph.modes[0].kind == ModeKind::kIsosurface);
  CHECK(spec.graph.modes[0].solid == Solid::kBelow);
  REQUIRE(spec.notes.size() == 1);
  CHECK_THAT(spec.notes[0], Contains("grid \"labels\"") && Contains("int32"));

  spec = openScene(folder / "linear.vdb");
  REQUIRE(spec.graph.modes.size() == 3);
  CHECK(spec.graph.modes[0].kind == ModeKind::kSurface);
  CHECK(spec.graph.modes[1].kind == ModeKind::kViscosity);
  CHECK(spec.graph.modes[2].kind == ModeKind::kFollow);

  // A folder: every grid that can be felt, in the order of the files, placed like the first.
  spec = openScene(folder.path());
  CHECK(spec.volumes.size() == 4);
  CHECK(spec.volumes.count("linear.density") == 1);
  CHECK(spec.notes.size() == 3);
  const BuiltScene built = buildScene(spec);
  CHECK(built.placements.at("ball.ball").scale == built.placements.at("linear.density").scale);

  CHECK_THROWS_WITH(openScene(folder / "labels.vdb"), Contains("none of its grids can be felt"));
  CHECK_THROWS_WITH(openScene(folder / "none.vdb"), Contains("no such file"));
}

TEST_CASE("a scene built in C++ passes the same checks", "[scene]") {
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

TEST_CASE("the example scenes are valid", "[scene][schema]") {
  for (const auto& entry : std::filesystem::directory_iterator(PALPATE_EXAMPLES)) {
    CAPTURE(entry.path().string());
    CHECK_NOTHROW(readSceneFile(entry.path()));
  }
}
