/// Private to samplers, for .cpp files only: fields over OpenVDB grids, for each type and kernel.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <new>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include <openvdb/tree/ValueAccessor.h>

#include "palpate/samplers/grid/cell.h"
#include "palpate/samplers/grid/lattice_reader.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/spline.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate::detail {

using openvdb::Coord;

template <class Value>
double componentOf(const Value& value, int c) noexcept {
  if constexpr (std::is_arithmetic_v<Value>) {
    return static_cast<double>(value);
  } else {
    return static_cast<double>(value[c]);
  }
}

/// A leaf or a tile, as rows of eight voxels along the last axis. A tile has one row.
template <class Value>
class LeafOrTile {
 public:
  template <class Accessor>
  [[gnu::always_inline]] void find(Accessor& accessor, const Coord& voxel) noexcept {
    if (const auto* leaf = accessor.probeConstLeaf(voxel)) {
      values_ = &leaf->buffer()[0];
      active_ = reinterpret_cast<const unsigned char*>(&leaf->valueMask());
      last_row_ = 63;
    } else {
      Value value;
      tile_active_ = accessor.probeValue(voxel, value) ? 0xff : 0;
      tile_.fill(value);
      values_ = tile_.data();
      active_ = &tile_active_;
      last_row_ = 0;
    }
  }
  [[nodiscard]] const Value* row(std::size_t n) const noexcept {
    return values_ + (n & last_row_) * 8;
  }
  /// Returns one bit for each voxel of row n, set if the voxel is active.
  [[nodiscard]] std::uint64_t active(std::size_t n) const noexcept {
    return active_[n & last_row_];
  }

 private:
  const Value* values_;
  const unsigned char* active_;
  std::size_t last_row_;
  std::array<Value, 8> tile_;
  unsigned char tile_active_;
};

/// A block of W^3 voxels. Rows that lie in two leaves are copied; all others are read in place. If
/// Edges is false, omits rows at the rim along two axes.
///
/// Along each axis the block lies in one leaf or in two. The code has few branches on this, because
/// the processor cannot predict them. It finds all leaves before it reads them, so that the memory
/// accesses overlap if the cache is cold.
template <class Value, int W, bool Edges>
class LeafBlock {
 public:
  using Number = typename openvdb::VecTraits<Value>::ElementType;

  template <class Accessor>
  [[gnu::always_inline]] LeafBlock(Accessor& accessor, const Coord& low) noexcept
      : x_(low[0] & 7), y_(low[1] & 7), z_(low[2] & 7), two_((z_ + kW - 1) / 8) {
    // Index of the last leaf: a bit for each axis, set if the block extends into a second leaf.
    const std::size_t last = (x_ + kW - 1) / 8 * 4 + (y_ + kW - 1) / 8 * 2 + two_;
    for (std::size_t n = last;; n = (n - 1) & last) {
      const auto end = [n](std::size_t axis) { return (n & axis) != 0 ? W - 1 : 0; };
      leaves_[n].find(accessor, low.offsetBy(end(4), end(2), end(1)));
      if (n == 0) break;
    }
    forRows([&](std::size_t i, std::size_t j) __attribute__((always_inline)) {
      if (!Edges && atRim(i) && atRim(j)) return;
      const std::size_t n = leafOf(i, j);
      const Value* row = leaves_[n].row(rowOf(i, j)) + z_;
      if (two_ != 0) {
        // The row lies in two leaves. Copies both parts into one array.
        Value* joined = joined_[i * kW + j].data();
        std::copy_n(row - z_ + 8 - kW, kW, joined);
        std::copy_n(leaves_[n + 1].row(rowOf(i, j)), kW, joined + kW);
        row = joined + z_ - (8 - kW);
      }
      rows_.first[i * kW + j] = reinterpret_cast<const Number*>(row);
    });
  }
  LeafBlock(const LeafBlock&) = delete;  // rows_ may point into this object
  LeafBlock& operator=(const LeafBlock&) = delete;

  [[nodiscard]] const Rows<Number, W>& rows() const noexcept { return rows_; }

  /// Returns the active states of the rows that can have corners: if W is 4, the inner two rows
  /// along each of the first two axes, else all rows.
  [[nodiscard, gnu::always_inline]] std::uint64_t active() const noexcept {
    std::uint64_t bits = 0;
    forRows([&](std::size_t i, std::size_t j) __attribute__((always_inline)) {
      if (W == 4 && (atRim(i) || atRim(j))) return;
      bits |= activeRow(i, j);
    });
    return bits;
  }
  /// Returns the active states of all voxels, without the omitted rows if Edges is false.
  [[nodiscard]] std::uint64_t allActive() const noexcept {
    std::uint64_t bits = 0;
    forRows([&](std::size_t i, std::size_t j) {
      if (Edges || !atRim(i) || !atRim(j)) bits |= activeRow(i, j);
    });
    return bits;
  }

 private:
  static constexpr std::size_t kW = W;
  /// Returns the active states of a row's voxels, as bits of the block's mask.
  [[nodiscard, gnu::always_inline]] std::uint64_t activeRow(std::size_t i,
                                                            std::size_t j) const noexcept {
    const std::size_t n = leafOf(i, j);
    const std::size_t row = rowOf(i, j);
    const std::uint64_t here = leaves_[n].active(row) | leaves_[n + two_].active(row) << 8;
    return (here >> z_ & ((1U << W) - 1)) << (i * kW + j) * kW;
  }
  /// Calls f(i, j) for each row, unrolled, because a loop is slower.
  template <class F>
  [[gnu::always_inline]] static void forRows(F f) noexcept {
    [&]<std::size_t... N>(std::index_sequence<N...> /*rows*/) __attribute__((always_inline)) {
      (f(N / kW, N % kW), ...);
    }
    (std::make_index_sequence<kW * kW>());
  }
  static constexpr bool atRim(std::size_t i) noexcept { return W > 1 && i * (kW - 1 - i) == 0; }
  /// Returns the first leaf that contains row (i, j). rowOf() returns the row in that leaf.
  [[nodiscard]] std::size_t leafOf(std::size_t i, std::size_t j) const noexcept {
    return (x_ + i) / 8 * 4 + (y_ + j) / 8 * 2;
  }
  [[nodiscard]] std::size_t rowOf(std::size_t i, std::size_t j) const noexcept {
    return (x_ + i) % 8 * 8 + (y_ + j) % 8;
  }

  std::size_t x_;  ///< Lowest corner of the block, relative to the leaf that contains it.
  std::size_t y_;
  std::size_t z_;
  std::size_t two_;  ///< 1 if each row lies in two leaves, else 0.
  std::array<LeafOrTile<Value>, 8> leaves_;
  std::array<std::array<Value, 2 * kW>, kW * kW> joined_;
  Rows<Number, W> rows_;
};

FieldFrame frameOf(const Volume& volume, const Placement& placement, const Sampling& sampling);

/// Returns the free map of a part for an interpolation. The first call makes it.
std::shared_ptr<const FreeMap> freeMapOf(const Volume& volume, std::size_t part,
                                         Interpolation interpolation, const GridData& data);

template <class GridT>
class GridSource {
  using Accessor = openvdb::tree::ValueAccessor<const typename GridT::TreeType, false>;

 public:
  struct Cache {
    Accessor accessor;
  };
  template <int W, bool Edges>
  class Block : public LeafBlock<typename GridT::ValueType, W, Edges> {
   public:
    [[gnu::always_inline]] Block(const GridSource& /*of*/, Cache& cache,
                                 const std::array<int, 3>& low) noexcept
        : LeafBlock<typename GridT::ValueType, W, Edges>(cache.accessor,
                                                         Coord(low[0], low[1], low[2])) {}
  };

  GridSource(const Volume& volume, std::size_t part, Interpolation interpolation)
      : grid_(std::get<typename GridT::ConstPtr>(gridFor(volume, part, interpolation))),
        ends_(volume.grid().parts[part].ends) {}

  [[nodiscard]] Cache cache() const noexcept { return {Accessor(grid_->tree())}; }
  [[nodiscard]] double background(int c) const noexcept {
    return componentOf(grid_->background(), c);
  }
  [[nodiscard]] const DataEnds& ends() const noexcept { return ends_; }
  [[nodiscard]] GridData data() const { return grid_; }

 private:
  static const GridData& gridFor(const Volume& volume, std::size_t part,
                                 Interpolation interpolation) {
    if (interpolation == Interpolation::kQuadratic) return splineCoefficients(volume, 2)[part];
    if (interpolation == Interpolation::kCubic) return splineCoefficients(volume, 3)[part];
    return volume.grid().parts[part].data;
  }

  typename GridT::ConstPtr grid_;
  DataEnds ends_;
};

template <class GridT, class Kernel>
class GridReader : public LatticeReader<GridSource<GridT>, Kernel> {
  using Base = LatticeReader<GridSource<GridT>, Kernel>;

 public:
  GridReader(const Volume& volume, std::size_t part, const Placement& placement,
             const Sampling& sampling)
      : GridReader(GridSource<GridT>(volume, part, sampling.interpolation), volume, part, placement,
                   sampling) {}

 private:
  GridReader(const GridSource<GridT>& source, const Volume& volume, std::size_t part,
             const Placement& placement, const Sampling& sampling)
      : Base(
            source,
            IndexMap(volume.grid().parts[part].linear, volume.grid().parts[part].origin, placement),
            freeMapOf(volume, part, sampling.interpolation, source.data()),
            volume.info().grid_class == GridClass::kLevelSet, sampling.axial,
            sampling.slope_reach) {}
};

template <class Base, class GridT, class Kernel, std::size_t N>
class GridField : public Base {
  using Reader = GridReader<GridT, Kernel>;
  using Caches = std::array<typename Reader::Cache, N>;
  static_assert(sizeof(Caches) <= sizeof(FieldCache::bytes));

 public:
  GridField(std::shared_ptr<const Volume> volume, const Placement& placement,
            const Sampling& sampling)
      : GridField(std::move(volume), placement, sampling, std::make_index_sequence<N>()) {}

  [[nodiscard]] double freeWithin(const Vec3& p_W) const noexcept final {
    return std::apply([&](const auto&... reader) { return std::min({reader.freeWithin(p_W)...}); },
                      readers_);
  }

  void reset(FieldCache& memory) const noexcept final {
    std::apply(
        [&](const auto&... reader) { ::new (memory.bytes.data()) Caches{reader.cache()...}; },
        readers_);
  }

 protected:
  using Row = typename Reader::Row;

  static Caches& cachesIn(FieldCache& memory) noexcept {
    return *std::launder(reinterpret_cast<Caches*>(memory.bytes.data()));
  }
  [[nodiscard]] const std::array<Reader, N>& readers() const noexcept { return readers_; }

 private:
  template <std::size_t... Part>
  GridField(std::shared_ptr<const Volume> volume, const Placement& placement,
            const Sampling& sampling, std::index_sequence<Part...> /*parts*/)
      : Base(frameOf(*volume, placement, sampling)),
        volume_(std::move(volume)),
        readers_{Reader(*volume_, Part, placement, sampling)...} {}

  std::shared_ptr<const Volume> volume_;
  std::array<Reader, N> readers_;
};

template <class GridT, class Kernel>
class VdbScalarField final : public GridField<ScalarField, GridT, Kernel, 1> {
  using Base = GridField<ScalarField, GridT, Kernel, 1>;

 public:
  using Base::Base;

  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    typename Base::Row row;
    const bool inside = this->readers()[0].read(p_W, Base::cachesIn(memory)[0], row);
    return {row[0], Vec3(row[1], row[2], row[3]), inside};
  }

  [[nodiscard]] double value(const Vec3& p_W, FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      return this->readers()[0].value(p_W, Base::cachesIn(memory)[0]);
    } else {
      return sample(p_W, memory).value;
    }
  }

  [[nodiscard]] Vec3 cellGradient(const Vec3& p_W, FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      return this->readers()[0].slope(p_W, Base::cachesIn(memory)[0]);
    } else {
      return sample(p_W, memory).gradient;
    }
  }

  [[nodiscard]] Mat3 gradientJacobian(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return this->readers()[0].turning(p_W, Base::cachesIn(memory)[0]);
  }

  [[nodiscard]] Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                   FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
      return this->readers()[0].firstFall(a_W, b_W, level, sign, Base::cachesIn(memory)[0]);
    } else {
      return ScalarField::firstFall(a_W, b_W, level, sign, memory);
    }
  }
};

template <class GridT, class Kernel>
class VdbVectorField final : public GridField<VectorField, GridT, Kernel, 1> {
  using Base = GridField<VectorField, GridT, Kernel, 1>;

 public:
  using Base::Base;

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    VectorSample out;
    typename Base::Row row;
    out.inside = this->readers()[0].read(p_W, Base::cachesIn(memory)[0], row);
    out.value = Vec3(row[0], row[1], row[2]);
    std::copy_n(row.begin() + 3, 9, out.jacobian.data());
    return out;
  }

  [[nodiscard]] Trace trace(const Vec3& p_W, const TraceOrder& order,
                            FieldCache& memory) const noexcept override {
    if constexpr (std::is_same_v<Kernel, TrilinearKernel<3>>) {
      return this->readers()[0].trace(p_W, order, this->frame().voxel, Base::cachesIn(memory)[0]);
    } else {
      return VectorField::trace(p_W, order, memory);
    }
  }
};

template <class GridT, class Kernel>
class ComponentField final : public GridField<VectorField, GridT, Kernel, 3> {
  using Base = GridField<VectorField, GridT, Kernel, 3>;

 public:
  ComponentField(std::shared_ptr<const Volume> volume, const Placement& placement,
                 const Sampling& sampling)
      : Base(std::move(volume), placement, sampling), rotation_(placement.rotation) {}

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    auto& caches = Base::cachesIn(memory);
    VectorSample out;
    out.inside = true;
    Vec3 v;
    Mat3 J;
    for (std::size_t c = 0; c < 3; ++c) {
      typename Base::Row row;
      const bool inside = this->readers()[c].read(p_W, caches[c], row);
      const auto r = static_cast<Eigen::Index>(c);
      v[r] = row[0];
      if constexpr (std::is_same_v<Kernel, TrilinearKernel<1>>) {
        // Where the difference would read beyond the box of active voxels, takes the derivative at
        // the nearest place where it does not. A weight lets the derivative fall to 0 within one
        // voxel beyond the box.
        Vec3 q_W = p_W;
        const double weight = this->readers()[c].towardData(q_W);
        if (q_W != p_W) {
          (void)this->readers()[c].read(q_W, caches[c], row);
          for (std::size_t a = 1; a < 4; ++a) row[a] *= weight;
        }
      }
      for (Eigen::Index a = 0; a < 3; ++a) J(r, a) = row[static_cast<std::size_t>(a) + 1];
      out.inside = out.inside && inside;
    }
    out.value = times(rotation_, v);
    for (Eigen::Index a = 0; a < 3; ++a) out.jacobian.col(a) = times(rotation_, Vec3(J.col(a)));
    return out;
  }

 private:
  Mat3 rotation_;
};

template <class GridT, template <class, class> class Field, int C>
auto withKernel(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                const Sampling& sampling)
    -> std::conditional_t<std::is_base_of_v<ScalarField, Field<GridT, TrilinearKernel<C>>>,
                          std::shared_ptr<const ScalarField>, std::shared_ptr<const VectorField>> {
  switch (sampling.interpolation) {
    case Interpolation::kTrilinear:
      break;
    case Interpolation::kNearest:
      return std::make_shared<const Field<GridT, NearestKernel<C>>>(volume, placement, sampling);
    case Interpolation::kQuadratic:
      return std::make_shared<const Field<GridT, SplineKernel<C, 2>>>(volume, placement, sampling);
    case Interpolation::kCubic:
      return std::make_shared<const Field<GridT, SplineKernel<C, 3>>>(volume, placement, sampling);
  }
  return std::make_shared<const Field<GridT, TrilinearKernel<C>>>(volume, placement, sampling);
}

/// Makes a field over a volume with a first part of type GridT.
template <class GridT>
FieldPtr makeField(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                   const Sampling& sampling) {
  if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
    if (volume->grid().parts.size() == 3) {
      return withKernel<GridT, ComponentField, 1>(volume, placement, sampling);
    }
    return withKernel<GridT, VdbScalarField, 1>(volume, placement, sampling);
  } else {
    return withKernel<GridT, VdbVectorField, 3>(volume, placement, sampling);
  }
}

// The instances are in field_float.cpp, field_double.cpp, field_vec3s.cpp and field_vec3d.cpp.
extern template FieldPtr makeField<openvdb::FloatGrid>(const std::shared_ptr<const Volume>&,
                                                       const Placement&, const Sampling&);
extern template FieldPtr makeField<openvdb::DoubleGrid>(const std::shared_ptr<const Volume>&,
                                                        const Placement&, const Sampling&);
extern template FieldPtr makeField<openvdb::Vec3SGrid>(const std::shared_ptr<const Volume>&,
                                                       const Placement&, const Sampling&);
extern template FieldPtr makeField<openvdb::Vec3DGrid>(const std::shared_ptr<const Volume>&,
                                                       const Placement&, const Sampling&);

}  // namespace palpate::detail
