#include "palpate/scenes/library/made.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <openvdb/tools/SignedFloodFill.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/library/write_grids.h"

namespace palpate {
namespace made {
namespace {

/// Returns the velocity at p_F, per unit of circulation, that a straight piece of a vortex filament
/// induces. The piece extends from a + `from` e to a + `to` e; both may be infinite.
Vec3 straightVortex(const Vec3& p_F, const Vec3& a_F, const Vec3& e_F, double from, double to,
                    double core) {
  const Vec3 r_F = p_F - a_F;
  const double along = r_F.dot(e_F);
  const Vec3 around_F = e_F.cross(r_F);
  const double h2 = around_F.squaredNorm() + core * core;
  // Antiderivative of h^2 (s^2 + h^2)^(-3/2): s / sqrt(s^2 + h^2).
  const auto reach = [&](double s) {
    return std::isinf(s) ? std::copysign(1.0, s) : s / std::sqrt(s * s + h2);
  };
  return around_F * ((reach(to - along) - reach(from - along)) / (4.0 * M_PI * h2));
}

/// Returns 1 up to `inner` and 0 from `outer` on, with a smooth transition.
double fade(double x, double inner, double outer) {
  const double t = std::clamp((outer - x) / (outer - inner), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

}  // namespace

Vec3 Wind::velocity(const Vec3& p_F) const {
  const double half = 0.5 * span;
  const double far = std::numeric_limits<double>::infinity();
  const Vec3 x = Vec3::UnitX();
  const Vec3 y = Vec3::UnitY();
  // The bound vortex points along +y, so the air above the wing is faster, which gives lift.
  const Vec3 turned = straightVortex(p_F, Vec3::Zero(), y, -half, half, core) +
                      straightVortex(p_F, half * y, x, 0.0, far, core) -
                      straightVortex(p_F, -half * y, x, 0.0, far, core);
  return stream * x + circulation * turned;
}

double wing(const Vec3& p_F) {
  constexpr double kPitch = 6.0 * M_PI / 180.0;
  constexpr double kRound = 0.008;  // [m]: radius of the round edges
  // half of chord, span and thickness, including the round edges [m]
  const Vec3 half(0.04, 0.15, 0.008);
  const double c = std::cos(kPitch);
  const double s = std::sin(kPitch);
  // Converts p_F to the wing's axes. The nose points up.
  const Vec3 p(c * p_F.x() - s * p_F.z(), p_F.y(), s * p_F.x() + c * p_F.z());
  const Vec3 beyond = p.cwiseAbs() - (half - Vec3::Constant(kRound));
  return beyond.cwiseMax(0.0).norm() + std::min(beyond.maxCoeff(), 0.0) - kRound;
}

Fibre fibre(const Vec3& p_F) {
  // Diffusivities [1e-3 mm^2/s], similar to those of white and grey matter.
  constexpr double kAlong = 1.7;
  constexpr double kAcross = 0.3;
  constexpr double kTissue = 0.7;
  constexpr double kInner = 6.0;  // [mm]: up to this radius, a bundle has its full share
  constexpr double kOuter = 9.0;  // [mm]: radius at which the share is 0
  constexpr double kBend = 24.0;  // radius of the bent bundle [mm]
  const Vec3 centre(-kBend, 0.0, 0.0);

  const double first = fade(std::hypot(p_F.y(), p_F.z()), kInner, kOuter);
  const Vec3 r = p_F - centre;
  const double radius = std::hypot(r.x(), r.y());
  double second = fade(std::hypot(radius - kBend, p_F.z()), kInner, kOuter);
  // Uses half of the circle, because the other half would cross the first bundle again.
  second *= fade(-r.x(), -4.0, 0.0);
  const double shares = std::max(first + second, 1e-300);
  const double fibres = std::max(first, second);
  if (fibres <= 0.0) return {};

  const auto bundle = [&](const Vec3& e) {
    return Mat3(kAcross * Mat3::Identity() + (kAlong - kAcross) * e * e.transpose());
  };
  const Vec3 round = radius > 0.0 ? Vec3(-r.y() / radius, r.x() / radius, 0.0) : Vec3::UnitY();
  const Mat3 D = (1.0 - fibres) * kTissue * Mat3::Identity() +
                 fibres / shares * (first * bundle(Vec3::UnitX()) + second * bundle(round));
  const Eigen::SelfAdjointEigenSolver<Mat3> eigen(D);
  const Vec3& l = eigen.eigenvalues();
  Fibre out;
  out.direction = eigen.eigenvectors().col(2);
  out.anisotropy = std::sqrt(0.5) * Vec3(l[2] - l[1], l[1] - l[0], l[0] - l[2]).norm() / l.norm();
  return out;
}

double signAt(int i, int j, int k) {
  // Hash of the three indices: the last mixing step of SplitMix64.
  std::uint64_t h = (static_cast<std::uint64_t>(static_cast<std::uint32_t>(i)) << 42U) ^
                    (static_cast<std::uint64_t>(static_cast<std::uint32_t>(j)) << 21U) ^
                    static_cast<std::uint64_t>(static_cast<std::uint32_t>(k));
  h += 0x9e3779b97f4a7c15U;
  h = (h ^ (h >> 30U)) * 0xbf58476d1ce4e5b9U;
  h = (h ^ (h >> 27U)) * 0x94d049bb133111ebU;
  h ^= h >> 31U;
  return (h & 1U) != 0 ? 1.0 : -1.0;
}

double bowl(const Vec3& p_F) {
  constexpr double kRadius = 30.0;     // radius of the middle surface of the wall [mm]
  constexpr double kHalf = 3.0;        // half the thickness of the wall [mm]
  constexpr double kRim = M_PI / 3.0;  // angle between +z and the rim
  const double r = std::hypot(p_F.x(), p_F.y());
  const double z = p_F.z();
  if (std::atan2(r, z) >= kRim) return std::abs(std::hypot(r, z) - kRadius) - kHalf;
  return std::hypot(r - kRadius * std::sin(kRim), z - kRadius * std::cos(kRim)) - kHalf;
}

double cloud(const Vec3& p_F) {
  constexpr double kCore = 8.0;   // [mm]: radius of the region with density 1
  constexpr double kEdge = 26.0;  // [mm]: radius at which the density is 0
  const Vec3 centre(14.0, 0.0, 8.0);
  return std::clamp((kEdge - (p_F - centre).norm()) / (kEdge - kCore), 0.0, 1.0);
}

namespace {

/// Returns the signed distance to an ellipsoid's surface: exact on the surface, accurate to first
/// order near the surface.
double ellipsoid(const Vec3& p, const Vec3& axes) {
  const double k0 = p.cwiseQuotient(axes).norm();
  const double k1 = p.cwiseQuotient(axes.cwiseProduct(axes)).norm();
  return k1 > 0.0 ? k0 * (k0 - 1.0) / k1 : -axes.minCoeff();
}

/// Returns a value that rises linearly from 0 at d = -width / 2 to 1 at d = width / 2.
double ramp(double d, double width) {
  return std::clamp(0.5 + d / width, 0.0, 1.0);
}

}  // namespace

double ventricle(const Vec3& p_F) {
  constexpr double kRim = 24.0;  // [mm]: height of the rim
  const double outer = ellipsoid(p_F, {32.0, 32.0, 48.0});
  const double inner = ellipsoid(p_F, {22.0, 22.0, 38.0});
  return std::max({outer, -inner, p_F.z() - kRim});
}

Vec3 beat(const Vec3& x_F, double share) {
  constexpr double kRim = 24.0;     // height of the rim, which does not move along z [mm]
  constexpr double kSystole = 0.4;  // fraction of a beat
  constexpr double kRelaxed = 0.75;
  const double t = share - std::floor(share);
  double tension = 0.0;
  if (t < kSystole) {
    tension = std::pow(std::sin(0.5 * M_PI * t / kSystole), 2);
  } else if (t < kRelaxed) {
    tension = std::pow(std::cos(0.5 * M_PI * (t - kSystole) / (kRelaxed - kSystole)), 2);
  }
  const double r = std::hypot(x_F.x(), x_F.y());
  const double wide = 1.0 + 0.9 * tension * std::exp(-r * r / (19.2 * 19.2));
  const double long_axis = 1.0 / (1.0 - 0.12 * tension);
  const double turn = tension * 15.0 * M_PI / 180.0 * (kRim - x_F.z()) / 72.0;
  const Vec3 rest(wide * (std::cos(turn) * x_F.x() - std::sin(turn) * x_F.y()),
                  wide * (std::sin(turn) * x_F.x() + std::cos(turn) * x_F.y()),
                  kRim + long_axis * (x_F.z() - kRim));
  return rest - x_F;
}

double trunk(const Vec3& p_F) {
  constexpr double kEdge = 6.0;  // width of the transition between two materials [mm]
  const double body = ellipsoid({p_F.x(), p_F.y(), 0.0}, {150.0, 100.0, 1e6});
  const double ends = std::abs(p_F.z()) - 140.0;
  // The diaphragm, a dome, is the lower end of the lungs.
  const double dome = p_F.z() + 30.0 + (p_F.x() * p_F.x() + p_F.y() * p_F.y()) / 300.0;
  double lungs = 1e9;
  for (const double side : {-1.0, 1.0}) {
    const double lung = ellipsoid(p_F - Vec3(side * 65.0, 0.0, 0.0), {52.0, 72.0, 115.0});
    lungs = std::min(lungs, std::max(lung, -dome));
  }
  const double liver =
      std::max(ellipsoid(p_F - Vec3(35.0, -10.0, -75.0), {85.0, 65.0, 60.0}), dome + 8.0);
  const double air = ramp(std::max(body, ends), kEdge);
  const double lung = ramp(-lungs, kEdge);
  const double soft = 40.0 + 20.0 * ramp(-liver, kEdge);
  return air * -1000.0 + (1.0 - air) * (lung * -800.0 + (1.0 - lung) * soft);
}

Vec3 breath(const Vec3& x_F, double share) {
  // An even power of a sine: the trunk is near its resting shape longer than near full inhalation
  // (Lujan et al. 1999).
  const double in = std::pow(std::sin(M_PI * share), 4);
  const double front = ramp(40.0 - x_F.y(), 200.0);  // 1 up to y = -60 mm, 0 from y = 140 mm on
  const double diaphragm = std::exp(-std::pow((x_F.z() + 40.0) / 70.0, 2));
  const double chest = std::exp(-std::pow((x_F.z() - 20.0) / 90.0, 2));
  return in * Vec3(0.0, 6.0 * chest * front, 15.0 * diaphragm * (0.4 + 0.6 * front));
}

}  // namespace made

namespace {

using openvdb::Coord;

void everyVoxel(const Box& box_F, double voxel,
                const std::function<void(const Coord& at, const Vec3& p_F)>& visit) {
  const auto first = [&](int a) {
    return static_cast<int>(std::ceil(box_F.lower[a] / voxel - 1e-9));
  };
  const auto last = [&](int a) {
    return static_cast<int>(std::floor(box_F.upper[a] / voxel + 1e-9));
  };
  for (int i = first(0); i <= last(0); ++i) {
    for (int j = first(1); j <= last(1); ++j) {
      for (int k = first(2); k <= last(2); ++k) visit({i, j, k}, voxel * Vec3(i, j, k));
    }
  }
}

template <class GridT>
typename GridT::Ptr create(const char* name, double voxel,
                           const typename GridT::ValueType& background) {
  auto grid = GridT::create(background);
  grid->setName(name);
  grid->setTransform(openvdb::math::Transform::createLinearTransform(voxel));
  return grid;
}

openvdb::Vec3f toVdb(const Vec3& v) {
  return openvdb::Vec3f(openvdb::Vec3d(v.x(), v.y(), v.z()));
}

struct Making {
  openvdb::GridBase::Ptr grid;
  MadeGrid made;
};

/// Returns a level set with values up to three voxels from the surface.
openvdb::FloatGrid::Ptr levelSet(const char* name, const Box& box_F, double voxel,
                                 double (*distance)(const Vec3&)) {
  const double band = openvdb::LEVEL_SET_HALF_WIDTH * voxel;
  auto grid = create<openvdb::FloatGrid>(name, voxel, static_cast<float>(band));
  openvdb::FloatGrid::Accessor writer = grid->getAccessor();
  everyVoxel(box_F, voxel, [&](const Coord& at, const Vec3& p_F) {
    const double d = distance(p_F);
    if (std::abs(d) < band) writer.setValue(at, static_cast<float>(d));
  });
  openvdb::tools::signedFloodFill(grid->tree());
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  return grid;
}

std::vector<Making> makeWindTunnel(double voxel) {
  const made::Wind wind;
  // The background is the uniform stream, so the flow continues outside the box.
  auto velocity = create<openvdb::Vec3SGrid>("velocity", voxel, toVdb({wind.stream, 0, 0}));
  openvdb::Vec3SGrid::Accessor writer = velocity->getAccessor();
  // The box extends farther below the wing, because the air behind the wing moves down.
  const Box box_F{{-0.12, -0.24, -0.18}, {0.36, 0.24, 0.10}};
  everyVoxel(box_F, voxel, [&](const Coord& at, const Vec3& p_F) {
    writer.setValue(at, toVdb(wind.velocity(p_F)));
  });
  // The wing is thin, so the edge of its voxels is half that of the velocity grid.
  const Box about_F{{-0.08, -0.19, -0.05}, {0.08, 0.19, 0.05}};
  const auto wing = levelSet("wing", about_F, 0.5 * voxel, made::wing);
  return {
      {velocity,
       {.name = "", .what = "velocity of the air around and behind a wing", .value_unit = "m/s"}},
      {wing, {.name = "", .what = "distance to the wing", .value_unit = "m"}}};
}

std::vector<Making> makeFibres(double voxel) {
  auto direction = create<openvdb::Vec3SGrid>("direction", voxel, openvdb::Vec3f(0.0F));
  auto anisotropy = create<openvdb::FloatGrid>("anisotropy", voxel, 0.0F);
  openvdb::Vec3SGrid::Accessor to_direction = direction->getAccessor();
  openvdb::FloatGrid::Accessor to_anisotropy = anisotropy->getAccessor();
  everyVoxel({{-50, -34, -12}, {24, 34, 12}}, voxel, [&](const Coord& at, const Vec3& p_F) {
    const made::Fibre fibre = made::fibre(p_F);
    if (fibre.anisotropy <= 0.0) return;
    to_direction.setValue(at, toVdb(made::signAt(at.x(), at.y(), at.z()) * fibre.direction));
    to_anisotropy.setValue(at, static_cast<float>(fibre.anisotropy));
  });
  anisotropy->setGridClass(openvdb::GRID_FOG_VOLUME);
  return {{direction,
           {.name = "", .what = "direction of the fibres, with random signs", .value_unit = ""}},
          {anisotropy, {.name = "", .what = "fractional anisotropy, 0 to 1", .value_unit = ""}}};
}

std::vector<Making> makeTwoBodies(double voxel) {
  const auto bowl = levelSet("bowl", {{-38, -38, -38}, {38, 38, 26}}, voxel, made::bowl);
  auto cloud = create<openvdb::FloatGrid>("cloud", voxel, 0.0F);
  openvdb::FloatGrid::Accessor writer = cloud->getAccessor();
  everyVoxel({{-14, -28, -20}, {42, 28, 36}}, voxel, [&](const Coord& at, const Vec3& p_F) {
    const double density = made::cloud(p_F);
    if (density > 0.0) writer.setValue(at, static_cast<float>(density));
  });
  cloud->setGridClass(openvdb::GRID_FOG_VOLUME);
  return {
      {bowl, {.name = "", .what = "distance to a bowl", .value_unit = "mm"}},
      {cloud, {.name = "", .what = "density of a cloud in and around the bowl", .value_unit = ""}}};
}

/// Adds the frames of one cycle at equal intervals. The last frame equals the first one.
void addCycle(std::vector<Making>& to, const Box& box_F, double voxel, int frames,
              const std::string& what, Vec3 (*displaced)(const Vec3& x_F, double share)) {
  for (int frame = 0; frame <= frames; ++frame) {
    auto u = create<openvdb::Vec3SGrid>("u", voxel, openvdb::Vec3f(0.0F));
    openvdb::Vec3SGrid::Accessor writer = u->getAccessor();
    const double share = static_cast<double>(frame % frames) / frames;
    everyVoxel(box_F, voxel, [&](const Coord& at, const Vec3& x_F) {
      writer.setValue(at, toVdb(displaced(x_F, share)));
    });
    to.push_back({u, {.name = "", .what = what, .value_unit = "mm"}});
  }
}

std::vector<Making> makeHeart(double voxel) {
  std::vector<Making> all{
      {levelSet("muscle", {{-36, -36, -52}, {36, 36, 28}}, voxel, made::ventricle),
       {.name = "",
        .what = "distance to the surface of a heart's ventricle at rest",
        .value_unit = "mm"}}};
  addCycle(all, {{-48, -48, -66}, {48, 48, 42}}, 6.0, 16,
           "displacement from the beating muscle back to its place at rest", made::beat);
  return all;
}

std::vector<Making> makeBreathing(double voxel) {
  auto ct = create<openvdb::FloatGrid>("ct", voxel, -1000.0F);
  openvdb::FloatGrid::Accessor writer = ct->getAccessor();
  everyVoxel({{-162, -112, -150}, {162, 112, 150}}, voxel, [&](const Coord& at, const Vec3& p_F) {
    writer.setValue(at, static_cast<float>(made::trunk(p_F)));
  });
  std::vector<Making> all{{ct,
                           {.name = "",
                            .what = "a trunk after breathing out, in Hounsfield units",
                            .value_unit = "HU"}}};
  addCycle(all, {{-180, -140, -180}, {180, 140, 180}}, 20.0, 16,
           "displacement from the breathing trunk back to its place after breathing out",
           made::breath);
  return all;
}

struct Recipe {
  MadeVolume volume;
  std::vector<Making> (*make)(double voxel);
};

const std::vector<Recipe>& recipes() {
  static const std::vector<Recipe> all{
      {{"wind-tunnel", "air past a wing that leaves two vortices", "m", 0.005, 0.002, 0.02},
       makeWindTunnel},
      {{"fibres", "two bundles of fibres that cross, as diffusion imaging shows them", "mm", 1.0,
        0.25, 3.0},
       makeFibres},
      {{"two-bodies", "a bowl and a cloud, two objects that overlap", "mm", 1.0, 0.25, 3.0},
       makeTwoBodies},
      {{"beating-heart", "a ventricle and its motion in a heartbeat", "mm", 1.0, 0.5, 3.0},
       makeHeart},
      {{"breathing", "a trunk and its motion in a breath", "mm", 3.0, 2.0, 6.0}, makeBreathing}};
  return all;
}

void setMetadata(const Recipe& recipe, const Making& making) {
  openvdb::GridBase& grid = *making.grid;
  const auto text = [&](const char* key, const std::string& value) {
    if (!value.empty()) grid.insertMeta(key, openvdb::StringMetadata(value));
  };
  grid.setCreator(std::string("palpate ") + kVersion);
  text("source", "palpate make " + recipe.volume.name);
  text("description", making.made.what);
  text("length_unit", recipe.volume.length_unit);
  text("value_unit", making.made.value_unit);
  if (grid.isType<openvdb::Vec3SGrid>()) {
    grid.setVectorType(openvdb::VEC_CONTRAVARIANT_RELATIVE);
    grid.setIsInWorldSpace(true);
  }
}

const Recipe& recipeFor(const std::string& name) {
  std::vector<std::string> names;
  for (const Recipe& recipe : recipes()) {
    if (recipe.volume.name == name) return recipe;
    names.push_back(recipe.volume.name);
  }
  const std::string near = nearestName(name, names);
  throw Error("make", "\"" + name + "\" is not a procedural volume",
              near.empty() ? fmt::format("use one of {}", fmt::join(names, ", "))
                           : "did you mean \"" + near + "\"?");
}

}  // namespace

const std::vector<MadeVolume>& madeVolumes() {
  static const std::vector<MadeVolume> all = [] {
    std::vector<MadeVolume> volumes;
    for (const Recipe& recipe : recipes()) volumes.push_back(recipe.volume);
    return volumes;
  }();
  return all;
}

std::vector<MadeGrid> writeMade(const std::string& name, std::optional<double> voxel,
                                const std::filesystem::path& file) {
  const Recipe& recipe = recipeFor(name);
  const MadeVolume& volume = recipe.volume;
  const double edge = voxel.value_or(volume.voxel);
  if (!(edge >= volume.least_voxel && edge <= volume.most_voxel)) {
    throw Error("--voxel",
                fmt::format("{} is not in the range {} to {} {}", edge, volume.least_voxel,
                            volume.most_voxel, volume.length_unit),
                fmt::format("give an edge in this range, such as {}", volume.voxel));
  }
  openvdb::initialize();
  std::vector<Making> all = recipe.make(edge);
  openvdb::GridCPtrVec grids;
  std::vector<MadeGrid> out;
  for (Making& making : all) {
    setMetadata(recipe, making);
    making.made.name = making.grid->getName();
    making.made.active_voxels = making.grid->activeVoxelCount();
    making.made.voxel = making.grid->voxelSize().x();
    if (!out.empty() && out.back().name == making.made.name) {
      ++out.back().frames;
    } else {
      out.push_back(making.made);
    }
    grids.push_back(making.grid);
  }
  writeGrids(file, grids);
  return out;
}

}  // namespace palpate
