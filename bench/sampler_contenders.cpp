#include "bench/sampler_contenders.h"

#include <utility>
#include <variant>

#include <openvdb/math/Stencils.h>
#include <openvdb/tools/Interpolation.h>
#include <openvdb/tools/LevelSetSphere.h>
#ifdef PALPATE_NANOVDB
#include <nanovdb/util/OpenToNanoVDB.h>
#include <nanovdb/util/SampleFromVoxels.h>
#endif

#include "bench/machine.h"
#include "palpate/engine/field/field.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "tests/support/vdb_files.h"
#include "tests/support/vdb_grids.h"

namespace palpate::bench {
namespace {

using openvdb::Coord;
using openvdb::FloatGrid;
using openvdb::Vec3d;
using openvdb::Vec3SGrid;

Vec3 asVec3(const openvdb::Vec3f& v) noexcept {
  return {v.x(), v.y(), v.z()};
}

Vec3d asVec3d(const Vec3& v) noexcept {
  return {v.x(), v.y(), v.z()};
}

// Conversions of the results of readings to Sampled.
Sampled asSampled(double value) noexcept {
  return {value, Vec3::Zero()};
}
Sampled asSampled(const Sampled& s) noexcept {
  return s;
}
Sampled asSampled(const ScalarSample& s) noexcept {
  return {s.value, s.gradient};
}
Sampled asSampled(const VectorSample& s) noexcept {
  return {s.value.sum(), Vec3::Zero()};
}
Sampled asSampled(const Vec3& v) noexcept {
  return {v.sum(), Vec3::Zero()};
}
// Adds the numbers of a result, so that the optimiser does not remove the reading. Adds plain
// numbers, because in a large source the compiler does not inline Eigen's sum().
template <std::size_t N>
double added(const double* values) noexcept {
  double sum = 0.0;
  for (std::size_t i = 0; i < N; ++i) sum += values[i];
  return sum;
}
double summed(double value) noexcept {
  return value;
}
double summed(const Sampled& s) noexcept {
  return s.value + added<3>(s.gradient.data());
}
double summed(const ScalarSample& s) noexcept {
  return s.value + added<3>(s.gradient.data());
}
double summed(const VectorSample& s) noexcept {
  return added<3>(s.value.data()) + added<9>(s.jacobian.data());
}
double summed(const Vec3& v) noexcept {
  return added<3>(v.data());
}

double since(Clock::time_point start) {
  return std::chrono::duration<double, std::nano>(Clock::now() - start).count();
}

template <class Read>
class SamplerOf final : public Sampler {
 public:
  explicit SamplerOf(Read read) : read_(std::move(read)) {}

  [[nodiscard]] Sampled at(const Vec3& p) override { return asSampled(read_(p)); }

  [[nodiscard]] double timeAll(std::span<const Vec3> points) override {
    double sum = 0.0;
    const auto start = Clock::now();
    for (const Vec3& p : points) sum += summed(read_(p));
    sink_ = sum;
    return since(start);
  }

  [[nodiscard]] double timeOne(const Vec3& p) override {
    // Times an empty call first, which loads the clock's own code and memory page into the caches.
    sink_ = since(Clock::now());
    const auto start = Clock::now();
    sink_ = summed(read_(p));
    return since(start);
  }

 private:
  Read read_;
  volatile double sink_ = 0.0;
};

template <class Read>
Contender contender(const char* method, Reads reads, Read read, const char* note = "") {
  return {method, reads, note, std::make_unique<SamplerOf<Read>>(std::move(read))};
}

/// Returns a sampler that computes gradients from differences over half a voxel on each side.
template <class Read>
auto differencesOf(Read read) {
  return [read](const Vec3& p) {
    constexpr double kHalf = 0.5;
    Sampled out;
    out.value = read(p);
    for (int a = 0; a < 3; ++a) {
      const Vec3 step = kHalf * Vec3::Unit(a);
      out.gradient[a] = (read(p + step) - read(p - step)) / (2.0 * kHalf);
    }
    return out;
  };
}

template <class SamplerT, class GridT>
auto openVdb(const typename GridT::Ptr& grid) {
  using Accessor = openvdb::tree::ValueAccessor<const typename GridT::TreeType, false>;
  return [grid, accessor = std::make_shared<Accessor>(grid->tree())](const Vec3& p) {
    if constexpr (std::is_same_v<GridT, Vec3SGrid>) {
      return asVec3(SamplerT::sample(*accessor, asVec3d(p)));
    } else {
      return static_cast<double>(SamplerT::sample(*accessor, asVec3d(p)));
    }
  };
}

/// Returns a sampler whose argument is a position in world space, as for
/// openvdb::tools::GridSampler. GridSampler itself needs an accessor that locks.
template <class Read>
auto fromWorld(const FloatGrid::Ptr& grid, Read read) {
  return [grid, read](const Vec3& p) {
    const Vec3d q = grid->transform().worldToIndex(asVec3d(p));
    return read(Vec3(q.x(), q.y(), q.z()));
  };
}

/// Returns OpenVDB's stencil over a cell's eight voxels: value and gradient of their polynomial.
auto boxStencil(const FloatGrid::Ptr& grid) {
  using Stencil = openvdb::math::BoxStencil<FloatGrid, false>;
  return [grid, stencil = std::make_shared<Stencil>(*grid)](const Vec3& p) {
    const openvdb::Vec3f q(asVec3d(p));
    stencil->moveTo(Coord::floor(asVec3d(p)));
    Sampled out;
    out.value = stencil->interpolation(q);
    out.gradient = asVec3(stencil->gradient(q));
    return out;
  };
}

#ifdef PALPATE_NANOVDB
/// Returns NanoVDB's trilinear sampler, which keeps the cell of the last call.
auto nanoVdb(const FloatGrid::Ptr& grid) {
  using Handle = nanovdb::GridHandle<nanovdb::HostBuffer>;
  auto handle = std::make_shared<Handle>(
      nanovdb::openToNanoVDB<nanovdb::HostBuffer, openvdb::FloatTree, float>(*grid));
  using Accessor = nanovdb::NanoGrid<float>::AccessorType;
  auto accessor = std::make_shared<Accessor>(handle->grid<float>()->getAccessor());
  using TrilinearT = nanovdb::SampleFromVoxels<Accessor, 1, true>;
  auto sampler = std::make_shared<TrilinearT>(*accessor);
  return [handle, accessor, sampler](const Vec3& p) {
    const nanovdb::Vec3d q(p.x(), p.y(), p.z());
    Sampled out;
    out.value = (*sampler)(q);
    const auto gradient = sampler->gradient(q);
    out.gradient = {gradient[0], gradient[1], gradient[2]};
    return out;
  };
}
#endif

FieldPtr makeField(const std::shared_ptr<const Volume>& volume, Interpolation interpolation) {
  return makeVdbField(volume, Placement{}, {interpolation});
}

template <class Field>
auto ours(std::shared_ptr<const Field> field) {
  auto cache = std::make_shared<FieldCache>();
  field->reset(*cache);
  return [field = std::move(field), cache](const Vec3& p) { return field->sample(p, *cache); };
}

/// Writes a grid to a file and loads it, as users do.
std::shared_ptr<const Volume> load(const openvdb::GridBase::Ptr& grid) {
  const test::TemporaryFolder folder;
  const auto file = folder / "grid.vdb";
  test::writeVdb(file, {grid});
  return loadVolume(file, "");
}

Contest contestOver(const FloatGrid::Ptr& grid) {
  using openvdb::tools::BoxSampler;
  using openvdb::tools::PointSampler;
  using openvdb::tools::QuadraticSampler;
  const std::shared_ptr<const Volume> volume = load(grid);
  const auto mine = [&](Interpolation interpolation) {
    return ours(std::get<0>(makeField(volume, interpolation)));
  };
  constexpr Reads kV = Reads::kValue;
  constexpr Reads kVG = Reads::kValueAndGradient;

  Contest contest;
  contest.active_voxels = grid->activeVoxelCount();
  contest.memory = grid->memUsage();
  auto& all = contest.contenders;
  all.push_back(contender("palpate nearest", kV, mine(Interpolation::kNearest)));
  all.push_back(contender("palpate trilinear", kVG, mine(Interpolation::kTrilinear)));
  all.push_back(contender("palpate quadratic", kVG, mine(Interpolation::kQuadratic)));
  all.push_back(contender("palpate cubic", kVG, mine(Interpolation::kCubic)));
  const auto box = openVdb<BoxSampler, FloatGrid>(grid);
  const auto quadratic = openVdb<QuadraticSampler, FloatGrid>(grid);
  all.push_back(contender("PointSampler", kV, openVdb<PointSampler, FloatGrid>(grid)));
  all.push_back(contender("BoxSampler", kV, box));
  all.push_back(contender("GridSampler", kV, fromWorld(grid, box),
                          "BoxSampler behind the grid's own map from world space"));
  all.push_back(contender("7x BoxSampler", kVG, differencesOf(box),
                          "differences over half a voxel to either side"));
  all.push_back(contender("BoxStencil", kVG, boxStencil(grid), "the cell polynomial's slope"));
  all.push_back(contender("QuadraticSampler", kV, quadratic,
                          "takes the voxel below, not the nearest: one-sided"));
  all.push_back(contender("7x QuadraticSampler", kVG, differencesOf(quadratic),
                          "differences over half a voxel to either side; one-sided"));
#ifdef PALPATE_NANOVDB
  all.push_back(contender("NanoVDB trilinear", kVG, nanoVdb(grid), "keeps the last cell"));
#endif
  return contest;
}

FloatGrid::Ptr makeBall(const Vec3& centre, double radius) {
  openvdb::initialize();
  return openvdb::tools::createLevelSetSphere<FloatGrid>(static_cast<float>(radius),
                                                         openvdb::Vec3f(asVec3d(centre)), 1.0F);
}

}  // namespace

const char* wordFor(Reads reads) noexcept {
  switch (reads) {
    case Reads::kValue:
      return "V";
    case Reads::kValueAndGradient:
      return "V+G";
    case Reads::kValueAndJacobian:
      return "V+J";
  }
  return "";
}

Contender makeNothing() {
  return contender("nothing", Reads::kValue, [](const Vec3& p) { return p.x(); });
}

bool hasNanoVdb() noexcept {
#ifdef PALPATE_NANOVDB
  return true;
#else
  return false;
#endif
}

Contest overBlock(int n, const std::function<double(const Vec3&)>& f) {
  return contestOver(test::makeGrid<FloatGrid>(
      n, openvdb::math::Transform::createLinearTransform(1.0), [&](const Vec3d& p) {
        return static_cast<float>(f({p.x(), p.y(), p.z()}));
      }));
}

Contest overBall(const Vec3& centre, double radius) {
  return contestOver(makeBall(centre, radius));
}

Contest overSpinningBall(const Vec3& centre, double radius) {
  const FloatGrid::Ptr ball = makeBall(centre, radius);
  auto grid = Vec3SGrid::create();
  grid->setName("velocity");
  grid->setTransform(ball->transformPtr());
  grid->setTree(std::make_shared<openvdb::Vec3STree>(ball->tree(), openvdb::Vec3s(0.0F),
                                                     openvdb::TopologyCopy()));
  for (auto it = grid->beginValueOn(); it; ++it) {
    const Vec3d p = it.getCoord().asVec3d() - asVec3d(centre);
    it.setValue(openvdb::Vec3s(Vec3d(-p.y(), p.x(), 0.0) / radius));
  }

  Contest contest;
  contest.active_voxels = grid->activeVoxelCount();
  contest.memory = grid->memUsage();
  contest.contenders.push_back(
      contender("palpate trilinear", Reads::kValueAndJacobian,
                ours(std::get<1>(makeField(load(grid), Interpolation::kTrilinear)))));
  contest.contenders.push_back(
      contender("BoxSampler", Reads::kValue, openVdb<openvdb::tools::BoxSampler, Vec3SGrid>(grid)));
  return contest;
}

}  // namespace palpate::bench
