/// Interfaces of the engine's data sources. A .vdb grid or a formula implements them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <variant>

#include "palpate/engine/field/flow.h"
#include "palpate/engine/field/trace.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A scalar property at one point.
struct ScalarSample {
  double value = 0.0;            ///< V, in the data's unit.
  Vec3 gradient = Vec3::Zero();  ///< Continuous gradient of V, per unit of the data's own space
                                 ///< (not per metre). Its direction is in W.
  bool inside = false;           ///< False where data are not valid: modes add no primitives.
  bool coarse = false;  ///< The value comes from coarser data or from data of another moment,
                        ///< because the right data were missing.
};

/// A vector property at one point, in W.
struct VectorSample {
  Vec3 value = Vec3::Zero();     ///< v, in the data's unit.
  Mat3 jacobian = Mat3::Zero();  ///< J(i, j) = d v_i / d x_j, per unit of the data's space.
  bool inside = false;           ///< False where data are not valid: modes add no primitives.
  bool coarse = false;           ///< Same as ScalarSample::coarse.
};

/// The state at the start of a tick, as passed to a field. Positions are in the resting frame of
/// the field.
struct Attention {
  Vec3 proxy = Vec3::Zero();  ///< Proxy [m].
  Vec3 probe = Vec3::Zero();  ///< Position of the hand [m].
  double dt = 0.0;            ///< Time since the last tick [s].
  double play = 0.0;          ///< Time in the play of sequences [s].
  double rate = 0.0;          ///< Rate of `play` since the last tick [s/s].
};

/// Mutable state that one thread needs to read one field, such as an accessor and the last cell. A
/// Reader owns one FieldCache for each of its fields.
struct alignas(64) FieldCache {
  /// Memory for the field's own data structure. Valid after AnyField::reset().
  std::array<std::byte, 1984> bytes;
};

/// The result of a search along a straight path for the place where a value falls through a level.
struct Crossing {
  bool found = false;  ///< True if the value falls through the level.
  double share = 1.0;  ///< Share of the path up to the fall, 0 to 1; if not found, the share that
                       ///< was searched.
  /// Number of cells searched; for a field without cells, the number of values read.
  int cells = 0;
  bool behind = false;  ///< True if nothing was found because the whole path is below the level.
};

/// Placement of a field in W.
struct FieldFrame {
  double voxel = 1e-3;  ///< Length of a voxel's shortest edge, or of the smallest detail [m].
  double metres_per_unit = 1.0;  ///< Metres of hand travel per unit of the data's own space.
  Box bounds;                    ///< Box of the data [m]. Readings outside of it have no data.
  double background = 0.0;       ///< A scalar's value outside the bounds.
  /// True if the scalar is a signed distance, in units of the field's own space.
  bool distance = false;
  Mat3 reach = Mat3::Zero();  ///< The gradient is a difference over one step to either side along
                              ///< each lattice axis. The columns are these steps [m]; zero if the
                              ///< gradient is not a difference.
};

/// Returns the id of a new field, unique in the process.
[[nodiscard]] std::uint64_t nextFieldId() noexcept;

/// Base class of scalar and vector fields. A field is const and shared between threads. All state
/// that a read changes is in the FieldCache.
class AnyField {
 public:
  /// Makes a field with the placement `frame` and a new id.
  explicit AnyField(const FieldFrame& frame) : frame_(frame), id_(nextFieldId()) {}
  AnyField(const AnyField&) = delete;
  AnyField& operator=(const AnyField&) = delete;
  virtual ~AnyField() = default;

  /// Prepares `cache` for reads of this field. RT: no allocation.
  virtual void reset(FieldCache& cache) const noexcept = 0;
  /// Returns a radius about p_W [m] within which the field is empty: `inside` is false, the value
  /// is the background and the derivatives are zero. Returns 0 if the radius is unknown. RT: no
  /// allocation. Cost: a few ns.
  [[nodiscard]] virtual double freeWithin(const Vec3& /*p_W*/) const noexcept PALPATE_NONBLOCKING {
    return 0.0;
  }

  /// Announces a tick that may read the field with this cache. The loop calls it only if attends()
  /// is true. The positions in `at` let other threads fetch data ahead of the hand. Returns true if
  /// the values differ from those of the last tick and no motion has carried the proxy along. RT:
  /// no allocation, no lock.
  virtual bool attend(const Attention& /*at*/,
                      FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {
    return false;
  }
  /// Announces the end of a tick for which attend() was called. The field is not read with this
  /// cache until attend() announces the next tick. RT: no allocation.
  virtual void leave(FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {}
  /// Returns true if the field needs calls of attend() and leave().
  [[nodiscard]] virtual bool attends() const noexcept { return false; }
  /// Returns true while the source of the field's data is missing (Fault::kVolume). RT: no
  /// allocation.
  [[nodiscard]] virtual bool lost() const noexcept { return false; }

  /// Returns the placement of the field in W. It never changes.
  [[nodiscard]] const FieldFrame& frame() const noexcept { return frame_; }
  [[nodiscard]] std::uint64_t id() const noexcept { return id_; }  ///< Unique in the process.

 private:
  FieldFrame frame_;
  std::uint64_t id_;
};

/// A scalar field in W.
class ScalarField : public AnyField {
 public:
  using AnyField::AnyField;

  /// Returns value and gradient at p_W [m]. If p_W is NaN or far away, `inside` is false. RT: no
  /// allocation, no lock. Cost: tens of ns.
  [[nodiscard]] virtual ScalarSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Returns V at p_W [m] at less cost than sample(). RT: no allocation.
  [[nodiscard]] virtual double value(const Vec3& p_W,
                                     FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).value;
  }
  /// Returns the slope of the interpolated V at p_W. In a trilinear field this is the slope of the
  /// cell's polynomial. It jumps at the faces of cells, and `gradient` does not. Cheap after
  /// sample() at the same place.
  [[nodiscard]] virtual Vec3 cellGradient(const Vec3& p_W,
                                          FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).gradient;
  }
  /// Returns the Jacobian of `gradient`, d gradient_i / d p_j [its unit / m], both in W. Cheap
  /// after sample() at the same place. The default takes differences of six samples. RT: no
  /// allocation.
  [[nodiscard]] virtual Mat3 gradientJacobian(const Vec3& p_W,
                                              FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
  /// Finds the first place on the path from a_W to b_W [m] where h = sign (V - level) falls below
  /// zero, within the data. There a proxy from the free side touches the surface. If h <= 0 at
  /// a_W, the crossing is at a_W if h falls there, otherwise where h falls below zero after h was
  /// above zero. The default reads a value every half voxel; a grid searches exactly. The search
  /// covers at most 128 voxels (in a grid 256 cells). An end that is not finite gives no result.
  /// RT: no allocation. Cost: a sample every half voxel; in a grid, some 50 ns for each cell except
  /// the one read last.
  [[nodiscard]] virtual Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level,
                                           double sign,
                                           FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A vector field in W.
class VectorField : public AnyField {
 public:
  using AnyField::AnyField;

  /// Returns value and Jacobian at p_W [m]. If p_W is NaN or far away, `inside` is false. RT: no
  /// allocation, no lock. Cost: tens of ns.
  [[nodiscard]] virtual VectorSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Traces the stream through p_W [m]; see trace.h. The default treats the field as one smooth
  /// piece; a grid traces cell by cell. RT: no allocation. Cost: one value of v, and four for each
  /// step. Rejected steps count.
  [[nodiscard]] virtual Trace trace(const Vec3& p_W, const TraceOrder& order,
                                    FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A scalar or vector field, as scenes refer to it.
using FieldPtr =
    std::variant<std::shared_ptr<const ScalarField>, std::shared_ptr<const VectorField>>;

}  // namespace palpate
