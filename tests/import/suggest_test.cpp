#include "palpate/scenes/import/suggest.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <set>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>
#include <openvdb/tools/ChangeBackground.h>
#include <tbb/global_control.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/scene_file.h"
#include "tests/support/vdb_grids.h"

using namespace palpate;
using namespace palpate::importer;
using namespace palpate::test;
using Catch::Contains;
using openvdb::Vec3d;
using openvdb::Vec3f;
using Json = nlohmann::json;

namespace {

using Scalar = std::function<float(const Vec3d&)>;
using Vector = std::function<Vec3f(const Vec3d&)>;

/// Of deviation 1 about 0, the same for the same place: a sum of 12 uniform numbers.
double noise(const Vec3d& p) {
  std::uint64_t x = 0x1234567ULL;
  for (int axis = 0; axis < 3; ++axis) {
    x = (x ^ static_cast<std::uint64_t>(std::llround(p[axis] * 16.0) + 100'000)) *
        0x9e3779b97f4a7c15ULL;
    x ^= x >> 29;
  }
  double sum = -6.0;
  for (int i = 0; i < 12; ++i) {
    x = x * 6364136223846793005ULL + 1442695040888963407ULL;
    sum += static_cast<double>(x >> 11) * 0x1p-53;
  }
  return sum;
}

/// A block of n^3 voxels of 1 about the origin.
openvdb::math::Transform::Ptr centred(int n) {
  auto transform = openvdb::math::Transform::createLinearTransform(1.0);
  transform->postTranslate(Vec3d(-0.5 * (n - 1)));
  return transform;
}
SuggestInput scalar(const Scalar& value, int n = 48, const std::string& name = "density") {
  SuggestInput input;
  auto grid = makeGrid<openvdb::FloatGrid>(n, centred(n), value, name);
  // As the importer has it: the surroundings of an image are its background.
  openvdb::tools::changeBackground(grid->tree(), value(grid->indexToWorld(Vec3d(0.0))));
  input.grid = grid;
  input.extent.reset({0, 0, 0}, {n - 1, n - 1, n - 1});
  return input;
}
SuggestInput vector(const Vector& value, const std::string& name = "velocity", int n = 32) {
  SuggestInput input;
  input.grid = makeGrid<openvdb::Vec3SGrid>(n, centred(n), value, name);
  input.extent.reset({0, 0, 0}, {n - 1, n - 1, n - 1});
  return input;
}
/// A mesh's: there is nothing beyond its voxels.
SuggestInput ofMesh(SuggestInput input) {
  input.inactive_is_data = false;
  return input;
}

std::vector<double> outputsOf(const Json& strength) {
  if (strength.is_number()) return {strength.get<double>()};
  std::vector<double> outputs;
  for (const Json& knot : strength.at("piecewise")) outputs.push_back(knot.at(1).get<double>());
  return outputs;
}

/// The scene, after what holds for all of them.
Json suggest(const std::vector<SuggestInput>& grids) {
  const std::string text = suggestScene("data.vdb", grids);
  CAPTURE(text);
  const SceneSpec spec = parseScene(text, "suggested.json", "/data");
  const Json scene = Json::parse(text);
  CHECK(scene["modes"].size() >= 1);
  CHECK(scene["modes"].size() <= 5);
  CHECK_THAT(scene["description"].get<std::string>(), Contains("first guess"));
  std::set<std::string> names;
  for (const Json& mode : scene["modes"]) {
    CHECK(names.insert(mode.at("name")).second);
    CHECK_FALSE(mode.at("description").get<std::string>().empty());
    for (const double strength : outputsOf(mode.at("strength"))) {
      CHECK(std::isfinite(strength));
      CHECK(strength >= 0.0);
      CHECK(strength <= 5.0);
    }
  }
  int fits = 0;
  for (const auto& [name, volume] : spec.volumes) {
    CHECK(volume.file == "/data/data.vdb");
    fits += volume.place.kind == PlaceSpec::Kind::kFit ? 1 : 0;
  }
  CHECK(fits == 1);
  return scene;
}

std::vector<Json> modesOf(const Json& scene, const std::string& kind) {
  std::vector<Json> modes;
  for (const Json& mode : scene["modes"]) {
    if (mode["mode"] == kind) modes.push_back(mode);
  }
  return modes;
}

Json only(const Json& scene, const std::string& kind) {
  const std::vector<Json> modes = modesOf(scene, kind);
  CAPTURE(scene.dump(2));
  REQUIRE(modes.size() == 1);
  return modes[0];
}

Scalar ball(double radius, double inside, double outside, double deviation) {
  return [=](const Vec3d& p) {
    return static_cast<float>((p.length() < radius ? inside : outside) + deviation * noise(p));
  };
}

/// Air, fat and muscle, bone, brain; smoothed over two voxels.
float headInHounsfield(const Vec3d& p) {
  const double r = p.length();
  const auto step = [r](double radius) { return 1.0 / (1.0 + std::exp((r - radius) / 0.5)); };
  return static_cast<float>(-1000.0 + 1050.0 * step(20.0) + 950.0 * step(15.0) -
                            960.0 * step(11.0) + 10.0 * noise(p));
}

}  // namespace

TEST_CASE("a ball in air has one surface, at the middle of their values", "[suggest]") {
  const double deviation = GENERATE(0.0, 10.0, 50.0);
  CAPTURE(deviation);
  const Json scene = suggest({scalar(ball(16.0, 1000.0, 0.0, deviation))});
  const Json mode = only(scene, "isosurface");
  CHECK(mode["value"].get<double>() == Approx(500.0).margin(60.0));
  CHECK(mode["solid"] == "above");
  CHECK_THAT(mode["description"].get<std::string>(), Contains("first guess"));
}

TEST_CASE("a dark ball is solid below", "[suggest]") {
  const Json scene = suggest({scalar(ball(16.0, 100.0, 900.0, 10.0))});
  const Json mode = only(scene, "isosurface");
  CHECK(mode["value"].get<double>() == Approx(500.0).margin(60.0));
  CHECK(mode["solid"] == "below");
}

TEST_CASE("a blurred ball has the same surface", "[suggest]") {
  const double width = GENERATE(0.5, 1.0, 2.0);
  CAPTURE(width);
  const Json scene = suggest({scalar([width](const Vec3d& p) {
    return static_cast<float>(1000.0 / (1.0 + std::exp((p.length() - 14.0) / width)) +
                              5.0 * noise(p));
  })});
  CHECK(only(scene, "isosurface")["value"].get<double>() == Approx(500.0).margin(60.0));
}

TEST_CASE("the surface is found where the surroundings were left out", "[suggest]") {
  // As the importer leaves them: inactive, their value the background.
  const double deviation = GENERATE(0.0, 20.0);
  auto grid = openvdb::FloatGrid::create(0.0F);
  grid->setName("density");
  for (int i = -18; i <= 18; ++i) {
    for (int j = -18; j <= 18; ++j) {
      for (int k = -18; k <= 18; ++k) {
        const Vec3d p(i, j, k);
        if (p.length() > 16.0) continue;
        grid->tree().setValue({i, j, k}, static_cast<float>(1000.0 + deviation * noise(p)));
      }
    }
  }
  SuggestInput input;
  input.grid = grid;
  CHECK(only(suggest({input}), "isosurface")["value"].get<double>() == Approx(500.0).margin(60.0));

  // Of a mesh the same voxels have no boundary: there are no data beyond.
  if (deviation == 0.0) {
    CHECK_THROWS_AS(suggestScene("data.vdb", {ofMesh(input)}), VolumeError);
  } else {
    CHECK(modesOf(suggest({ofMesh(input)}), "isosurface").empty());
  }
}

TEST_CASE("where the image cuts an object there is no surface", "[suggest]") {
  // A slab that four faces of the image cut.
  const auto value = [](const Vec3d& p) {
    return static_cast<float>((p.z() > 8.0 ? 0.0 : 500.0) + 3.0 * noise(p));
  };
  const Json scene = suggest({scalar(value)});
  CHECK(only(scene, "isosurface")["value"].get<double>() == Approx(250.0).margin(30.0));
  // Its edges alone are none.
  SuggestInput block = scalar([](const Vec3d& p) { return static_cast<float>(noise(p)); });
  auto grid = openvdb::gridConstPtrCast<openvdb::FloatGrid>(block.grid)->deepCopy();
  openvdb::tools::changeBackground(grid->tree(), -1000.0F);
  block.grid = grid;
  CHECK(modesOf(suggest({block}), "isosurface").empty());
}

TEST_CASE("nested shells have two surfaces, the outer one weaker", "[suggest]") {
  const double deviation = GENERATE(0.0, 8.0);
  CAPTURE(deviation);
  const Json scene = suggest({scalar([deviation](const Vec3d& p) {
    const double r = p.length();
    return static_cast<float>((r < 10.0 ? 300.0 : (r < 19.0 ? 100.0 : 0.0)) + deviation * noise(p));
  })});
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(50.0).margin(15.0));
  CHECK(surfaces[1]["value"].get<double>() == Approx(200.0).margin(30.0));
  CHECK(surfaces[0]["strength"].get<double>() < surfaces[1]["strength"].get<double>());
  // Between them a drag.
  const Json knots = only(scene, "viscosity")["strength"]["piecewise"];
  CHECK(knots.front()[0] == surfaces[0]["value"]);
  CHECK(knots.back()[0] == surfaces[1]["value"]);
}

TEST_CASE("bone without an upper value is found where tissue ends", "[suggest]") {
  // As raw CT: air 0, tissue 1050, and bone of any value to 2500.
  const Json scene = suggest({scalar([](const Vec3d& p) {
    const double r = p.length();
    const double bone = 1800.0 + 600.0 * std::sin(0.9 * p.x()) * std::cos(1.1 * p.y() + p.z());
    return static_cast<float>((r < 19.0 ? (r < 15.0 && r > 11.0 ? bone : 1050.0) : 20.0) +
                              15.0 * noise(p));
  })});
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(535.0).margin(60.0));
  CHECK(surfaces[1]["value"].get<double>() > 1080.0);
  CHECK(surfaces[1]["value"].get<double>() < 1500.0);
}

TEST_CASE("CT has skin, soft tissue and bone by Hounsfield's scale", "[suggest]") {
  SuggestInput input = scalar(headInHounsfield);
  input.modality = Modality::kCt;
  const Json scene = suggest({input});
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["name"] == "skin");
  CHECK(surfaces[0]["value"] == -300);
  CHECK(surfaces[1]["name"] == "bone");
  CHECK(surfaces[1]["value"].get<double>() >= 150.0);
  CHECK(surfaces[1]["value"].get<double>() <= 500.0);
  CHECK(surfaces[0]["strength"].get<double>() <= 1.5);
  CHECK(surfaces[1]["strength"].get<double>() >= 3.0);
  const std::vector<double> drag = outputsOf(only(scene, "viscosity")["strength"]);
  CHECK(*std::max_element(drag.begin(), drag.end()) <= 0.3);
}

TEST_CASE("CT without bone has no bone", "[suggest]") {
  SuggestInput input = scalar(ball(16.0, 40.0, -1000.0, 10.0));
  input.modality = Modality::kCt;
  input.value_unit = "HU";
  CHECK(only(suggest({input}), "isosurface")["name"] == "skin");
}

TEST_CASE("CT whose values are raw is looked at as any image", "[suggest]") {
  SuggestInput input = scalar([](const Vec3d& p) { return headInHounsfield(p) + 1024.0F; });
  input.modality = Modality::kCt;
  const std::vector<Json> surfaces = modesOf(suggest({input}), "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(550.0).margin(100.0));
  CHECK(surfaces[1]["value"].get<double>() > 1100.0);
  CHECK(surfaces[1]["value"].get<double>() < 1750.0);
}

TEST_CASE("MR has one low skin surface, and a drag by the signal", "[suggest]") {
  SuggestInput input = scalar([](const Vec3d& p) {
    const double r = p.length();
    return static_cast<float>((r < 18.0 ? (r < 10.0 ? 120.0 : 60.0) : 4.0) +
                              2.0 * std::abs(noise(p)));
  });
  input.modality = Modality::kMr;
  const Json scene = suggest({input});
  const Json skin = only(scene, "isosurface");
  CHECK(skin["value"].get<double>() > 6.0);
  CHECK(skin["value"].get<double>() < 35.0);
  CHECK(modesOf(scene, "viscosity").size() == 1);
}

TEST_CASE("where nothing has a boundary there is a drag by value", "[suggest]") {
  const auto ramp = [](const Vec3d& p) { return static_cast<float>(p.x()); };
  const auto noisy = [](const Vec3d& p) { return static_cast<float>(p.x() + noise(p)); };
  const auto blob = [](const Vec3d& p) {
    return static_cast<float>(std::exp(-0.5 * p.lengthSqr() / 100.0));
  };
  const auto pressure = [](const Vec3d& p) {
    return static_cast<float>(101325.0 + 5.0 * std::sin(0.1 * p.y()));
  };
  for (const Scalar& value : {Scalar(ramp), Scalar(noisy), Scalar(blob), Scalar(pressure)}) {
    for (const bool mesh : {false, true}) {
      SuggestInput input = scalar(value);
      if (mesh) input = ofMesh(input);
      const Json scene = suggest({input});
      CHECK(modesOf(scene, "isosurface").empty());
      const Json knots = only(scene, "viscosity")["strength"]["piecewise"];
      CHECK(knots.front()[0].get<double>() < knots.back()[0].get<double>());
    }
  }
}

TEST_CASE("noise alone is no surface", "[suggest]") {
  const Json scene =
      suggest({scalar([](const Vec3d& p) { return static_cast<float>(10.0 * noise(p)); })});
  CHECK(modesOf(scene, "isosurface").empty());
}

TEST_CASE("what does not vary is refused, with what there was", "[suggest]") {
  const SuggestInput still = vector([](const Vec3d&) { return Vec3f(0.0F, -15.0F, 0.0F); }, "vel");
  const SuggestInput same = scalar([](const Vec3d&) { return 3.0F; }, 16, "same");
  CHECK_THROWS_WITH(
      suggestScene("data.vdb", {same, still}),
      Contains("same (nearly all values alike)") && Contains("vel (nearly all values alike)"));
  CHECK_THROWS_AS(suggestScene("data.vdb", {}), VolumeError);
  SuggestInput empty;
  empty.grid = openvdb::FloatGrid::create();
  CHECK_THROWS_AS(suggestScene("data.vdb", {empty}), VolumeError);
}

TEST_CASE("values that are not finite change nothing", "[suggest]") {
  const auto value = ball(16.0, 1000.0, 0.0, 10.0);
  const Json scene = suggest({scalar([&](const Vec3d& p) {
    if (p.x() > 0.0 && p.x() < 1.0 && p.y() > 10.0) return p.z() > 0.0 ? NAN : INFINITY;
    return value(p);
  })});
  CHECK(only(scene, "isosurface")["value"].get<double>() == Approx(500.0).margin(60.0));
  // The first voxel of all.
  const Json flow = suggest({vector([](const Vec3d& p) {
    if (p.x() + p.y() + p.z() < -45.0) return Vec3f(NAN);
    return Vec3f(Vec3d(-p.y(), p.x(), 1.0));
  })});
  CHECK(modesOf(flow, "follow").size() == 1);
}

TEST_CASE("isovalues do not depend on the voxels' shape and place", "[suggest]") {
  auto transform = openvdb::math::Transform::createLinearTransform(1.0);
  transform->preScale(Vec3d(0.7, 0.7, 1.9));
  transform->postRotate(0.6, openvdb::math::X_AXIS);
  transform->postRotate(-1.1, openvdb::math::Z_AXIS);
  transform->postTranslate(Vec3d(100.0, -50.0, 7.0));
  const Vec3d middle = transform->indexToWorld(Vec3d(24.0, 24.0, 12.0));
  SuggestInput input;
  auto grid = openvdb::FloatGrid::create();
  grid->setTransform(transform);
  grid->setName("density");
  for (int i = 0; i < 49; ++i) {
    for (int j = 0; j < 49; ++j) {
      for (int k = 0; k < 25; ++k) {
        const Vec3d p = transform->indexToWorld(Vec3d(i, j, k)) - middle;
        grid->tree().setValue({i, j, k}, (p.length() < 11.0 ? 1000.0F : 0.0F) +
                                             10.0F * static_cast<float>(noise(Vec3d(i, j, k))));
      }
    }
  }
  input.grid = grid;
  CHECK(only(suggest({input}), "isosurface")["value"].get<double>() == Approx(500.0).margin(60.0));
}

TEST_CASE("a level set is an isosurface at 0", "[suggest]") {
  SuggestInput input;
  input.grid = makeBall(2.0, 0.1);
  const Json mode = only(suggest({input}), "isosurface");
  CHECK(mode["value"] == 0);
  CHECK(mode["solid"] == "below");
}

TEST_CASE("a flow is followed by the percentiles of its speed", "[suggest]") {
  const Vector vortex = [](const Vec3d& p) {
    const double r = std::hypot(p.x(), p.y());
    if (r > 15.0) return Vec3f(0.0F);
    return Vec3f(static_cast<float>(-p.y()), static_cast<float>(p.x()), 0.5F);
  };
  const SuggestInput input = vector(vortex);
  const Json scene = suggest({input});
  const Json follow = only(scene, "follow");
  CHECK(scene["fields"][follow["by"].get<std::string>()]["magnitude"] == follow["of"]);

  std::vector<float> speeds;
  const auto& grid = dynamic_cast<const openvdb::Vec3SGrid&>(*input.grid);
  for (auto it = grid.cbeginValueOn(); it; ++it) {
    if (it->length() > 0.0F) speeds.push_back(it->length());
  }
  std::sort(speeds.begin(), speeds.end());
  const auto at = [&](double part) {
    return speeds[static_cast<std::size_t>(part * static_cast<double>(speeds.size() - 1))];
  };
  const Json knots = follow["strength"]["piecewise"];
  REQUIRE(knots.size() == 3);
  CHECK(knots[0][0].get<double>() == Approx(at(0.10)).epsilon(0.01));
  CHECK(knots[1][0].get<double>() == Approx(at(0.50)).epsilon(0.01));
  CHECK(knots[2][0].get<double>() == Approx(at(0.95)).epsilon(0.01));
  CHECK(outputsOf(follow["strength"]) == std::vector<double>{0.0, 1.0, 2.0});
}

TEST_CASE("a drag by vorticity is for flows that turn", "[suggest]") {
  // Rankine's: it turns as a solid within, without curl beyond.
  const Json turning = suggest({vector([](const Vec3d& p) {
    const double r2 = std::max(36.0, p.x() * p.x() + p.y() * p.y());
    return Vec3f(Vec3d(-p.y(), p.x(), 0.0) * (36.0 / r2));
  })});
  const Json drag = only(turning, "viscosity");
  CHECK(turning["fields"][drag["of"].get<std::string>()].contains("curl"));
  // A stagnation point: all strain.
  const Json straining = suggest(
      {ofMesh(vector([](const Vec3d& p) { return Vec3f(Vec3d(p.x(), p.y(), -2.0 * p.z())); }))});
  CHECK(modesOf(straining, "viscosity").empty());
}

TEST_CASE("a flow of one speed leaves out only what stands still", "[suggest]") {
  const Json follow = only(suggest({vector([](const Vec3d& p) {
                             if (p.z() > 8.0) return Vec3f(0.0F);
                             const Vec3d v(-p.y(), p.x(), 0.0);
                             return Vec3f(3.0 * v / v.length());
                           })}),
                           "follow");
  const Json knots = follow["strength"]["piecewise"];
  CHECK(knots.front()[1] == 0);
  CHECK(knots.front()[0].get<double>() > 0.0);
  CHECK(knots.back()[0].get<double>() < 3.0);
  CHECK(knots.back()[1].get<double>() > 0.0);
}

TEST_CASE("fibres are axial and followed by their anisotropy", "[suggest]") {
  SuggestInput fibres =
      vector([](const Vec3d& p) { return Vec3f(Vec3d(1.0, 0.05 * p.x(), 0.0).unit()); },
             "tensor_direction");
  fibres.axial = true;
  const SuggestInput anisotropy =
      scalar([](const Vec3d& p) { return static_cast<float>(0.5 + 0.4 * std::sin(0.2 * p.y())); },
             32, "tensor_anisotropy");
  const Json scene = suggest({anisotropy, fibres});
  const Json follow = only(scene, "follow");
  CHECK(scene["volumes"][follow["of"].get<std::string>()]["axial"] == true);
  CHECK(follow["by"] == "tensor_anisotropy");
  CHECK(follow["strength"]["piecewise"] == Json::parse("[[0.15, 0], [0.4, 1], [0.7, 2]]"));
  CHECK(scene["modes"].size() == 1);  // not once more, as a scalar

  const Json alone = suggest({fibres});
  CHECK_FALSE(only(alone, "follow").contains("by"));
  CHECK(alone["volumes"]["tensor_direction"]["axial"] == true);
}

TEST_CASE("of many arrays a few are used, the rest is named", "[suggest]") {
  std::vector<SuggestInput> grids;
  const Vector flow = [](const Vec3d& p) {
    return Vec3f(Vec3d(-p.y(), p.x(), 0.3 * p.x() + 2.0 * std::sin(0.3 * p.z())));
  };
  std::vector<std::string> names;
  for (int i = 0; i < 15; ++i) {
    names.push_back("c" + std::to_string(i));
    grids.push_back(ofMesh(scalar(
        [i](const Vec3d& p) {
          return static_cast<float>(std::exp(0.02 * i * p.x()) + std::sin(0.1 * i + 0.05 * p.y()));
        },
        32, names.back())));
  }
  grids.push_back(ofMesh(scalar([&](const Vec3d& p) { return flow(p)[0]; }, 32, "u")));
  grids.push_back(ofMesh(scalar([](const Vec3d&) { return 1.0F; }, 32, "ObjectId")));
  grids.push_back(ofMesh(vector(flow)));
  const Json scene = suggest(grids);
  CHECK(scene["volumes"].size() == 3);
  CHECK(scene["volumes"].contains("velocity"));
  CHECK_FALSE(scene["volumes"].contains("u"));
  CHECK_FALSE(scene["volumes"].contains("ObjectId"));
  const std::string description = scene["description"];
  CHECK_THAT(description, Contains("ObjectId (nearly all values alike)"));
  for (const std::string& name : names) {
    const bool used = scene["volumes"].contains(name);
    const bool listed = description.find(" " + name + ",") != std::string::npos ||
                        description.find(" " + name + ".") != std::string::npos ||
                        description.find(" " + name + " (") != std::string::npos;
    CHECK(used != listed);
  }
}

TEST_CASE("of two scalars that say the same one is used", "[suggest]") {
  const auto value = [](const Vec3d& p) { return static_cast<float>(std::sin(0.1 * p.x())); };
  const Json scene =
      suggest({ofMesh(scalar(value, 32, "AsH3")),
               ofMesh(scalar([&](const Vec3d& p) { return 3.0F - 2.0F * value(p); }, 32, "H2"))});
  CHECK(scene["volumes"].size() == 1);
  CHECK_THAT(scene["description"].get<std::string>(), Contains("H2 (much like AsH3)"));
}

TEST_CASE("volumes are named after their grids, each by a name of its own", "[suggest]") {
  const auto ramp = [](double dx, double dy) {
    return [=](const Vec3d& p) { return static_cast<float>(dx * p.x() + dy * p.y()); };
  };
  const Json equal =
      suggest({scalar(ramp(1, 0), 16, "a b/(c)"), scalar(ramp(0, 1), 16, "a b/(c)")});
  CHECK(equal["volumes"]["a_b_c"]["grid"] == "a b/(c)[0]");
  CHECK(equal["volumes"]["a_b_c_2"]["grid"] == "a b/(c)[1]");
  CHECK(equal["volumes"]["a_b_c_2"]["place"]["like"] == "a_b_c");
  // A field may not have the name of a volume.
  const Json clash =
      suggest({scalar(ramp(1, 0), 16, "speed"),
               vector([](const Vec3d& p) { return Vec3f(Vec3d(-p.y(), p.x(), 1.0)); })});
  CHECK(clash["volumes"].contains("speed"));
  CHECK(clash["fields"].contains("speed_2"));
  const Json unnamed = suggest({scalar(ramp(1, 0), 16, "")});
  CHECK_FALSE(unnamed["volumes"]["volume"].contains("grid"));
}

TEST_CASE("the same grids give the same scene, whatever the threads", "[suggest]") {
  // More voxels than are looked at.
  const std::vector<SuggestInput> grids{
      scalar(ball(30.0, 1000.0, 0.0, 30.0), 96),
      vector([](const Vec3d& p) { return Vec3f(Vec3d(-p.y(), p.x(), noise(p))); }, "flow", 96)};
  std::string alone;
  {
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    alone = suggestScene("data.vdb", grids);
  }
  const tbb::global_control many(tbb::global_control::max_allowed_parallelism, 8);
  for (int i = 0; i < 3; ++i) CHECK(suggestScene("data.vdb", grids) == alone);
}

TEST_CASE("a suggested scene can be felt", "[suggest]") {
  const TemporaryFolder folder;
  SuggestInput head = scalar(headInHounsfield);
  head.modality = Modality::kCt;
  const SuggestInput flow =
      vector([](const Vec3d& p) { return Vec3f(Vec3d(-p.y(), p.x(), 2.0)); }, "velocity", 48);
  openvdb::GridPtrVec grids;
  for (const SuggestInput& input : {head, flow}) grids.push_back(input.grid->deepCopyGrid());
  writeVdb(folder / "data.vdb", grids);
  std::ofstream(folder / "scene.json") << suggestScene("data.vdb", {head, flow});
  const BuiltScene built = buildScene(readSceneFile(folder / "scene.json"));
  CHECK(built.volumes.size() == 2);
  CHECK(built.notes.empty());
}

TEST_CASE("skin and bone of VTK's head are found near 500 and 1150", "[.][data]") {
  const char* data = std::getenv("PALPATE_DATA");
  REQUIRE(data != nullptr);
  auto grid = openvdb::FloatGrid::create(0.0F);
  grid->setName("density");
  auto transform = openvdb::math::Transform::createLinearTransform(1.0);
  transform->preScale(Vec3d(3.2, 3.2, 1.5));
  grid->setTransform(transform);
  for (int k = 0; k < 93; ++k) {
    std::ifstream slice(
        std::filesystem::path(data) / "ct_headsq" / ("quarter." + std::to_string(k + 1)),
        std::ios::binary);
    for (int j = 0; j < 64; ++j) {
      for (int i = 0; i < 64; ++i) {
        const int low = slice.get();
        grid->tree().setValue({i, j, k}, static_cast<float>(low + 256 * slice.get()));
      }
    }
    REQUIRE(slice.good());
  }
  SuggestInput input;
  input.grid = grid;
  input.extent.reset({0, 0, 0}, {63, 63, 92});
  const Json scene = suggest({input});
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(500.0).margin(100.0));
  CHECK(surfaces[1]["value"].get<double>() == Approx(1150.0).margin(50.0));
}
