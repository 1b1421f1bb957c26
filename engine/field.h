/// Where values come from: the interfaces that a .vdb grid or a formula implements.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <variant>

#include "palpate/engine/flow.h"
#include "palpate/engine/trace.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A scalar property at one point.
struct ScalarSample {
  double value = 0.0;            ///< V, in the data's unit.
  Vec3 gradient = Vec3::Zero();  ///< Continuous gradient of V, per unit of the data's own space
                                 ///< (not per metre), its direction turned into W.
  bool inside = false;           ///< False where the data mean nothing: modes stay silent.
  bool coarse = false;  ///< Read of data coarser than the volume's, or of another moment's,
                        ///< for want of these.
};

/// A vector property at one point. Components and derivatives are turned into W together.
struct VectorSample {
  Vec3 value = Vec3::Zero();     ///< v, in the data's unit.
  Mat3 jacobian = Mat3::Zero();  ///< J(i, j) = d v_i / d x_j, per unit of the data's space.
  bool inside = false;           ///< False where the data mean nothing: modes stay silent.
  bool coarse = false;           ///< As ScalarSample::coarse.
};

/// What a field is told at the begin of a tick, where it rests.
struct Attention {
  Vec3 proxy = Vec3::Zero();  ///< [m]
  Vec3 probe = Vec3::Zero();  ///< The hand [m].
  double dt = 0.0;            ///< Since the tick before [s].
  double play = 0.0;          ///< Where sequences are in their play [s],
  double rate = 0.0;          ///< and how fast that has gone on since the tick before [s/s].
};

/// The memory that one thread's reads of one field change: accessor and last cell. Plain bytes that
/// the field lays out as it likes; a Reader owns one for every field.
struct alignas(64) FieldCache {
  std::array<std::byte, 1984> bytes;  ///< Laid out by the field; valid after its reset().
};

/// Where a value first falls through a level on a straight path.
struct Crossing {
  bool found = false;   ///< The value falls through the level, at `share`.
  double share = 1.0;   ///< Share of the path up to it, 0 to 1; not found: share looked at.
  int cells = 0;        ///< Cells looked at; of a field without cells, values read.
  bool behind = false;  ///< Not found because all of the path is below the level.
};

/// How a field lies in the hand's world.
struct FieldFrame {
  double voxel = 1e-3;           ///< Size of the smallest detail, a voxel's shortest edge [m].
  double metres_per_unit = 1.0;  ///< Metres of hand travel per unit of the data's own space.
  Box bounds;                    ///< Outside them there is no data, and nothing is read [m].
  double background = 0.0;       ///< A scalar's value outside the bounds.
};

/// A new field's identity; no two fields of a process have the same.
[[nodiscard]] std::uint64_t nextFieldId() noexcept;

/// What fields of both kinds are: const and shared between threads; what a read changes is in the
/// cache.
class AnyField {
 public:
  /// A field that lies in W as `frame` says, with an id of its own.
  explicit AnyField(const FieldFrame& frame) : frame_(frame), id_(nextFieldId()) {}
  AnyField(const AnyField&) = delete;
  AnyField& operator=(const AnyField&) = delete;
  virtual ~AnyField() = default;

  /// Makes `cache` ready for this field. RT: no allocation.
  virtual void reset(FieldCache& cache) const noexcept = 0;
  /// A radius about p_W [m] within which there is nothing: inside is false, the value the
  /// background, the derivatives zero. 0: nothing is known. RT: no allocation. Cost: a few
  /// ns.
  [[nodiscard]] virtual double freeWithin(const Vec3& /*p_W*/) const noexcept PALPATE_NONBLOCKING {
    return 0.0;
  }

  /// Told at the begin of each tick that may read the field with this cache, if attends(): what is
  /// fetched from afar is fetched ahead of the hand. True: what it reads like is not what it was in
  /// the tick before, and nothing has carried the proxy along. RT: no allocation, no lock.
  virtual bool attend(const Attention& /*at*/,
                      FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {
    return false;
  }
  /// Told at the end of each such tick: until the next one nothing is read with this cache. RT.
  virtual void leave(FieldCache& /*cache*/) const noexcept PALPATE_NONBLOCKING {}
  /// True for a field that wants to be told.
  [[nodiscard]] virtual bool attends() const noexcept { return false; }
  /// True while what such a field is fetched from is not there any more (Fault::kVolume). RT.
  [[nodiscard]] virtual bool lost() const noexcept { return false; }

  /// How the field lies in W: as it was made, for good.
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

  /// Value and gradient at p_W [m]; NaN and far-away positions give `inside` false.
  /// RT: no allocation, no lock. Cost: tens of ns.
  [[nodiscard]] virtual ScalarSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// V at p_W [m]: sample() without its gradient, for less. RT: no allocation.
  [[nodiscard]] virtual double value(const Vec3& p_W,
                                     FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).value;
  }
  /// The slope of V as interpolated at p_W, where that differs from `gradient`: of the trilinear
  /// polynomial itself, which jumps at the faces of cells. Cheap after sample() at the same place.
  [[nodiscard]] virtual Vec3 cellGradient(const Vec3& p_W,
                                          FieldCache& cache) const noexcept PALPATE_NONBLOCKING {
    return sample(p_W, cache).gradient;
  }
  /// The Jacobian of `gradient`, d gradient_i / d p_j [its unit / m], both in W. Cheap after
  /// sample() at the same place. The default takes differences of six samples. RT: no allocation.
  [[nodiscard]] virtual Mat3 gradientJacobian(const Vec3& p_W,
                                              FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
  /// Where on the path from a_W to b_W [m] sign (V - level) first falls below zero, where there are
  /// data: the contact of a proxy that comes from the free side. A path that begins at or below
  /// zero crosses at once where it falls at first, else at the fall after its rise. The default
  /// looks every half voxel; a grid's own is exact. Nothing is looked at where an end is not
  /// finite, nor beyond 128 voxels (a grid's: 256 cells). RT: no allocation. Cost: a sample every
  /// half voxel; a grid's, some 50 ns a cell that is not the last one read.
  [[nodiscard]] virtual Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level,
                                           double sign,
                                           FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A vector field in W.
class VectorField : public AnyField {
 public:
  using AnyField::AnyField;

  /// Value and Jacobian at p_W [m]; NaN and far-away positions give `inside` false.
  /// RT: no allocation, no lock. Cost: tens of ns.
  [[nodiscard]] virtual VectorSample sample(const Vec3& p_W, FieldCache& cache) const noexcept
      PALPATE_NONBLOCKING = 0;
  /// Traces the stream through p_W [m]; see trace.h. The default takes the field as one smooth
  /// piece; a grid's own goes cell by cell. RT: no allocation. Cost: four values of v a step and
  /// one more; rejected steps count.
  [[nodiscard]] virtual Trace trace(const Vec3& p_W, const TraceOrder& order,
                                    FieldCache& cache) const noexcept PALPATE_NONBLOCKING;
};

/// A field of either kind, as scenes name them.
using FieldPtr =
    std::variant<std::shared_ptr<const ScalarField>, std::shared_ptr<const VectorField>>;

}  // namespace palpate
