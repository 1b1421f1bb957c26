#include "palpate/scenes/guess/suggest.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <set>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>
#include <openvdb/tools/ChangeBackground.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/Prune.h>
#include <tbb/global_control.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/grid/labels.h"
#include "palpate/scenes/guess/body.h"
#include "palpate/scenes/guess/components.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/vdb_grids.h"

namespace palpate::suggest_test {
using namespace palpate::guess;
using namespace palpate::test;
using Catch::Contains;
using openvdb::Vec3d;
using openvdb::Vec3f;
using Json = nlohmann::json;

namespace {

using Scalar = std::function<float(const Vec3d&)>;
using Vector = std::function<Vec3f(const Vec3d&)>;

/// Returns noise with mean 0 and standard deviation 1: a sum of 12 uniform random numbers. The
/// noise depends on p only.
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

/// Returns the transform of n^3 voxels of edge 1, centred at the origin.
openvdb::math::Transform::Ptr centred(int n) {
  auto transform = openvdb::math::Transform::createLinearTransform(1.0);
  transform->postTranslate(Vec3d(-0.5 * (n - 1)));
  return transform;
}
SuggestInput scalar(const Scalar& value, int n = 48, const std::string& name = "density") {
  SuggestInput input;
  auto grid = makeGrid<openvdb::FloatGrid>(n, centred(n), value, name);
  // The importer makes the background equal to the image's surroundings.
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
/// Marks an input as a mesh, which has no data outside its voxels.
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

/// Returns the guessed scene. Checks the rules that apply to every guess.
Json suggested(const std::vector<SuggestInput>& grids) {
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

/// A head of air, skin, bone and brain in Hounsfield units, blurred over two voxels.
float headInHounsfield(const Vec3d& p) {
  const double r = p.length();
  const auto step = [r](double radius) { return 1.0 / (1.0 + std::exp((r - radius) / 0.5)); };
  return static_cast<float>(-1000.0 + 1050.0 * step(20.0) + 950.0 * step(15.0) -
                            960.0 * step(11.0) + 10.0 * noise(p));
}

}  // namespace

TEST_CASE("the guess for a ball in air has one surface, halfway between the values of ball and air",
          "[guess]") {
  const double deviation = GENERATE(0.0, 10.0, 50.0);
  CAPTURE(deviation);
  const Json scene = suggested({scalar(ball(16.0, 1000.0, 0.0, deviation))});
  const Json mode = only(scene, "isosurface");
  CHECK(mode["value"].get<double>() == Approx(500.0).margin(60.0));
  CHECK(mode["solid"] == "above");
  CHECK_THAT(mode["description"].get<std::string>(), Contains("first guess"));
}

TEST_CASE("a dark ball in a brighter medium gets a surface that is solid below its value",
          "[guess]") {
  const Json scene = suggested({scalar(ball(16.0, 100.0, 900.0, 10.0))});
  const Json mode = only(scene, "isosurface");
  CHECK(mode["value"].get<double>() == Approx(500.0).margin(60.0));
  CHECK(mode["solid"] == "below");
}

TEST_CASE("the guessed isovalue of a blurred ball is halfway between inside and outside",
          "[guess]") {
  const double width = GENERATE(0.5, 1.0, 2.0);
  CAPTURE(width);
  const Json scene = suggested({scalar([width](const Vec3d& p) {
    return static_cast<float>(1000.0 / (1.0 + std::exp((p.length() - 14.0) / width)) +
                              5.0 * noise(p));
  })});
  CHECK(only(scene, "isosurface")["value"].get<double>() == Approx(500.0).margin(60.0));
}

TEST_CASE("inactive surroundings cause a surface in an image but not in a mesh", "[guess]") {
  // As after an import, the surroundings are inactive and equal the background.
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
  CHECK(only(suggested({input}), "isosurface")["value"].get<double>() ==
        Approx(500.0).margin(60.0));

  // In a mesh the same voxels have no boundary, because there are no data around them.
  if (deviation == 0.0) {
    CHECK_THROWS_AS(suggestScene("data.vdb", {ofMesh(input)}), VolumeError);
  } else {
    CHECK(modesOf(suggested({ofMesh(input)}), "isosurface").empty());
  }
}

TEST_CASE("the edge of an image gives no surface", "[guess]") {
  // The slab z < 8 ends at five faces of the image.
  const auto value = [](const Vec3d& p) {
    return static_cast<float>((p.z() > 8.0 ? 0.0 : 500.0) + 3.0 * noise(p));
  };
  const Json scene = suggested({scalar(value)});
  CHECK(only(scene, "isosurface")["value"].get<double>() == Approx(250.0).margin(30.0));
  // The faces of the image must not count as a surface.
  SuggestInput block = scalar([](const Vec3d& p) { return static_cast<float>(noise(p)); });
  auto grid = openvdb::gridConstPtrCast<openvdb::FloatGrid>(block.grid)->deepCopy();
  openvdb::tools::changeBackground(grid->tree(), -1000.0F);
  block.grid = grid;
  CHECK(modesOf(suggested({block}), "isosurface").empty());
}

TEST_CASE("nested shells get two surfaces, the outer one weaker", "[guess]") {
  const double deviation = GENERATE(0.0, 8.0);
  CAPTURE(deviation);
  const Json scene = suggested({scalar([deviation](const Vec3d& p) {
    const double r = p.length();
    return static_cast<float>((r < 10.0 ? 300.0 : (r < 19.0 ? 100.0 : 0.0)) + deviation * noise(p));
  })});
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(50.0).margin(15.0));
  CHECK(surfaces[1]["value"].get<double>() == Approx(200.0).margin(30.0));
  CHECK(surfaces[0]["strength"].get<double>() < surfaces[1]["strength"].get<double>());
  // A viscosity mode fills the range between the surfaces.
  const Json knots = only(scene, "viscosity")["strength"]["piecewise"];
  CHECK(knots.front()[0] == surfaces[0]["value"]);
  CHECK(knots.back()[0] == surfaces[1]["value"]);
}

TEST_CASE(
    "the bone surface of a raw CT with varying bone is nearer to tissue than to the densest bone",
    "[guess]") {
  // Air has the value 20, tissue 1050, and bone 1200 to 2400.
  const Json scene = suggested({scalar([](const Vec3d& p) {
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

TEST_CASE("a CT gets a skin surface at -300 HU and a stronger bone surface at 150 to 500 HU",
          "[guess]") {
  SuggestInput input = scalar(headInHounsfield);
  input.modality = Modality::kCt;
  const Json scene = suggested({input});
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

TEST_CASE("a CT without bone gets no bone surface", "[guess]") {
  SuggestInput input = scalar(ball(16.0, 40.0, -1000.0, 10.0));
  input.modality = Modality::kCt;
  input.value_unit = "HU";
  CHECK(only(suggested({input}), "isosurface")["name"] == "skin");
}

TEST_CASE("a CT in raw values is analysed like any other image", "[guess]") {
  SuggestInput input = scalar([](const Vec3d& p) { return headInHounsfield(p) + 1024.0F; });
  input.modality = Modality::kCt;
  const std::vector<Json> surfaces = modesOf(suggested({input}), "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(550.0).margin(100.0));
  CHECK(surfaces[1]["value"].get<double>() > 1100.0);
  CHECK(surfaces[1]["value"].get<double>() < 1750.0);
}

TEST_CASE("an MR image gets one skin surface at a low signal and one viscosity mode", "[guess]") {
  SuggestInput input = scalar([](const Vec3d& p) {
    const double r = p.length();
    return static_cast<float>((r < 18.0 ? (r < 10.0 ? 120.0 : 60.0) : 4.0) +
                              2.0 * std::abs(noise(p)));
  });
  input.modality = Modality::kMr;
  const Json scene = suggested({input});
  const Json skin = only(scene, "isosurface");
  CHECK(skin["value"].get<double>() > 6.0);
  CHECK(skin["value"].get<double>() < 35.0);
  CHECK(modesOf(scene, "viscosity").size() == 1);
}

TEST_CASE("a scalar without boundaries gets a viscosity mode and no surface", "[guess]") {
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
      const Json scene = suggested({input});
      CHECK(modesOf(scene, "isosurface").empty());
      const Json knots = only(scene, "viscosity")["strength"]["piecewise"];
      CHECK(knots.front()[0].get<double>() < knots.back()[0].get<double>());
    }
  }
}

TEST_CASE("noise alone gives no surface", "[guess]") {
  const Json scene =
      suggested({scalar([](const Vec3d& p) { return static_cast<float>(10.0 * noise(p)); })});
  CHECK(modesOf(scene, "isosurface").empty());
}

TEST_CASE("a constant scalar is rejected by name, a constant vector gets a follow mode",
          "[guess]") {
  const SuggestInput still = vector([](const Vec3d&) { return Vec3f(0.0F, -15.0F, 0.0F); }, "vel");
  const SuggestInput same = scalar([](const Vec3d&) { return 3.0F; }, 16, "same");
  CHECK_THROWS_WITH(suggestScene("data.vdb", {same}),
                    Contains("same (nearly all values are equal)"));
  // A constant vector field has a direction, so it is usable if no other grid is.
  const Json scene = suggested({same, still});
  CHECK(only(scene, "follow")["of"] == "vel");
  CHECK_THAT(scene["description"].get<std::string>(),
             Contains("same (nearly all values are equal)"));
  CHECK_THROWS_AS(suggestScene("data.vdb", {}), VolumeError);
  SuggestInput empty;
  empty.grid = openvdb::FloatGrid::create();
  CHECK_THROWS_AS(suggestScene("data.vdb", {empty}), VolumeError);
}

TEST_CASE(
    "with a few non-finite values a ball keeps its guessed isovalue and a flow its follow mode",
    "[guess]") {
  const auto value = ball(16.0, 1000.0, 0.0, 10.0);
  const Json scene = suggested({scalar([&](const Vec3d& p) {
    if (p.x() > 0.0 && p.x() < 1.0 && p.y() > 10.0) return p.z() > 0.0 ? NAN : INFINITY;
    return value(p);
  })});
  CHECK(only(scene, "isosurface")["value"].get<double>() == Approx(500.0).margin(60.0));
  // The first voxel is NaN.
  const Json flow = suggested({vector([](const Vec3d& p) {
    if (p.x() + p.y() + p.z() < -45.0) return Vec3f(NAN);
    return Vec3f(Vec3d(-p.y(), p.x(), 1.0));
  })});
  CHECK(modesOf(flow, "follow").size() == 1);
}

TEST_CASE("a ball on oblong, rotated voxels far from the origin gets its usual isovalue",
          "[guess]") {
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
  CHECK(only(suggested({input}), "isosurface")["value"].get<double>() ==
        Approx(500.0).margin(60.0));
}

TEST_CASE("a level set gets an isosurface at 0", "[guess]") {
  SuggestInput input;
  input.grid = makeBall(2.0, 0.1);
  const Json mode = only(suggested({input}), "isosurface");
  CHECK(mode["value"] == 0);
  CHECK(mode["solid"] == "below");
}

TEST_CASE("the guessed strength along a flow follows the percentiles of its speed", "[guess]") {
  const Vector vortex = [](const Vec3d& p) {
    const double r = std::hypot(p.x(), p.y());
    if (r > 15.0) return Vec3f(0.0F);
    return Vec3f(static_cast<float>(-p.y()), static_cast<float>(p.x()), 0.5F);
  };
  const SuggestInput input = vector(vortex);
  const Json scene = suggested({input});
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

TEST_CASE("a vortex gets a vortex tube, and a shear layer a viscosity mode that follows its curl",
          "[guess]") {
  // Rankine's vortex: it rotates like a solid inside, and has no curl outside.
  const Json turning = suggested({vector([](const Vec3d& p) {
    const double r2 = std::max(36.0, p.x() * p.x() + p.y() * p.y());
    return Vec3f(Vec3d(-p.y(), p.x(), 0.0) * (36.0 / r2));
  })});
  const Json tube = only(turning, "vortex_tube");
  CHECK(tube["of"] == "velocity");
  CHECK(tube["strength"]["piecewise"].front()[1] == 0);
  CHECK(modesOf(turning, "viscosity").empty());
  const Json layer = suggested(
      {vector([](const Vec3d& p) { return Vec3f(Vec3d(std::tanh(0.25 * p.z()), 0.0, 0.1)); })});
  const Json drag = only(layer, "viscosity");
  CHECK(layer["fields"][drag["of"].get<std::string>()].contains("curl"));
  // A stagnation point has strain only.
  const Json straining = suggested(
      {ofMesh(vector([](const Vec3d& p) { return Vec3f(Vec3d(p.x(), p.y(), -2.0 * p.z())); }))});
  CHECK(modesOf(straining, "viscosity").empty());
}

TEST_CASE("a flow of one speed causes no force in its part at rest and a force where it moves",
          "[guess]") {
  const Json follow = only(suggested({vector([](const Vec3d& p) {
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

TEST_CASE("fibres are guessed as axial vectors whose anisotropy sets the strength along them",
          "[guess]") {
  SuggestInput fibres =
      vector([](const Vec3d& p) { return Vec3f(Vec3d(1.0, 0.05 * p.x(), 0.0).unit()); },
             "tensor_direction");
  fibres.axial = true;
  const SuggestInput anisotropy =
      scalar([](const Vec3d& p) { return static_cast<float>(0.5 + 0.4 * std::sin(0.2 * p.y())); },
             32, "tensor_anisotropy");
  const Json scene = suggested({anisotropy, fibres});
  const Json follow = only(scene, "follow");
  CHECK(scene["volumes"][follow["of"].get<std::string>()]["axial"] == true);
  CHECK(follow["by"] == "tensor_anisotropy");
  CHECK(follow["strength"]["piecewise"] == Json::parse("[[0.15, 0], [0.4, 1], [0.7, 2]]"));
  CHECK(scene["modes"].size() == 1);  // no second mode for its scalars

  const Json alone = suggested({fibres});
  CHECK_FALSE(only(alone, "follow").contains("by"));
  CHECK(alone["volumes"]["tensor_direction"]["axial"] == true);
}

TEST_CASE("the guess uses three of 18 arrays and lists the others in its description", "[guess]") {
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
  const Json scene = suggested(grids);
  CHECK(scene["volumes"].size() == 3);
  CHECK(scene["volumes"].contains("velocity"));
  CHECK_FALSE(scene["volumes"].contains("u"));
  CHECK_FALSE(scene["volumes"].contains("ObjectId"));
  const std::string description = scene["description"];
  CHECK_THAT(description, Contains("ObjectId (nearly all values are equal)"));
  for (const std::string& name : names) {
    const bool used = scene["volumes"].contains(name);
    const bool listed = description.find(" " + name + ",") != std::string::npos ||
                        description.find(" " + name + ".") != std::string::npos ||
                        description.find(" " + name + " (") != std::string::npos;
    CHECK(used != listed);
  }
}

TEST_CASE("the guess uses only one of two equivalent scalars", "[guess]") {
  const auto value = [](const Vec3d& p) { return static_cast<float>(std::sin(0.1 * p.x())); };
  const Json scene =
      suggested({ofMesh(scalar(value, 32, "AsH3")),
                 ofMesh(scalar([&](const Vec3d& p) { return 3.0F - 2.0F * value(p); }, 32, "H2"))});
  CHECK(scene["volumes"].size() == 1);
  CHECK_THAT(scene["description"].get<std::string>(),
             Contains("H2 (nearly a linear function of AsH3)"));
}

TEST_CASE("each volume of a guessed scene has a unique name that is made from its grid's name",
          "[guess]") {
  const auto ramp = [](double dx, double dy) {
    return [=](const Vec3d& p) { return static_cast<float>(dx * p.x() + dy * p.y()); };
  };
  const Json equal =
      suggested({scalar(ramp(1, 0), 16, "a b/(c)"), scalar(ramp(0, 1), 16, "a b/(c)")});
  CHECK(equal["volumes"]["a_b_c"]["grid"] == "a b/(c)[0]");
  CHECK(equal["volumes"]["a_b_c_2"]["grid"] == "a b/(c)[1]");
  CHECK(equal["volumes"]["a_b_c_2"]["place"]["like"] == "a_b_c");
  // A field must not have the name of a volume.
  const Json clash =
      suggested({scalar(ramp(1, 0), 16, "speed"),
                 vector([](const Vec3d& p) { return Vec3f(Vec3d(-p.y(), p.x(), 1.0)); })});
  CHECK(clash["volumes"].contains("speed"));
  CHECK(clash["fields"].contains("speed_2"));
  const Json unnamed = suggested({scalar(ramp(1, 0), 16, "")});
  CHECK_FALSE(unnamed["volumes"]["volume"].contains("grid"));
}

TEST_CASE("the guessed scene does not depend on the number of threads", "[guess]") {
  // The grids have more voxels than the analysis reads.
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

TEST_CASE("a guessed scene loads without a note", "[guess]") {
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

// Unless a test says otherwise, the grids below have no metadata, like those of a user's script.

TEST_CASE("a CT .vdb without a scene gets a skin surface and a bone surface", "[guess]") {
  const TemporaryFolder folder;
  // The CT has whole numbers, stored air and a background of 0.
  auto ct = makeGrid<openvdb::FloatGrid>(
      48, centred(48), [](const Vec3d& p) { return std::round(headInHounsfield(p)); }, "ct");
  openvdb::tools::changeBackground(ct->tree(), 0.0F);
  writeVdb(folder / "ct.vdb", {ct});
  const SceneSpec spec = openScene(folder / "ct.vdb");
  std::vector<ModeSpec> surfaces;
  for (const ModeSpec& mode : spec.graph.modes) {
    if (mode.kind == ModeKind::kIsosurface) surfaces.push_back(mode);
  }
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0].name == "skin");
  CHECK(surfaces[0].value == -300.0);
  CHECK(surfaces[0].solid == Solid::kAbove);
  CHECK(surfaces[1].name == "bone");
  CHECK(surfaces[1].value >= 150.0);
  CHECK(surfaces[1].value <= 500.0);
  CHECK(surfaces[1].solid == Solid::kAbove);
  CHECK(surfaces[0].strength.highest() < surfaces[1].strength.highest());
  CHECK(buildScene(spec).notes.empty());

  const Guess guess = guessVdb(folder / "ct.vdb");
  REQUIRE(guess.seen.size() == 1);
  CHECK_THAT(guess.seen[0], Contains("Hounsfield") && Contains("-1000"));
  CHECK(guess.made.size() == 3);
  CHECK(guess.left.empty());
  const Json scene = Json::parse(guess.scene);
  CHECK_THAT(scene["volumes"]["ct"]["description"].get<std::string>(), Contains("Hounsfield"));

  // For CFD, the levels come from this image, not from the Hounsfield scale.
  const Json other = Json::parse(guessVdb(folder / "ct.vdb", GuessFor::kCfd).scene);
  for (const Json& mode : other["modes"]) CHECK(mode["name"] != "bone");
}

TEST_CASE("the Hounsfield scale is recognised in a CT of a head, and not in other fields",
          "[guess]") {
  // Air is the background and has no stored voxels.
  const Json head = suggested({scalar(headInHounsfield)});
  CHECK(head["modes"][0]["name"] == "skin");
  CHECK(head["modes"][1]["name"] == "bone");
  CHECK_THAT(head["volumes"]["density"]["description"].get<std::string>(), Contains("Hounsfield"));
  // None of these is a CT in Hounsfield units: raw values, another unit, and a pressure about 0.
  const auto raw = [](const Vec3d& p) { return headInHounsfield(p) + 1024.0F; };
  SuggestInput pascal = scalar(headInHounsfield);
  pascal.value_unit = "Pa";
  const auto pressure = [](const Vec3d& p) {
    return static_cast<float>(1500.0 * std::sin(0.1 * p.x()));
  };
  for (const SuggestInput& input : {scalar(raw), pascal, scalar(pressure)}) {
    const Json scene = suggested({input});
    for (const Json& mode : scene["modes"]) CHECK(mode["name"] != "skin");
  }
}

TEST_CASE(
    "a grid's kind is taken first from the user, then from the metadata, then from the values",
    "[guess]") {
  const SuggestInput plain = scalar(headInHounsfield);
  SuggestInput hounsfield = plain;
  hounsfield.value_unit = "HU";
  SuggestInput ct = plain;
  ct.modality = Modality::kCt;
  SuggestInput mr = plain;
  mr.modality = Modality::kMr;
  SuggestInput pascal = plain;
  pascal.value_unit = "Pa";
  const SuggestInput raw = scalar([](const Vec3d& p) { return headInHounsfield(p) + 1024.0F; });
  struct Row {
    SuggestInput input;
    GuessFor what;
    std::string seen;
  };
  const std::vector<Row> rows{
      {plain, GuessFor::kAnything, "air near -1000"},
      {plain, GuessFor::kFibres, "air near -1000"},
      {plain, GuessFor::kCt, "Hounsfield units, set by --for ct"},
      {plain, GuessFor::kLabels, "between materials"},
      {hounsfield, GuessFor::kAnything, "Hounsfield units, according to the file's metadata"},
      {hounsfield, GuessFor::kCfd, "a field, set by --for cfd"},
      {ct, GuessFor::kAnything, "Hounsfield units, according to the file's metadata"},
      {ct, GuessFor::kMri, "an MR image, set by --for mri"},
      {mr, GuessFor::kAnything, "MR image, according to the file's metadata"},
      {pascal, GuessFor::kAnything, "between materials"},
      {pascal, GuessFor::kCt, "Hounsfield units, set by --for ct"},
      {raw, GuessFor::kCt, "raw values of a scanner"},
  };
  for (const Row& row : rows) {
    CAPTURE(row.seen);
    const Guess guess = suggest({"data.vdb", "", ""}, {row.input}, row.what);
    REQUIRE(guess.seen.size() == 1);
    CHECK_THAT(guess.seen[0], Contains(row.seen));
  }
}

TEST_CASE("vectors of length 1 are axial directions unless the user asks for CFD", "[guess]") {
  const auto direction = [](const Vec3d& p) {
    const double sign = noise(p) > 0.0 ? 1.0 : -1.0;
    return Vec3f(sign * Vec3d(1.0, 0.1 * p.x(), 0.0).unit());
  };
  const Json scene = suggested({vector(direction, "v1")});
  const Json follow = only(scene, "follow");
  CHECK(scene["volumes"][follow["of"].get<std::string>()]["axial"] == true);
  CHECK(scene["modes"].size() == 1);
  CHECK_FALSE(scene.contains("fields"));  // no curl

  const Json cfd =
      Json::parse(suggest({"data.vdb", "", ""}, {vector(direction, "v1")}, GuessFor::kCfd).scene);
  CHECK_FALSE(cfd["volumes"]["v1"].contains("axial"));
  // For fibres, all vectors count as axial.
  const auto flow = vector([](const Vec3d& p) { return Vec3f(Vec3d(-p.y(), p.x(), 3.0)); });
  const Json fibres = Json::parse(suggest({"data.vdb", "", ""}, {flow}, GuessFor::kFibres).scene);
  CHECK(fibres["volumes"]["velocity"]["axial"] == true);
  CHECK(modesOf(fibres, "viscosity").empty());
}

TEST_CASE("the component grids of a vector are found by their names", "[guess]") {
  const auto found = [](const std::vector<std::string>& names) {
    std::vector<std::string> vectors;
    for (const Components& c : findComponents(names)) vectors.push_back(c.name);
    return vectors;
  };
  using Names = std::vector<std::string>;
  CHECK(found({"X Velocity", "p", "Y Velocity", "Z Velocity"}) == Names{"Velocity"});
  CHECK(found({"u", "v", "w"}) == Names{"velocity"});
  CHECK(found({"Momentum_x", "Momentum_y", "Momentum_z", "rho"}) == Names{"Momentum"});
  CHECK(found({"VelocityX", "VelocityY", "VelocityZ"}) == Names{"Velocity"});
  CHECK(found({"U_mean", "V_mean", "W_mean"}) == Names{"mean"});
  CHECK(found({"ux", "uy", "uz", "Bx", "By", "Bz"}) == Names{"u", "B"});
  CHECK(found({"x", "y", "z"}).empty());
  CHECK(found({"Txx", "Txy", "Txz", "Tyy", "Tyz", "Tzz"}).empty());
  CHECK(found({"T_xx", "T_xy", "T_xz", "T_yy", "T_yz", "T_zz"}).empty());
  CHECK(found({"u", "v", "p"}).empty());
  CHECK(found({"flux", "fluy", "flu"}).empty());
}

TEST_CASE("the three component grids of a vector are not used as scalars", "[guess]") {
  const auto part = [](int axis, const std::string& name) {
    return ofMesh(scalar(
        [axis](const Vec3d& p) {
          const double turn = 1.0 / (1.0 + (p.x() * p.x() + p.y() * p.y()) / 16.0);
          return static_cast<float>(axis == 0   ? -turn * p.y()
                                    : axis == 1 ? turn * p.x()
                                                : 0.1 * p.z());
        },
        24, name));
  };
  const SuggestInput heat =
      ofMesh(scalar([](const Vec3d& p) { return static_cast<float>(p.length()); }, 24, "heat"));
  const Guess guess = suggest({"data.vdb", "", ""}, {part(0, "X Velocity"), part(1, "Y Velocity"),
                                                     part(2, "Z Velocity"), heat});
  const Json scene = Json::parse(guess.scene);
  CHECK(scene["volumes"].size() == 1);
  CHECK(scene["volumes"].contains("heat"));
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("X Velocity, Y Velocity, Z Velocity") &&
                                Contains("Velocity.x, Velocity.y and Velocity.z"));

  // The names make these grids the components of one vector.
  const TemporaryFolder folder;
  openvdb::GridPtrVec grids;
  for (int axis = 0; axis < 3; ++axis) {
    grids.push_back(part(axis, std::string("Velocity.") + "xyz"[axis]).grid->deepCopyGrid());
  }
  writeVdb(folder / "parts.vdb", grids);
  const std::string felt = guessVdb(folder / "parts.vdb").scene;
  CAPTURE(felt);
  const SceneSpec spec = openScene(folder / "parts.vdb");
  REQUIRE(spec.graph.modes.size() == 2);
  CHECK(spec.graph.modes[0].kind == ModeKind::kFollow);
  CHECK(spec.graph.modes[1].kind == ModeKind::kVortexTube);
  CHECK(buildScene(spec).volumes.count("Velocity") == 1);
}

TEST_CASE("each material fraction gets a surface at one half, except the void", "[guess]") {
  // A ball and a box in a void. At edges, fractions change over one or two voxels.
  const auto within = [](double depth) { return std::clamp(0.5 + 0.5 * depth, 0.0, 1.0); };
  const auto steel = [=](const Vec3d& p) {
    return static_cast<float>(within(8.0 - (p - Vec3d(-9.0, 0.0, 0.0)).length()));
  };
  const auto copper = [=](const Vec3d& p) {
    const Vec3d d(std::abs(p.x() - 10.0), std::abs(p.y()), std::abs(p.z()));
    return static_cast<float>(within(6.0 - std::max({d.x(), d.y(), d.z()})));
  };
  const auto rest = [=](const Vec3d& p) { return 1.0F - steel(p) - copper(p); };
  const bool mesh = GENERATE(false, true);
  std::vector<SuggestInput> grids{scalar(rest, 48, "Material volume fraction - 1"),
                                  scalar(steel, 48, "Material volume fraction - 2"),
                                  scalar(copper, 48, "Material volume fraction - 3")};
  if (mesh) {
    for (SuggestInput& grid : grids) grid.inactive_is_data = false;
  }
  const Guess guess = suggest({"data.vdb", "", ""}, grids);
  const Json scene = Json::parse(guess.scene);
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  CAPTURE(guess.scene);
  REQUIRE(surfaces.size() == 2);
  CHECK(scene["modes"].size() == 2);
  for (const Json& mode : surfaces) {
    CHECK(mode["value"] == 0.5);
    CHECK(mode["solid"] == "above");
  }
  CHECK(surfaces[0]["of"] == "Material_volume_fraction_-_2");
  CHECK(surfaces[1]["of"] == "Material_volume_fraction_-_3");
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("fraction - 1"));
}

TEST_CASE("mixed gases get no material surface", "[guess]") {
  const auto oxygen = [](const Vec3d& p) {
    return static_cast<float>(0.4 + 0.3 * std::sin(0.1 * p.x()) * std::cos(0.08 * p.y()));
  };
  const auto rest = [&](const Vec3d& p) { return 1.0F - oxygen(p); };
  const Json scene = suggested({ofMesh(scalar(oxygen, 32, "O2")), ofMesh(scalar(rest, 32, "N2"))});
  CHECK(modesOf(scene, "isosurface").empty());
  CHECK(modesOf(scene, "viscosity").size() == 1);
}

TEST_CASE("a shock gets a surface where the value changes most steeply", "[guess]") {
  // A bow shock with uniform flow in front, blurred over about six voxels. Behind it the values
  // fall and rise.
  const Scalar bow = [](const Vec3d& p) {
    const double ahead = p.x() + 12.0 - 0.01 * (p.y() * p.y() + p.z() * p.z());
    const double behind =
        3.2 - 0.02 * ahead + 0.3 * std::sin(0.11 * p.y()) * std::cos(0.09 * p.z());
    return static_cast<float>(1.0 + (behind - 1.0) / (1.0 + std::exp(-ahead / 1.2)));
  };
  for (const bool mesh : {true, false}) {
    SuggestInput input = scalar(bow, 64, "Pressure");
    input.inactive_is_data = !mesh;
    const Json scene = suggested({input});
    CAPTURE(mesh, scene.dump(2));
    const Json mode = only(scene, "isosurface");
    CHECK(mode["value"].get<double>() > 1.3);
    CHECK(mode["value"].get<double>() < 2.6);
    CHECK(mode["solid"] == "above");
  }
}

TEST_CASE("the pressure of a shock gets a surface, and a speed beside the velocity is left out",
          "[guess]") {
  const Scalar behind = [](const Vec3d& p) {
    const double ahead = p.x() + 12.0 - 0.01 * (p.y() * p.y() + p.z() * p.z());
    return static_cast<float>(1.0 / (1.0 + std::exp(-ahead / 0.7)));
  };
  const Scalar pressure = [&](const Vec3d& p) { return 1e5F * (1.0F + 9.0F * behind(p)); };
  const Scalar speed = [&](const Vec3d& p) { return 3600.0F * (1.0F - 0.7F * behind(p)); };
  const Vector velocity = [&](const Vec3d& p) { return Vec3f(speed(p) / 3.6F, 0.0F, 0.0F); };
  const SuggestInput flow = ofMesh(vector(velocity, "U", 64));
  const Json scene = suggested({flow, ofMesh(scalar(pressure, 64, "p"))});
  CAPTURE(scene.dump(2));
  const Json surface = only(scene, "isosurface");
  CHECK(surface["of"] == "p");
  CHECK(surface["value"].get<double>() > 2e5);
  CHECK(surface["value"].get<double>() < 9e5);
  const Guess guess = suggest({"data.vdb", "", ""}, {flow, ofMesh(scalar(speed, 64, "km/h"))});
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("km/h: nearly a linear function of U"));
}

TEST_CASE("labels get surfaces at isovalues if isovalues can separate them", "[guess]") {
  // Three bodies in empty space. The third touches both others.
  const Scalar atlas = [](const Vec3d& p) {
    if ((p - Vec3d(-7.0, 0.0, 0.0)).length() < 7.0) return 1.0F;
    if ((p - Vec3d(7.0, 0.0, 0.0)).length() < 7.0) return 4.0F;
    if ((p - Vec3d(0.0, 10.0, 0.0)).length() < 7.0) return 2.0F;
    return 0.0F;
  };
  const SuggestInput input = scalar(atlas, 40, "atlas");
  const Guess guess = suggest({"data.vdb", "", ""}, {input});
  const Json scene = Json::parse(guess.scene);
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  CAPTURE(guess.scene);
  CHECK(scene["modes"].size() == 2);
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"] == 0.5);
  CHECK(surfaces[0]["solid"] == "above");
  CHECK(surfaces[1]["value"] == 3.0);
  CHECK(surfaces[1]["name"] == "atlas label 4");
  CHECK(surfaces[1]["solid"] == "above");
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("labels 1 to 2") && Contains("a grid for each"));
  // Shells whose values are in order count as an image.
  const Json shells = suggested({scalar([](const Vec3d& p) {
    return static_cast<float>(p.length() < 8.0 ? 3 : (p.length() < 16.0 ? 1 : 0));
  })});
  CHECK(shells["modes"][0]["name"] != "density all labels");
  // Two values make one body, even if the user selects labels.
  const auto mask = scalar(ball(12.0, 1.0, 0.0, 0.0), 40, "mask");
  for (const GuessFor what : {GuessFor::kAnything, GuessFor::kLabels}) {
    const Json body = Json::parse(suggest({"data.vdb", "", ""}, {mask}, what).scene);
    CHECK(only(body, "isosurface")["value"].get<double>() == Approx(0.5).margin(0.1));
    CHECK(only(body, "isosurface")["solid"] == "above");
  }
}

TEST_CASE("each of the largest labels of a segmentation gets a surface", "[guess][labels]") {
  // An organ of label 1 with a small tumour of label 2.
  const Scalar organ = [](const Vec3d& p) {
    return (p - Vec3d(5.0, 0.0, 0.0)).length() < 3.0 ? 2.0F : (p.length() < 14.0 ? 1.0F : 0.0F);
  };
  const SuggestInput input = scalar(organ, 32, "labels");
  const auto grid = std::const_pointer_cast<openvdb::GridBase>(input.grid);
  insertLabels(*grid, {{2.0, "tumour \"T1\"", std::nullopt},
                       {1.0, "organ", std::nullopt},
                       {5.0, "nowhere", std::nullopt},
                       {0.0, "air", std::nullopt}});
  const Guess guess = suggest({"data.vdb", "", ""}, {input});
  CAPTURE(guess.scene);
  CHECK_THAT(guess.seen.at(0), Contains("2 labels, according to the file's metadata"));
  CHECK(guess.left.empty());
  const Json modes = Json::parse(guess.scene)["modes"];
  REQUIRE(modes.size() == 2);
  CHECK(modes[0]["label"] == "organ");
  CHECK(modes[0]["name"] == "organ");
  CHECK(modes[1]["label"] == "tumour \"T1\"");
  CHECK(modes[0]["strength"] == 1.5);
  CHECK_THAT(guess.made.at(0), Contains("organ: isosurface of labels at label \"organ\""));
  // A name of two labels, and one that is not UTF-8, are replaced by the value.
  insertLabels(
      *grid,
      {{2.0, "lung", std::nullopt}, {1.0, "\xff", std::nullopt}, {5.0, "lung", std::nullopt}});
  const Json values = Json::parse(suggest({"data.vdb", "", ""}, {input}).scene)["modes"];
  REQUIRE(values.size() == 2);
  CHECK(values[0]["label"] == 1);
  CHECK(values[0]["name"] == "labels label 1");
  CHECK(values[1]["label"] == 2);
  // A grid in which all active voxels have one label.
  const SuggestInput full = scalar([](const Vec3d&) { return 3.0F; }, 16, "labels");
  const auto block = openvdb::gridPtrCast<openvdb::FloatGrid>(full.grid->deepCopyGrid());
  openvdb::tools::changeBackground(block->tree(), 0.0F);
  insertLabels(*block, {{3.0, "block", std::nullopt}});
  SuggestInput one = full;
  one.grid = block;
  const Json whole = Json::parse(suggest({"data.vdb", "", ""}, {one}).scene);
  CHECK(only(whole, "isosurface")["label"] == "block");
}

TEST_CASE("a guess states how many labels of a segmentation have no surface", "[guess][labels]") {
  const auto layer = [](const std::string& name, int shift) {
    const SuggestInput input = scalar(
        [shift](const Vec3d& p) {
          if (std::abs(p.y()) > 8.0 || std::abs(p.z()) > 8.0) return 0.0F;
          return static_cast<float>(1 + shift +
                                    std::clamp(static_cast<int>(p.x() + 14.0) / 4, 0, 6));
        },
        32, name);
    std::vector<Label> labels;
    for (int n = 1; n < 9; ++n) labels.push_back({double(n), "part " + std::to_string(n), {}});
    insertLabels(*std::const_pointer_cast<openvdb::GridBase>(input.grid), labels);
    return input;
  };
  // The second layer is a linear function of the first one, but has other labels.
  const Guess guess = suggest({"data.vdb", "", ""}, {layer("labels_0", 0), layer("labels_1", 1)});
  CAPTURE(guess.scene);
  const Json modes = Json::parse(guess.scene)["modes"];
  REQUIRE(modes.size() == 5);
  CHECK(modes[3]["of"] == "labels_0");
  CHECK(modes[4]["of"] == "labels_1");
  REQUIRE(guess.left.size() == 2);
  CHECK_THAT(guess.left[0], Contains("3 of the 7 labels of labels_0: only the 4 largest"));
  CHECK_THAT(guess.left[1], Contains("6 of the 7 labels of labels_1: only the largest label"));
}

TEST_CASE("the scene of a segmentation loads, also from a grid without a name and from bricks",
          "[guess][labels]") {
  const TemporaryFolder folder;
  const std::string name = GENERATE("labels", "");
  const SuggestInput input =
      scalar([](const Vec3d& p) { return p.length() < 12.0 ? (p.x() < 0.0 ? 3.0F : 7.0F) : 0.0F; },
             40, name);
  const openvdb::GridBase::Ptr grid = input.grid->deepCopyGrid();
  insertLabels(*grid, {{3.0, "left", std::nullopt}, {7.0, "right", std::nullopt}});
  writeVdb(folder / "a.vdb", {grid});
  const SceneSpec spec = openScene(folder / "a.vdb");
  const BuiltScene built = buildScene(spec);
  CHECK(built.notes.empty());
  REQUIRE(spec.graph.modes.size() == 2);
  for (const ModeSpec& mode : spec.graph.modes) {
    const GridInfo& mask = built.volumes.at(mode.of)->info();
    CHECK(mask.highest == Approx(1.0).margin(0.01));
  }
  std::ofstream(folder / "scene.json") << guessVdb(folder / "a.vdb").scene;
  CHECK_NOTHROW(buildScene(readSceneFile(folder / "scene.json")));
  // A folder of files is one scene.
  writeVdb(folder / "b.vdb", {grid});
  CHECK(buildScene(openScene(folder.path())).volumes.size() == 6);
  // In bricks, no label can be selected.
  (void)writeBricks(folder / "a.bricks", brickInput(loadVolume(folder / "a.vdb", name)));
  const Json bricks = Json::parse(guessVdb(folder / "a.bricks").scene);
  for (const Json& mode : bricks["modes"]) CHECK_FALSE(mode.contains("label"));
  CHECK_NOTHROW(buildScene(openScene(folder / "a.bricks")));
}

TEST_CASE("labels in tiles without voxels get surfaces", "[guess]") {
  // All labels end at borders of leaf nodes (8 voxels), so pruning leaves tiles only.
  SuggestInput input = scalar(
      [](const Vec3d& p) {
        const auto within = [&p](double from, double to) {
          return p.x() > from && p.x() < to && p.y() > from && p.y() < to && p.z() > from &&
                 p.z() < to;
        };
        if (within(-24.0, -8.0)) return 5.0F;
        if (within(-8.0, 8.0)) return 9.0F;
        return within(-24.0, 24.0) ? 2.0F : 0.0F;
      },
      64, "labels");
  auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(input.grid->deepCopyGrid());
  openvdb::tools::prune(grid->tree());
  REQUIRE(grid->tree().leafCount() == 0);
  input.grid = grid;
  const Json scene = suggested({input});
  REQUIRE(modesOf(scene, "isosurface").size() == 2);
  CHECK(scene["modes"][0]["value"] == 1.0);
  CHECK(scene["modes"][1]["value"] == 7.0);
}

TEST_CASE("a stream of one speed with a wake gets a strength that rises gradually with speed",
          "[guess]") {
  const Json scene = suggested({vector([](const Vec3d& p) {
    const double wake = p.x() > 6.0 ? 0.5 * (p.x() - 6.0) / 9.0 : 0.0;
    return Vec3f(Vec3d(1.0 + wake + 2e-4 * noise(p), 0.0, 0.0));
  })});
  const Json knots = only(scene, "follow")["strength"]["piecewise"];
  REQUIRE(knots.size() == 2);
  CHECK(knots[1][0].get<double>() - knots[0][0].get<double>() > 0.2);
}

TEST_CASE(
    "modes of labels are named by the label's value, and a field of values near 1e-4 is not "
    "guessed as labels",
    "[guess]") {
  const auto shells = [](double outer, double middle, double inner) {
    return scalar(
        [=](const Vec3d& p) {
          const double r = p.length();
          return static_cast<float>(r < 8.0 ? inner : r < 14.0 ? middle : r < 20.0 ? outer : 0.0);
        },
        48, "atlas");
  };
  const Guess large = suggest({"data.vdb", "", ""}, {shells(11101, 3.0, 12175)}, GuessFor::kLabels);
  CHECK_THAT(large.scene, Contains("label 12175"));
  CHECK_THAT(large.seen.at(0), Contains("whole numbers from 0 to 12175"));
  const Guess small = suggest({"data.vdb", "", ""}, {shells(1e-4, 2e-4, 4e-4)});
  CHECK_THAT(small.seen.at(0), Contains("values from 0"));
}

TEST_CASE("the printed share of a material is its share of the whole volume", "[guess]") {
  const auto share = [](double radius) {
    return [radius](const Vec3d& p) { return 1.0 / (1.0 + std::exp(p.length() - radius)); };
  };
  const auto steel = share(16.0);
  const auto water = share(8.0);
  const auto fraction = [&](const std::string& name, auto&& value) {
    return scalar([&](const Vec3d& p) { return static_cast<float>(value(p)); }, 64, name);
  };
  const Guess guess = suggest(
      {"data.vdb", "", ""},
      {fraction("steel", [&](const Vec3d& p) { return steel(p) - water(p); }),
       fraction("water", water), fraction("air", [&](const Vec3d& p) { return 1.0 - steel(p); })});
  // 4/3 pi (16^3 - 8^3) of 64^3 is 5.7 %, and the blur adds some.
  const std::string line = guess.made.at(0);
  const std::string before = "The material fills ";
  const std::size_t at = line.find(before);
  REQUIRE(at != std::string::npos);
  CHECK(std::stod(line.substr(at + before.size())) == Approx(6.0).margin(0.6));
}

TEST_CASE("the guess leaves out vector components with different transforms", "[guess]") {
  const auto grids = [](double edge) {
    SuggestInput x = scalar([](const Vec3d& p) { return static_cast<float>(p.y()); }, 32, "v");
    const SuggestInput y =
        scalar([](const Vec3d& p) { return static_cast<float>(-p.x()); }, 32, "v.y");
    auto moved = y.grid->deepCopyGrid();
    moved->setTransform(openvdb::math::Transform::createLinearTransform(edge));
    x.y = moved;
    x.z = y.grid;
    x.apart = moved->transform() != x.grid->transform();
    return std::vector<SuggestInput>{x, scalar(ball(10.0, 1.0, 0.0, 0.0))};
  };
  const Guess guess = suggest({"data.vdb", "", ""}, grids(2.0));
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("v: components with different transforms"));
}

TEST_CASE("a distance field without metadata gets a surface at 0", "[guess]") {
  constexpr double kVoxel = 0.25;
  for (const double per_voxel : {1.0, kVoxel}) {
    const auto distance = [per_voxel](const Vec3d& p) {
      return static_cast<float>(per_voxel * (p.length() - 12.0));
    };
    SuggestInput input = scalar(distance);
    auto grid = input.grid->deepCopyGrid();
    grid->transform().preScale(kVoxel);
    input.grid = grid;
    const Json scene = suggested({input});
    const Json surface = only(scene, "isosurface");
    CHECK(surface["value"] == 0.0);
    CHECK(surface["solid"] == "below");
    CHECK(scene["modes"].size() == 1);
  }
  // A ramp of slope 1 is not a distance.
  CHECK(modesOf(suggested({scalar([](const Vec3d& p) { return static_cast<float>(p.x()); })}),
                "isosurface")
            .empty());
}

TEST_CASE("a distance field that is clamped gets a surface at 0 with its solid inside", "[guess]") {
  const auto ball = [](const Vec3d& p) { return p.length() - 12.0; };
  const auto box = [](const Vec3d& p) {
    const Vec3d d(std::abs(p.x()) - 15.3, std::abs(p.y()) - 11.7, std::abs(p.z()) - 8.2);
    const Vec3d outside(std::max(d.x(), 0.0), std::max(d.y(), 0.0), std::max(d.z(), 0.0));
    return outside.length() + std::min(std::max({d.x(), d.y(), d.z()}), 0.0);
  };
  const auto ground = [](const Vec3d& p) { return (p.z() - 5.0 + 0.3 * p.x()) / std::sqrt(1.09); };
  struct Shape {
    std::function<double(const Vec3d&)> distance;
    bool closed = true;
  };
  struct Cut {
    double from = 0.0;
    double to = 0.0;
    double scale = 1.0;
    double deviation = 0.0;
  };
  for (const Shape& shape : {Shape{ball}, Shape{box}, Shape{ground, false}}) {
    for (const Cut& cut :
         {Cut{-3.0, 3.0}, Cut{-2.0, 5.0}, Cut{-1.0, 1.0, 0.2}, Cut{-1.0, 1.0, 0.2, 0.15},
          Cut{-0.4, 1.0, 0.2}, Cut{-32767.0, 32767.0, 8191.75}, Cut{-127.0, 127.0, 25.4, 0.15}}) {
      for (const double sign : {1.0, -1.0}) {
        // On a shape that is not closed, either side may be solid, so only the usual sign is
        // tested.
        if (sign < 0.0 && !shape.closed) continue;
        for (const bool sparse : {false, true}) {
          if (sparse && cut.scale != 1.0) continue;
          SuggestInput input = scalar(
              [&](const Vec3d& p) {
                const double d = cut.scale * (shape.distance(p) + cut.deviation * noise(p));
                return static_cast<float>(sign * std::clamp(d, cut.from, cut.to));
              },
              40);
          if (sparse) {
            auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(input.grid->deepCopyGrid());
            const auto end = static_cast<float>(sign * cut.to);
            openvdb::tools::changeBackground(grid->tree(), end);
            for (auto it = grid->beginValueOn(); it; ++it) {
              if (*it == end) it.setValueOff();
            }
            input.grid = grid;
            input.extent.reset();
          }
          const Json scene = suggested({input});
          CAPTURE(shape.closed, cut.from, cut.to, cut.scale, cut.deviation, sign, sparse,
                  scene.dump(2));
          const Json surface = only(scene, "isosurface");
          CHECK(surface["value"] == 0.0);
          CHECK(surface["solid"] == (sign > 0.0 ? "below" : "above"));
          CHECK(scene["modes"].size() == 1);
        }
      }
    }
  }
}

TEST_CASE(
    "the distance field of a ground gets a surface at 0 if its largest distance is the background",
    "[guess]") {
  for (const float sign : {1.0F, -1.0F}) {
    SuggestInput input = scalar(
        [sign](const Vec3d& p) {
          return sign * static_cast<float>(std::clamp(p.z() - 5.2, -3.0, 3.0));
        },
        40);
    auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(input.grid->deepCopyGrid());
    openvdb::tools::changeBackground(grid->tree(), 3.0F * sign);
    for (auto it = grid->beginValueOn(); it; ++it) {
      if (*it == 3.0F * sign) it.setValueOff();
    }
    input.grid = grid;
    input.extent = grid->evalActiveVoxelBoundingBox();
    const Json scene = suggested({input});
    CAPTURE(sign, scene.dump(2));
    const Json surface = only(scene, "isosurface");
    CHECK(surface["value"] == 0.0);
    CHECK(surface["solid"] == (sign > 0.0F ? "below" : "above"));
  }
}

TEST_CASE("a narrow-band distance field without a grid class gets a surface at 0", "[guess]") {
  for (const double half_width : {1.5, 2.0, 3.0}) {
    const auto ball = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(
        1.5F, Vec3f(0.0F), 0.1F, static_cast<float>(half_width));
    ball->setGridClass(openvdb::GRID_UNKNOWN);
    SuggestInput input;
    input.grid = ball;
    const Json surface = only(suggested({input}), "isosurface");
    CAPTURE(half_width);
    CHECK(surface["value"] == 0.0);
    CHECK(surface["solid"] == "below");
  }
}

TEST_CASE("a blurred step between -1 and 1 is not taken for a distance field", "[guess]") {
  for (const double width : {1.5, 3.0, 6.0}) {
    const auto phase = [width](const Vec3d& p) {
      return static_cast<float>(std::tanh((p.length() - 14.0) / width));
    };
    const Guess guess = suggest({"data.vdb", "", ""}, {scalar(phase, 56)});
    CHECK_THAT(guess.seen.at(0), !Contains("distance"));
  }
}

TEST_CASE("the weights of a distance field are recognised and get no surface", "[guess]") {
  const auto distance = [](const Vec3d& p) {
    return static_cast<float>(std::clamp(0.2 * (p.length() - 12.0), -1.0, 1.0));
  };
  const auto seen = [](const Vec3d& p) { return p.z() > -6.0 ? 30.0F + noise(p) : 0.0F; };
  const Guess guess =
      suggest({"data.vdb", "", ""}, {scalar(seen, 48, "weights"), scalar(distance, 48, "tsdf")});
  const Json scene = Json::parse(guess.scene);
  CHECK(only(scene, "isosurface")["of"] == "tsdf");
  CHECK_FALSE(scene["volumes"].contains("weights"));
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("weights of the distances in grid tsdf"));
}

TEST_CASE("a dense fog with few varying voxels gets the same modes as a sparse fog", "[guess]") {
  // The plume fills 0.1 %, 0.4 % or 3 % of the box.
  for (const double radius : {4.0, 6.5, 12.5}) {
    const auto plume = [radius](const Vec3d& p) {
      const double r = (p - Vec3d(3.0, 0.0, -5.0)).length() / radius;
      return static_cast<float>(r < 1.0 ? 5.0 * std::exp(-2.0 * r * r) : 0.0);
    };
    const SuggestInput dense = scalar(plume, 64);
    SuggestInput sparse = dense;
    auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(dense.grid->deepCopyGrid());
    for (auto it = grid->beginValueOn(); it; ++it) {
      if (*it == 0.0F) it.setValueOff();
    }
    sparse.grid = grid;
    const Json scene = suggested({dense});
    CAPTURE(radius, scene.dump(2));
    CHECK_FALSE(modesOf(scene, "isosurface").empty());
    CHECK(scene["modes"] == suggested({sparse})["modes"]);
    CHECK_THAT(scene["volumes"]["density"]["description"].get<std::string>(),
               Contains("0 in nearly all voxels"));
  }
  // A few different voxels are not a body.
  CHECK_THROWS_AS(
      suggestScene("data.vdb",
                   {scalar([](const Vec3d& p) { return p.length() < 1.0 ? 7.0F : 1.0F; })}),
      VolumeError);
}

TEST_CASE("the surface of a small plume in noise is between the noise and the plume", "[guess]") {
  // The plume fills 0.05 %, 0.2 % or 1 % of the box.
  for (const auto& [radius, deviation] :
       {std::pair{3.2, 0.05}, {5.0, 0.05}, {8.5, 0.05}, {8.5, 3.0}}) {
    const auto plume = [radius = radius, deviation = deviation](const Vec3d& p) {
      const double r = (p - Vec3d(3.0, 0.0, -5.0)).length() / radius;
      return static_cast<float>(300.0 + (r < 1.0 ? 100.0 * std::exp(-2.0 * r * r) : 0.0) +
                                deviation * noise(p));
    };
    const Json scene = suggested({scalar(plume, 64)});
    CAPTURE(radius, deviation, scene.dump(2));
    const std::vector<Json> surfaces = modesOf(scene, "isosurface");
    REQUIRE_FALSE(surfaces.empty());
    for (const Json& surface : surfaces) {
      CHECK(surface["value"].get<double>() > 303.0 + 4.0 * deviation);
      CHECK(surface["value"].get<double>() < 390.0);
      CHECK(surface["solid"] == "above");
    }
  }
  // Spikes in single voxels are noise.
  const auto spikes = [](const Vec3d& p) {
    return static_cast<float>(300.0 + 0.05 * noise(p) + (noise(3.0 * p) > 3.0 ? 50.0 : 0.0));
  };
  const Guess guess = suggest({"data.vdb", "", ""}, {scalar(spikes, 64)});
  CHECK_THAT(guess.seen.at(0), !Contains("in nearly all voxels"));
}

TEST_CASE("a guessed scene sets no stiffness, so a weak device lowers the default", "[guess]") {
  const std::string text = suggestScene("data.vdb", {scalar(ball(16.0, 1000.0, 0.0, 0.0))});
  SceneSpec spec = parseScene(text, "suggested.json", "/data");
  CHECK(spec.any_stiffness);
  DeviceInfo weak;
  weak.name = "weak";
  weak.max_stiffness = 300.0;
  weak.max_damping = 5.0;
  CHECK_THAT(fitCoupling(spec, weak), Contains("300 N/m instead of the default 500 N/m"));
  CHECK_NOTHROW(checkDevice(spec, weak));
}

TEST_CASE("materials get surfaces from their volume fractions and not from their masses",
          "[guess]") {
  // Projectile nose and plate, as from a shock-physics code. The void between them has no array.
  const auto nose = [](const Vec3d& p) {
    return static_cast<float>(std::clamp(9.5 - (p - Vec3d(0.0, 0.0, 8.0)).length(), 0.0, 1.0));
  };
  const auto plate = [](const Vec3d& p) {
    return static_cast<float>(std::clamp(5.5 - std::abs(p.z() + 12.0), 0.0, 1.0));
  };
  const auto times = [](const Scalar& f, float factor) {
    return [f, factor](const Vec3d& p) { return factor * f(p); };
  };
  std::vector<SuggestInput> grids;
  for (const auto& [name, value] :
       std::vector<std::pair<std::string, Scalar>>{{"Mass for Armor Plate", times(plate, 0.9F)},
                                                   {"Mass for Body, Nose", times(nose, 0.8F)},
                                                   {"Volume Fraction for Armor Plate", plate},
                                                   {"Volume Fraction for Body, Nose", nose}}) {
    grids.push_back(ofMesh(scalar(value, 40, name)));
  }
  const Guess guess = suggest({"data.vdb", "", ""}, grids);
  const Json scene = Json::parse(guess.scene);
  CAPTURE(guess.scene);
  REQUIRE(modesOf(scene, "isosurface").size() == 2);
  CHECK(scene["modes"].size() == 2);
  for (const Json& mode : scene["modes"]) {
    CHECK(mode["value"] == 0.5);
    CHECK_THAT(mode["of"].get<std::string>(), Contains("Volume_Fraction"));
  }
  REQUIRE(guess.left.size() == 2);
  CHECK_THAT(guess.left[0], Contains("Mass for Armor Plate: a mass"));
}

namespace {

/// Billig's shock in front of a ball of radius 14 voxels at Mach 5 (Journal of Spacecraft and
/// Rockets, 1967). The flow is along x.
struct BowShock {
  double body = 14.0;
  double mach = 5.0;

  /// Returns the distance of p behind the shock [voxels], and the pressure ratio there.
  [[nodiscard]] std::pair<double, double> at(const Vec3d& p) const {
    const double ahead = 0.143 * std::exp(3.24 / (mach * mach)) * body;
    const double bend = 1.143 * std::exp(0.54 / std::pow(mach - 1.0, 1.2)) * body;
    const double tan = std::tan(std::asin(1.0 / mach));
    const double y = std::hypot(p.y(), p.z());
    const double root = std::sqrt(1.0 + y * y * tan * tan / (bend * bend));
    const double nose = -(body + ahead - bend / (tan * tan) * (root - 1.0));
    const double sine = std::sin(std::atan2(1.0, y / root / bend));
    return {(p.x() - 12.0 - nose) * sine,
            1.0 + 7.0 / 6.0 * (std::pow(std::max(1.0, mach * sine), 2.0) - 1.0)};
  }
};

}  // namespace

TEST_CASE("the median distance of the guessed surface from a bow shock is below 1 voxel",
          "[guess]") {
  const BowShock shock;
  const auto pressure = [&](const Vec3d& p) {
    const auto [depth, ratio] = shock.at(p);
    const double fall = std::exp(-std::max(depth, 0.0) / 40.0);
    return static_cast<float>(1.0 + (ratio - 1.0) * fall / (1.0 + std::exp(-depth)));
  };
  const SuggestInput input = ofMesh(scalar(pressure, 80, "Pressure"));
  const Json scene = suggested({input});
  CAPTURE(scene.dump(2));
  const Json mode = only(scene, "isosurface");
  CHECK(mode["solid"] == "above");
  // Finds the surface along the flow, and its distance from the shock.
  std::vector<double> off;
  for (int y = -30; y <= 30; y += 6) {
    for (int z = -30; z <= 30; z += 6) {
      for (double x = -39.0; x < 39.0; x += 0.1) {
        const Vec3d p(x, y, z);
        if (pressure(p) < mode["value"].get<double>()) continue;
        off.push_back(std::abs(shock.at(p).first));
        break;
      }
    }
  }
  REQUIRE(off.size() > 100);
  std::sort(off.begin(), off.end());
  CHECK(off[off.size() / 2] < 1.0);
  CHECK(off[off.size() * 9 / 10] < 3.0);
}

TEST_CASE("the guessed modes of a CT act on the patient and not on the table", "[guess]") {
  // A head with a cavity of air, in which there is a vessel. A table is four voxels below the head.
  const auto value = [](const Vec3d& p) {
    const double r = (p - Vec3d(0.0, 6.0, 0.0)).length();
    if (r < 2.0) return 40.0F;
    if (r < 5.0) return -1000.0F;
    if (r < 15.0) return r > 11.0 && r < 13.0 ? 900.0F : 40.0F;
    return std::abs(p.y() + 16.0) < 3.0 && std::abs(p.x()) < 16.0 ? 200.0F : -1000.0F;
  };
  SuggestInput ct = scalar(value);
  ct.value_unit = "HU";
  const std::optional<LargestBody> body = findLargestBody(ct);
  REQUIRE(body.has_value());
  CHECK(body->left == 1);
  SuggestInput region;
  region.grid = body->region;
  const auto within = [&](const Vec3d& p) {
    return body->region->tree().isValueOn(openvdb::Coord::round(body->region->worldToIndex(p)));
  };
  CHECK(within({0.0, 6.0, 0.0}));          // the vessel
  CHECK(within({14.0, 6.0, 0.0}));         // the skin
  CHECK(within({16.0, 6.0, 0.0}));         // the air on the skin
  CHECK_FALSE(within({0.0, -12.0, 0.0}));  // the air on the table
  CHECK_FALSE(within({10.0, -16.0, 10.0}));

  const Guess guess = suggest({"data.vdb", "", ""}, {ct, region});
  const Json scene = Json::parse(guess.scene);
  CAPTURE(guess.scene);
  CHECK(scene["volumes"]["density_body"]["place"]["like"] == "density");
  for (const Json& mode : scene["modes"]) {
    const Json& strength = mode["strength"];
    CHECK((strength.is_number() ? mode["by"] : strength["product"][1]["by"]) == "density_body");
  }
  REQUIRE(guess.left.size() == 1);
  CHECK_THAT(guess.left[0], Contains("largest body") && Contains("to keep all, remove every"));
  CHECK_NOTHROW(parseScene(guess.scene, "suggested.json", "/data"));

  // The scene names the region after its grid, without the characters that names cannot have.
  const auto renamed = ct.grid->deepCopyGrid();
  renamed->setName("CT (HU)");
  SuggestInput spaced = ct;
  spaced.grid = renamed;
  SuggestInput its_region;
  its_region.grid = findLargestBody(spaced)->region;
  CHECK(its_region.name() == "CT (HU)_body");
  CHECK(volumeNameOf(its_region.name()) == "CT_HU_body");
  const Json other = Json::parse(suggest({"data.vdb", "", ""}, {spaced, its_region}).scene);
  CAPTURE(other.dump());
  CHECK(other["volumes"].contains("CT_HU_body"));

  // A head without a table is used as a whole.
  SuggestInput alone = scalar([&](const Vec3d& p) { return p.y() < -10.0 ? -1000.0F : value(p); });
  alone.value_unit = "HU";
  CHECK_FALSE(findLargestBody(alone).has_value());
}

TEST_CASE("a value that marks missing data gives no surface", "[guess]") {
  for (const double nothing : {-9999.0, 1e20}) {
    const Guess guess =
        suggest({"data.vdb", "", ""}, {scalar([nothing](const Vec3d& p) {
                  return static_cast<float>(p.length() < 18.0 ? 300.0 + 2.03 * p.x() + 0.1 * p.y()
                                                              : nothing);
                })});
    const Json scene = Json::parse(guess.scene);
    CAPTURE(guess.scene);
    CHECK(modesOf(scene, "isosurface").empty());
    const Json knots = only(scene, "viscosity")["strength"]["piecewise"];
    CHECK(knots[0][0].get<double>() > 260.0);
    CHECK(knots[1][0].get<double>() < 340.0);
    CHECK_THAT(guess.seen.at(0), Contains("marks missing data"));
  }
}

TEST_CASE("the guessed skin surface of a noisy MR image is above the noise of its air", "[guess]") {
  const auto value = [](const Vec3d& p) {
    if (p.length() < 18.0) return static_cast<float>(350.0 + 15.0 * noise(p));
    return static_cast<float>(15.0 * std::hypot(noise(p), noise(p + Vec3d(0.0, 0.0, 100.0))));
  };
  const Guess guess = suggest({"data.vdb", "", ""}, {scalar(value, 64)}, GuessFor::kMri);
  const Json skin = only(Json::parse(guess.scene), "isosurface");
  CAPTURE(guess.scene);
  CHECK(skin["value"].get<double>() > 50.0);
  CHECK(skin["value"].get<double>() < 200.0);
}

TEST_CASE("the guessed skin and bone surfaces of VTK's head are near 500 and 1150", "[.][data]") {
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
  const Json scene = suggested({input});
  const std::vector<Json> surfaces = modesOf(scene, "isosurface");
  REQUIRE(surfaces.size() == 2);
  CHECK(surfaces[0]["value"].get<double>() == Approx(500.0).margin(100.0));
  CHECK(surfaces[1]["value"].get<double>() == Approx(1150.0).margin(50.0));
}

}  // namespace palpate::suggest_test
