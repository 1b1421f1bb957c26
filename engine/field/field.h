/// Interfaces of the engine's data sources, such as a .vdb grid or a formula.
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
  double value = 0.0;  ///< Value V, in the data's unit.
  /// Continuous gradient of V in W, per unit of the data's space.
  Vec3 gradient = Vec3::Zero();
  bool inside = false;  ///< True if the data are valid here.
  bool coarse = false;  ///< True if coarser data, or data of another time, replaced missing data.
};

/// A vector property at one point, in W.
struct VectorSample {
  Vec3 value = Vec3::Zero();     ///< Value v, in the data's unit.
  Mat3 jacobian = Mat3::Zero();  ///< J(i, j) = d v_i / d x_j, per unit of the data's space.
  bool inside = false;           ///< True if the data are valid here.
  bool coarse = false;           ///< Same as ScalarSample::coarse.
};

/// The state at the start of a tick. Positions are in the resting frame of the field.
struct Attention {
  Vec3 proxy = Vec3::Zero();  ///< Position of the proxy [m].
  Vec3 probe = Vec3::Zero();  ///< Position of the hand [m].
  double dt = 0.0;            ///< Time since the last tick [s].
  double play = 0.0;          ///< Play position of sequences [s].
  double rate = 0.0;          ///< Seconds of play per second since the last tick.
};

/// Mutable state with which one thread reads one field, such as the last cell. In ticks, a Reader
/// owns it.
struct alignas(64) FieldCache {
  /// Memory for the field's data. Valid after AnyField::reset().
  std::array<std::byte, 1984> bytes;
};

/// Result of ScalarField::firstFall.
struct Crossing {
  bool found = false;  ///< True if firstFall() found the point.
  double share =
      1.0;  ///< Position of the point on the path, 0 to 1; if not found, the searched share.
  /// Number of cells searched; for a field without cells, the number of values read.
  int cells = 0;
  /// True if h (see firstFall) is nowhere above zero on the searched path, and below zero at its
  /// end.
  bool behind = false;
};

/// Placement of a field in W.
struct FieldFrame {
  double voxel = 1e-3;  ///< Length of a voxel's shortest edge, or of the smallest detail [m].
  double metres_per_unit = 1.0;  ///< Metres of hand travel per unit of the data's space.
  Box bounds;                    ///< Box of the data [m]. Readings outside of it have no data.
  double background = 0.0;       ///< A scalar's value outside the bounds.
  /// True if the scalar is a signed distance, in units of the data's space.
  bool distance = false;
  /// Columns: steps [m] over which the gradient is a central difference, along the axes of the
  /// lattice. Zero if the gradient is not a difference.
  Mat3 reach = Mat3::Zero();
};

/// Returns the id of a new field, unique in the process.
[[nodiscard]] std::uint64_t nextFieldId() noexcept;

/// A field is const and shared between threads. A FieldCache holds all state that a read changes.
class AnyField {
 public:
  /// Makes a field with a new id.
  explicit AnyField(const FieldFrame& frame) : frame_(frame), id_(nextFieldId()) {}
  AnyField(const AnyField&) = delete;
  AnyField& operator=(const AnyField&) = delete;
  virtual ~AnyField() = default;

  /// Prepares `cache` for reads of this field. RT: no allocation.
  virtual void reset(FieldCache& cache) const noexcept = 0;
  /// Returns a radius about p_W [m] within which the field is empty (no data, background value,
  /// zero derivatives); 0 if unknown. RT: no allocation. Cost: less than that of sample().
  [[nodiscard]] virtual double freeWithin(const Vec3& /*p_W*/) const noexcept PALPATE_NONBLOCKING {
    return 0.0;
  }

  /// Announces a tick that may read the field with this cache. The loop calls it only if attends()
  /// is true. The positions in `at` let other threads fetch data ahead of the hand. Returns true if
  /// the values have changed since the last tick, other than by a motion that carries the proxy
  /// along. RT: no allocation, no lock; a field that is set to wait for its data is not for RT.
  virtual bool attend(const Attention& /*at*/,
                      FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {
    return false;
  }
  /// Announces the end of a tick for which attend() was called. The field is not read with this
  /// cache until the next attend(). RT: no allocation.
  virtual void leave(FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {}
  /// Returns true if the field needs calls of attend() and leave().
  [[nodiscard]] virtual bool attends() const noexcept { return false; }
  /// Returns true while the source of the data is missing (Fault::kVolume). RT: no allocation.
  [[nodiscard]] virtual bool lost() const noexcept { return false; }

  /// Returns the placement of the field in W, which never changes.
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

  /// Returns value and gradient at p_W [m]. If p_W is not finite or outside of the data, `inside`
  /// is false. RT: no allocation, no lock.
  [[nodiscard]] virtual ScalarSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Returns V at p_W [m]. The default calls sample(); a trilinear grid reads only the value. RT:
  /// no allocation.
  [[nodiscard]] virtual double value(const Vec3& p_W,
                                     FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).value;
  }
  /// Returns the slope of the interpolated V at p_W [m], in W, per unit of the data's space. In a
  /// trilinear field, this is the slope of the cell's polynomial, which jumps at faces. The default
  /// returns the gradient of sample(). RT: no allocation.
  [[nodiscard]] virtual Vec3 cellGradient(const Vec3& p_W,
                                          FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).gradient;
  }
  /// Returns the Jacobian of `gradient` at p_W [m], d gradient_i / d p_j [its unit / m], both in W.
  /// The default takes six samples. RT: no allocation.
  [[nodiscard]] virtual Mat3 gradientJacobian(const Vec3& p_W,
                                              FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
  /// Finds the first point on the path from a_W to b_W [m] where h = sign (V - level) falls below
  /// zero. Without data, h counts as above zero. A proxy that comes from h > 0 touches the surface
  /// there. If h <= 0 at a_W, the crossing is at a_W if h falls there, otherwise where h falls
  /// below zero after h was above zero. The default samples h every half voxel, over at most 128
  /// voxels, and can miss a fall between two samples. A trilinear grid searches the polynomials of
  /// its cells, at most 256 cells. If an end is not finite, `found` is false. RT: no allocation.
  /// Cost: the default takes a sample every half voxel, and 40 to refine a crossing; a grid,
  /// O(cells).
  [[nodiscard]] virtual Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level,
                                           double sign,
                                           FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A vector field in W.
class VectorField : public AnyField {
 public:
  using AnyField::AnyField;

  /// Returns value and Jacobian at p_W [m]. If p_W is not finite or outside of the data, `inside`
  /// is false. RT: no allocation, no lock.
  [[nodiscard]] virtual VectorSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Traces the stream through p_W [m] (trace.h). The default assumes a smooth field; a grid traces
  /// cell by cell. RT: no allocation. Cost: see traceCells (trace_cells.h).
  [[nodiscard]] virtual Trace trace(const Vec3& p_W, const TraceOrder& order,
                                    FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A scalar or vector field, as scenes refer to it.
using FieldPtr =
    std::variant<std::shared_ptr<const ScalarField>, std::shared_ptr<const VectorField>>;

}  // namespace palpate
