#include "palpate/scenes/library/fragments.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <random>
#include <variant>
#include <vector>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/scenes/library/write_grids.h"

namespace palpate {
namespace {

using Json = nlohmann::ordered_json;
using openvdb::Coord;

/// Depth of the fall outside the solid, or beyond a face [voxels].
constexpr double kRim = 3.0;
/// Pieces with fewer voxels are dropped.
constexpr std::uint64_t kLeastVoxels = 64;

/// Same numbers on every machine; the standard's distributions do not guarantee this.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  /// Returns a number in [0, 1).
  double uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  std::uint64_t below(std::uint64_t n) {
    return static_cast<std::uint64_t>(uniform() * static_cast<double>(n));
  }
  /// All orientations are equally likely (Shoemake 1992).
  Eigen::Quaterniond rotation() {
    const double u = uniform();
    const double a = 2.0 * M_PI * uniform();
    const double b = 2.0 * M_PI * uniform();
    return {std::sqrt(u) * std::cos(b), std::sqrt(1.0 - u) * std::sin(a),
            std::sqrt(1.0 - u) * std::cos(a), std::sqrt(u) * std::sin(b)};
  }

 private:
  std::mt19937_64 engine_;
};

/// Receives progress; an exception thrown by it cancels.
using Told = std::function<void(double)>;
constexpr std::uint64_t kTold = 100000;  // voxels between two calls

/// A fragment in the making.
struct Piece {
  openvdb::FloatGrid::Ptr grid;
  Vec3 middle = Vec3::Zero();  ///< In the volume's file space.
  Vec3 size = Vec3::Zero();
};

/// Breaks the solid of a scalar grid.
template <class GridT>
class Breaker {
 public:
  Breaker(const GridT& grid, const Volume::Grid::Part& part, const Vec3& voxel,
          const FragmentOrder& order)
      : grid_(grid),
        part_(part),
        edges_(voxel),
        rim_(kRim * voxel.minCoeff()),
        sign_(order.solid == Solid::kAbove ? 1.0 : -1.0),
        value_(order.value) {}

  /// Draws the pieces' sites: voxels of the solid, all equally likely.
  std::vector<Vec3> drawSites(int count, Random& random, const Told& told) {
    std::uint64_t solid = 0;
    std::uint64_t seen = 0;
    double steps = 0.0;
    std::uint64_t crossings = 0;
    const auto accessor = grid_.getConstUnsafeAccessor();
    for (auto at = grid_.cbeginValueOn(); at; ++at) {
      if (seen++ % kTold == 0) told(0.0);
      const double here = above(*at);
      if (here > 0.0) ++solid;
      for (int axis = 0; axis < 3; ++axis) {
        Coord next = at.getCoord();
        ++next[axis];
        typename GridT::ValueType value{};
        if (!accessor.probeValue(next, value)) continue;
        if ((above(value) > 0.0) == (here > 0.0)) continue;
        steps += std::abs(above(value) - here) / edges_[axis];
        ++crossings;
      }
    }
    if (crossings == 0) {
      throw Error("--value", fmt::format("there is no surface of {} in the volume", value_),
                  "palpate info tells its range");
    }
    slope_ = steps / static_cast<double>(crossings);
    std::vector<std::uint64_t> drawn;
    drawn.reserve(static_cast<std::size_t>(count));
    for (int i = 0; i < count; ++i) drawn.push_back(random.below(solid));
    std::sort(drawn.begin(), drawn.end());
    drawn.erase(std::unique(drawn.begin(), drawn.end()), drawn.end());
    std::vector<Vec3> sites;
    std::uint64_t number = 0;
    for (auto at = grid_.cbeginValueOn(); at && sites.size() < drawn.size(); ++at) {
      if (!(above(*at) > 0.0)) continue;
      if (number++ == drawn[sites.size()]) sites.push_back(placeOf(at.getCoord()));
    }
    return sites;
  }

  /// Makes a piece for each site.
  std::vector<openvdb::FloatGrid::Ptr> breakAt(const std::vector<Vec3>& sites, const Told& told) {
    const std::size_t n = sites.size();
    std::vector<double> per_twice(n * n, 0.0);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) {
        if (i != j) per_twice[i * n + j] = 0.5 / (sites[i] - sites[j]).norm();
      }
    }
    std::vector<openvdb::FloatGrid::Ptr> grids;
    std::vector<openvdb::FloatGrid::Accessor> writers;
    const double lowest = -slope_ * rim_;
    const auto background = static_cast<float>(value_ + sign_ * lowest);
    grids.reserve(n);
    writers.reserve(n);
    for (std::size_t i = 0; i < n; ++i) {
      grids.push_back(openvdb::FloatGrid::create(background));
      writers.push_back(grids.back()->getAccessor());
    }
    std::vector<double> squares(n);
    const std::uint64_t all = grid_.activeVoxelCount();
    std::uint64_t seen = 0;
    for (auto at = grid_.cbeginValueOn(); at; ++at) {
      if (seen++ % kTold == 0) told(0.9 * static_cast<double>(seen) / static_cast<double>(all));
      const double solid = above(*at);
      if (!(solid > lowest)) continue;
      const Vec3 p = placeOf(at.getCoord());
      for (std::size_t i = 0; i < n; ++i) squares[i] = (p - sites[i]).squaredNorm();
      const auto nearest = static_cast<std::size_t>(
          std::min_element(squares.begin(), squares.end()) - squares.begin());
      for (std::size_t i = 0; i < n; ++i) {
        // Distance within the faces of piece i. Starts with the face of the nearest site, which is
        // nearly always the nearest face.
        const double* per = per_twice.data() + i * n;
        double within = i == nearest ? 1e300 : (squares[nearest] - squares[i]) * per[nearest];
        if (!(within > -rim_)) continue;
        for (std::size_t j = 0; j < n; ++j) {
          if (j != i) within = std::min(within, (squares[j] - squares[i]) * per[j]);
        }
        const double here = std::min(solid, slope_ * within);
        if (here > lowest) {
          writers[i].setValue(at.getCoord(), static_cast<float>(value_ + sign_ * here));
        }
      }
    }
    return grids;
  }

 private:
  /// Returns the value relative to the surface's, positive on the solid's side.
  [[nodiscard]] double above(double value) const { return sign_ * (value - value_); }
  [[nodiscard]] Vec3 placeOf(const Coord& c) const {
    return part_.toFile(Vec3(c.x(), c.y(), c.z()));
  }

  const GridT& grid_;
  const Volume::Grid::Part& part_;
  Vec3 edges_;  ///< Edges of a voxel [file].
  double rim_;  ///< Depth of the fall [file].
  double sign_;
  double value_;
  double slope_ = 0.0;  ///< Slope of the value at the solid's surface, per unit of length of the
                        ///< file.
};

/// Sets the grid's map, with the piece's middle at the origin, and the piece's size and middle.
void place(Piece& piece, const Volume::Grid::Part& part) {
  const openvdb::CoordBBox box = piece.grid->evalActiveVoxelBoundingBox();
  const auto corner = [](const Coord& c) { return Vec3(c.x(), c.y(), c.z()); };
  const Box file = boxAbout({corner(box.min()), corner(box.max())},
                            [&](const Vec3& p_I) { return part.toFile(p_I); });
  piece.middle = file.centre();
  piece.size = file.size();
  openvdb::Mat4d map = openvdb::Mat4d::identity();
  for (int row = 0; row < 3; ++row) {
    // OpenVDB multiplies row vectors from the left.
    for (int column = 0; column < 3; ++column) map(column, row) = part.linear(row, column);
    map(3, row) = part.origin[row] - piece.middle[row];
  }
  piece.grid->setTransform(openvdb::math::Transform::createLinearTransform(map));
}

void write(const openvdb::FloatGrid::Ptr& grid, const std::filesystem::path& file) {
  writeGrids(file, {grid});
}

void checkOrder(const FragmentOrder& order) {
  const auto refuse = [](const char* what, const std::string& range) {
    throw Error(what, "it is out of range", "use " + range);
  };
  if (order.pieces < 2 || order.pieces > kMostPieces) {
    refuse("--pieces", fmt::format("2 to {}", kMostPieces));
  }
  if (order.places < order.pieces || order.places > kMostFragments) {
    refuse("--count", fmt::format("at least as many as pieces, at most {}", kMostFragments));
  }
  if (!(order.room > 0.0 && order.room <= 1000.0)) refuse("--room", "up to 1000 m, as 1");
  if (!(order.metres_per_unit > 0.0)) refuse("--unit", "m, cm, mm or um");
  if (!std::isfinite(order.value)) refuse("--value", "a number");
  if (!(order.strength > 0.0 && order.strength <= 1000.0)) refuse("--strength", "newtons, as 3");
}

/// Rounds to a micrometre, for a file that people read.
double rounded(double x) {
  return std::round(x * 1e6) / 1e6;
}

}  // namespace

Fragments strewFragments(const Volume& volume, const FragmentOrder& order,
                         const std::filesystem::path& folder,
                         const std::function<void(double)>& progress) {
  checkOrder(order);
  const Volume::Grid& source = volume.grid();
  if (volume.info().vector) {
    throw Error("grid \"" + volume.info().name + "\"", "it has vectors and no solid",
                "name a scalar grid");
  }
  if (volume.info().grid_class == GridClass::kLevelSet) {
    throw Error("grid \"" + volume.info().name + "\"",
                "it is a level set, whose inside has no data", "take a CT, an MRI or a fog");
  }
  const Told told = [&](double done) {
    if (progress) progress(done);
  };
  Random random(order.seed);
  const Volume::Grid::Part& part = source.parts.front();
  std::vector<openvdb::FloatGrid::Ptr> grids;
  std::visit(
      [&](const auto& grid) {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
        if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
          const typename GridT::Ptr voxels = grid->deepCopy();
          voxels->tree().voxelizeActiveTiles();
          Breaker<GridT> breaker(*voxels, part, volume.info().voxel, order);
          const std::vector<Vec3> sites = breaker.drawSites(order.pieces, random, told);
          grids = breaker.breakAt(sites, told);
        }
      },
      part.data);

  Fragments out;
  std::vector<Piece> pieces;
  for (openvdb::FloatGrid::Ptr& grid : grids) {
    if (grid->activeVoxelCount() < kLeastVoxels) continue;
    Piece piece{std::move(grid)};
    place(piece, part);
    pieces.push_back(std::move(piece));
  }
  if (pieces.empty()) {
    throw Error("--pieces", "none of them has as many voxels as can be felt", "use fewer");
  }
  Json scene;
  scene["palpate"] = 1;
  scene["volumes"] = Json::object();
  scene["modes"] = Json::array();
  std::vector<std::string> names;
  double volume_of_boxes = 0.0;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    told(0.9);
    const std::string name = fmt::format("fragment-{:03}", i + 1);
    openvdb::FloatGrid& grid = *pieces[i].grid;
    grid.setName("fragment");
    grid.insertMeta("source", openvdb::StringMetadata(fmt::format(
                                  "palpate shatter, piece {} of {}, seed {}, of {}", i + 1,
                                  pieces.size(), order.seed, volume.info().name)));
    write(pieces[i].grid, folder / (name + ".vdb"));
    scene["volumes"][name] = {{"file", name + ".vdb"}, {"instances", Json::array()}};
    scene["modes"].push_back(Json{{"name", name},
                                  {"mode", "isosurface"},
                                  {"of", name},
                                  {"value", order.value},
                                  {"solid", order.solid == Solid::kAbove ? "above" : "below"},
                                  {"strength", order.strength}});
    names.push_back(name);
    out.voxels += grid.activeVoxelCount();
    out.size += order.metres_per_unit * pieces[i].size.maxCoeff();
  }
  out.pieces = static_cast<int>(pieces.size());
  out.places = order.places;
  out.size /= out.pieces;
  for (int k = 0; k < order.places; ++k) {
    if (static_cast<std::uint64_t>(k) % kTold == 0) told(0.95);
    // Use every piece once before any repeats.
    const std::size_t i = static_cast<std::size_t>(k) % pieces.size();
    const Eigen::Quaterniond turn = random.rotation();
    Vec3 at;
    for (double& x : at) x = rounded(order.room * (random.uniform() - 0.5));
    scene["volumes"][names[i]]["instances"].push_back(
        Json{{"scale", order.metres_per_unit},
             {"rotation_wxyz",
              {rounded(turn.w()), rounded(turn.x()), rounded(turn.y()), rounded(turn.z())}},
             {"translate", {at.x(), at.y(), at.z()}}});
    const Vec3 box = turn.toRotationMatrix().cwiseAbs() * pieces[i].size * order.metres_per_unit;
    volume_of_boxes += box.prod();
  }
  out.overlap = volume_of_boxes / std::pow(order.room, 3);
  const std::filesystem::path file = folder / "scene.json";
  std::ofstream text(file);
  text << "{\n\"palpate\": 1,\n\"volumes\": {";
  // Write one volume and one instance per line.
  const char* between = "\n";
  for (const auto& [name, entry] : scene["volumes"].items()) {
    told(0.99);
    text << between << "\"" << name << "\": {\"file\": " << entry["file"] << ", \"instances\": [";
    const char* comma = "\n";
    for (const Json& instance : entry["instances"]) {
      text << comma << "  " << instance.dump();
      comma = ",\n";
    }
    text << "]}";
    between = ",\n";
  }
  text << "},\n\"modes\": [";
  between = "\n";
  for (const Json& mode : scene["modes"]) {
    text << between << "  " << mode.dump();
    between = ",\n";
  }
  text << "]}\n";
  text.close();
  if (!text) {
    throw Error(file.string(), "it cannot be written", "choose another place, or make room");
  }
  told(1.0);
  return out;
}

}  // namespace palpate
