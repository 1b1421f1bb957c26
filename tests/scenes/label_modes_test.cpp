/// Tests modes of one label of a volume.
#include <string>
#include <vector>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/labels.h"
#include "palpate/scenes/library/nearby.h"
#include "tests/support/built_scene.h"
#include "tests/support/vdb_grids.h"

namespace palpate::label_modes_test {
using namespace palpate::test;
using Catch::Contains;
using Json = nlohmann::json;

namespace {

/// Writes organs.vdb: 40^3 voxels of 1 mm from 0. Label 1, "liver", is at x from 5 to 14, label 2,
/// "spleen", at x from 25 to 34, and label 3 is a single voxel. The liver's faces are at 4.5 and
/// 14.5 mm.
void writeOrgans(const std::filesystem::path& folder) {
  const auto grid = makeGrid<openvdb::FloatGrid>(
      40, openvdb::math::Transform::createLinearTransform(1.0),
      [](const openvdb::Vec3d& p) {
        if (p == openvdb::Vec3d(20.0)) return 3.0F;
        const bool within = p.y() > 4.5 && p.y() < 34.5 && p.z() > 4.5 && p.z() < 34.5;
        if (!within || p.x() < 4.5 || p.x() > 34.5) return 0.0F;
        return p.x() < 14.5 ? 1.0F : (p.x() > 24.5 ? 2.0F : 0.0F);
      },
      "organs");
  insertLabels(*grid, {{1.0, "liver", Vec3(0.8, 0.5, 0.25)}, {2.0, "spleen", std::nullopt}});
  writeVdb(folder / "organs.vdb", {grid});
}

Json organs() {
  return Json::parse(R"({
    "palpate": 1, "coupling": {"stiffness": 400},
    "volumes": {"organs": {"file": "organs.vdb", "interpolation": "nearest", "place": {"scale": 0.001}}},
    "modes": [
      {"name": "soft", "mode": "isosurface", "of": "organs", "label": "liver", "strength": 0.5},
      {"name": "hard", "mode": "isosurface", "of": "organs", "label": 2, "strength": 3, "friction": 0.4}]})");
}

/// Returns the force on a hand that has moved slowly from `from` to `to` [N].
Vec3 forceAfter(const Scene& scene, const Vec3& from, const Vec3& to) {
  Reader reader;
  ProxyState state;
  Vec3 force = Vec3::Zero();
  constexpr int kTicks = 400;
  for (int i = 0; i <= kTicks; ++i) {
    const Vec3 probe = from + (to - from) * i / kTicks;
    force = hapticStep(scene, reader, {probe}, state, 1e-3).force;
  }
  return force;
}

}  // namespace

TEST_CASE("a mode of a label acts at this label's faces only, with its own strength", "[labels]") {
  const TemporaryFolder folder;
  writeOrgans(folder.path());
  const BuiltScene scene = built(organs(), folder.path());
  CHECK(scene.notes.empty());
  // The hand is 1 mm inside of a face, so the spring of 400 N/m needs 0.4 N: both labels hold.
  const auto at = [](double x) { return Vec3(x, 0.02, 0.02); };
  CHECK(forceAfter(*scene.scene, at(0.018), at(0.0135)).x() == Approx(0.4).margin(0.004));
  CHECK(forceAfter(*scene.scene, at(0.018), at(0.0255)).x() == Approx(-0.4).margin(0.004));
  // At 5 mm the spring needs 2 N: the liver yields at 0.5 N, the spleen holds.
  CHECK(forceAfter(*scene.scene, at(0.018), at(0.0095)).norm() < 0.6);
  CHECK(forceAfter(*scene.scene, at(0.018), at(0.0295)).x() == Approx(-2.0).margin(0.02));
  // Label 3 has no mode, so it gives no force.
  CHECK(forceAfter(*scene.scene, at(0.017), at(0.022)).norm() < 1e-9);

  const auto& mask = scene.computed.at("organs:liver");
  CHECK(mask.from == "organs");
  CHECK(mask.as == "label liver of organs, smoothed with sigma = 1 voxels");
  CHECK(mask.why == "mode \"soft\" needs its surface");
  CHECK(scene.volumes.at("organs:liver")->info().colour == Vec3(0.8, 0.5, 0.25));
}

TEST_CASE("modes with equal labels share a mask, which a scene cache keeps", "[labels]") {
  const TemporaryFolder folder;
  writeOrgans(folder.path());
  Json scene = organs();
  scene["modes"][1]["label"] = Json::array({"liver", 2});
  scene["modes"].push_back(scene["modes"][0]);
  scene["modes"].push_back(scene["modes"][0]);
  scene["modes"][3]["smooth"] = 0.5;
  scene["modes"][3]["solid"] = "below";
  SceneCache cache;
  const BuiltScene first = built(scene, folder.path(), &cache);
  CHECK(first.volumes.size() == 4);
  CHECK(first.volumes.count("organs:liver+2") == 1);
  CHECK(first.volumes.count("organs:liver (smooth 0.5)") == 1);
  scene["modes"][0]["strength"] = 1;
  const BuiltScene second = built(scene, folder.path(), &cache);
  CHECK(second.volumes.at("organs:liver") == first.volumes.at("organs:liver"));
  CHECK(second.scene->shape == first.scene->shape);
}

TEST_CASE("the mask of a label moves with the label volume and has its instances", "[labels]") {
  const TemporaryFolder folder;
  writeOrgans(folder.path());
  Json moving = organs();
  moving["volumes"]["organs"]["place"]["keyframes"] =
      Json::parse(R"([{"time": 0}, {"time": 1, "translate": [0.01, 0, 0]}])");
  const BuiltScene moved = built(moving, folder.path());
  CHECK(moved.motions.at("organs:liver") == moved.motions.at("organs"));
  Json many = organs();
  many["volumes"]["organs"].erase("place");
  many["volumes"]["organs"]["instances"] =
      Json::parse(R"([{"scale": 0.001}, {"scale": 0.001, "translate": [0.1, 0, 0]}])");
  const SceneSpec spec = parseScene(many.dump(), "scene.json", folder.path());
  const BuiltScene placed = buildScene(spec);
  CHECK(placed.scene->parts.size() == 2);
  const Vec3 from(0.118, 0.02, 0.02);
  const Vec3 to(0.1135, 0.02, 0.02);
  CHECK(forceAfter(*placed.scene, from, to).x() == Approx(0.4).margin(0.004));
  const BuiltScene one = buildScene(nearby(spec, placed, {1}));
  CHECK(forceAfter(*one.scene, from, to).x() == Approx(0.4).margin(0.004));
}

TEST_CASE("a label that does not exist is refused with the labels that exist", "[labels]") {
  const TemporaryFolder folder;
  writeOrgans(folder.path());
  const auto with = [&](const char* key, const Json& value) {
    Json scene = organs();
    scene["modes"][1][key] = value;
    return refusal(scene, folder.path());
  };
  CHECK_THAT(with("label", 9), Contains("scene.json: /modes/1/label") &&
                                   Contains("no voxel with the label 9") &&
                                   Contains("choose from 1 liver, 2 spleen"));
  CHECK_THAT(with("label", "Liver"), Contains("no voxel with the label Liver"));
  CHECK_THAT(with("label", 1.5), Contains("/modes/1/label"));
  CHECK_THAT(with("label", true), Contains("true is not a label"));
  CHECK_THAT(with("label", Json::array()), Contains("it is an empty list"));
  CHECK_THAT(with("value", 0.5), Contains("none or several of the keys value, label"));
  CHECK_THAT(with("of", "organ"), Contains("/modes/1/of") && Contains("did you mean \"organs\""));
  CHECK_THAT(with("smooth", 40), Contains("/modes/1/smooth"));

  Json scene = organs();
  scene["modes"][1].erase("label");
  scene["modes"][1]["value"] = 0.5;
  scene["modes"][1]["smooth"] = 1;
  CHECK_THAT(refusal(scene, folder.path()), Contains("smooth") && Contains("remove it"));
  scene = organs();
  scene["volumes"]["organs"]["smooth"] = 1.0;
  CHECK_THAT(refusal(scene, folder.path()), Contains("blends its labels"));
  scene = organs();
  scene["volumes"]["organs:liver"] = scene["volumes"]["organs"];
  CHECK_THAT(refusal(scene, folder.path()), Contains("has this name"));
}

TEST_CASE("a label that smoothing removes gets a note", "[labels]") {
  const TemporaryFolder folder;
  writeOrgans(folder.path());
  Json scene = organs();
  scene["modes"][1]["label"] = 3;
  const BuiltScene thin = built(scene, folder.path());
  REQUIRE(thin.notes.size() == 1);
  CHECK_THAT(thin.notes[0],
             Contains("/modes/1/smooth: a Gaussian of 1 voxels removes the whole label"));
  scene["modes"][1]["smooth"] = 0;
  CHECK(built(scene, folder.path()).notes.empty());
}

}  // namespace palpate::label_modes_test
