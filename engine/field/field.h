/// Sources of values: the interfaces that a .vdb grid or a formula implements.
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
                                 ///< (not per metre), its direction turned into W.
  bool inside = false;           ///< False where data are not valid: modes add no primitives.
  bool coarse = false;  ///< Read from data coarser than the volume's, or from data of another
                        ///< moment, because the right data were missing.
};

/// A vector property at one point. Components and derivatives are turned into W together.
struct VectorSample {
  Vec3 value = Vec3::Zero();     ///< v, in the data's unit.
  Mat3 jacobian = Mat3::Zero();  ///< J(i, j) = d v_i / d x_j, per unit of the data's space.
  bool inside = false;           ///< False where data are not valid: modes add no primitives.
  bool coarse = false;           ///< Same as ScalarSample::coarse.
};

/// State of a tick at its begin, for a field; places are in the frame where the field rests.
struct Attention {
  Vec3 proxy = Vec3::Zero();  ///< Proxy [m].
  Vec3 probe = Vec3::Zero();  ///< The hand [m].
  double dt = 0.0;            ///< Time since the last tick [s].
  double play = 0.0;          ///< Time in the play of sequences [s].
  double rate = 0.0;          ///< Rate of `play` since the last tick [s/s].
};

/// Mutable state of one thread's reads of one field: accessor and last cell. Plain bytes, laid out
/// by the field; a Reader owns one for every field.
struct alignas(64) FieldCache {
  std::array<std::byte, 1984> bytes;  ///< Laid out by the field; valid after its reset().
};

/// Place on a straight path where a value first falls through a level.
struct Crossing {
  bool found = false;   ///< The value falls through the level, at `share`.
  double share = 1.0;   ///< Share of the path up to the fall, 0 to 1; not found: share searched.
  int cells = 0;        ///< Cells searched; of a field without cells, values read.
  bool behind = false;  ///< Not found because all of the path is below the level.
};

/// Placement of a field in W.
struct FieldFrame {
  double voxel = 1e-3;           ///< Size of the smallest detail, a voxel's shortest edge [m].
  double metres_per_unit = 1.0;  ///< Metres of hand travel per unit of the data's own space.
  Box bounds;                    ///< Box of the data [m]; no readings outside.
  double background = 0.0;       ///< A scalar's value outside the bounds.
  bool distance = false;         ///< The scalar is a signed distance, in units of the field's own
                                 ///< space.
  Mat3 reach = Mat3::Zero();     ///< Columns: the step to either side, along each axis of the
                                 ///< lattice, of the differences in a scalar's `gradient` [m]. Zero
                                 ///< if the gradient is not a difference.
};

/// Returns the id of a new field, unique in the process.
[[nodiscard]] std::uint64_t nextFieldId() noexcept;

/// Base of fields of both kinds. Const and shared between threads; the cache holds all that a read
/// changes.
class AnyField {
 public:
  /// Makes a field placed in W by `frame`, with an id of its own.
  explicit AnyField(const FieldFrame& frame) : frame_(frame), id_(nextFieldId()) {}
  AnyField(const AnyField&) = delete;
  AnyField& operator=(const AnyField&) = delete;
  virtual ~AnyField() = default;

  /// Makes `cache` ready for this field. RT: no allocation.
  virtual void reset(FieldCache& cache) const noexcept = 0;
  /// Returns a radius about p_W [m] within which the field is empty: inside is false, the value the
  /// background, the derivatives zero. 0: not known. RT: no allocation. Cost: a few ns.
  [[nodiscard]] virtual double freeWithin(const Vec3& /*p_W*/) const noexcept PALPATE_NONBLOCKING {
    return 0.0;
  }

  /// Called before a tick that may read the field with this cache, if attends(). States where the
  /// hand goes, so that other threads fetch data ahead of it. Returns true if the values differ
  /// from the last tick's and no motion has carried the proxy along. RT: no allocation, no lock.
  virtual bool attend(const Attention& /*at*/,
                      FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {
    return false;
  }
  /// Called at the end of each of these ticks: until the next tick there is no reading with this
  /// cache. RT.
  virtual void leave(FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {}
  /// Returns true if the field needs attend() and leave().
  [[nodiscard]] virtual bool attends() const noexcept { return false; }
  /// Returns true while the source of the field's data is missing (Fault::kVolume). RT.
  [[nodiscard]] virtual bool lost() const noexcept { return false; }

  /// Returns the placement of the field in W, fixed when it was made.
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

  /// Returns value and gradient at p_W [m]; NaN and far-away positions give `inside` false. RT: no
  /// allocation, no lock. Cost: tens of ns.
  [[nodiscard]] virtual ScalarSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Returns V at p_W [m]; cheaper than sample(). RT: no allocation.
  [[nodiscard]] virtual double value(const Vec3& p_W,
                                     FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).value;
  }
  /// Returns the slope of V as interpolated at p_W. If that differs from `gradient`, it is the
  /// slope of the trilinear polynomial itself, which jumps at the faces of cells. Cheap after
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
  /// Finds where sign (V - level) first falls below zero on the path from a_W to b_W [m], within
  /// the data: the contact of a proxy that comes from the free side. A path that begins at or below
  /// zero crosses at once if the value falls at first, else at the fall after its rise. The default
  /// reads every half voxel; a grid's own search is exact. There is no search if an end is not
  /// finite, nor beyond 128 voxels (a grid: 256 cells). RT: no allocation. Cost: a sample every
  /// half voxel; of a grid, some 50 ns for each cell that is not the last one read.
  [[nodiscard]] virtual Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level,
                                           double sign,
                                           FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A vector field in W.
class VectorField : public AnyField {
 public:
  using AnyField::AnyField;

  /// Returns value and Jacobian at p_W [m]; NaN and far-away positions give `inside` false. RT: no
  /// allocation, no lock. Cost: tens of ns.
  [[nodiscard]] virtual VectorSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Traces the stream through p_W [m]; see trace.h. The default treats the field as one smooth
  /// piece; a grid's own trace goes cell by cell. RT: no allocation. Cost: four values of v a step
  /// and one more; rejected steps count.
  [[nodiscard]] virtual Trace trace(const Vec3& p_W, const TraceOrder& order,
                                    FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A field of either kind, as scenes refer to it.
using FieldPtr =
    std::variant<std::shared_ptr<const ScalarField>, std::shared_ptr<const VectorField>>;

}  // namespace palpate
