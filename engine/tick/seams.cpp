#include "palpate/engine/tick/seams.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include <Eigen/LU>

namespace palpate {
namespace {

/// Largest number of other surfaces that replace samples of one surface.
constexpr std::size_t kMostOthers = 8;
/// Largest height above a surface that replaces samples [longest step of FieldFrame::reach].
constexpr double kNearSteps = 2.0;
/// A gradient below this share of the cell's slope does not give the scale of the surface.
constexpr double kFlat = 0.1;

/// A surface, and the point of its volume that is at x in W. surfaceOf initialises all members.
struct Surface {
  const SurfaceSource* skin;
  const Felt* felt;
  double level;
  const Pose* pose;  ///< Null if the volume stands still.
  Vec3 seen;         ///< The point x in the resting frame [m].
  double scale;      ///< Factor to the unit of the surface whose samples are replaced.

  [[nodiscard]] const ScalarField& field() const noexcept {
    return *felt->graph().scalar_fields[static_cast<std::size_t>(skin->field)];
  }
  [[nodiscard]] FieldCache& cache() const noexcept {
    return felt->bound.caches[static_cast<std::size_t>(skin->field)];
  }
  /// Returns x + step [m, in W] in the resting frame [m].
  [[nodiscard]] Vec3 beside(const Vec3& step) const noexcept {
    return seen + (pose == nullptr ? step : Vec3(pose->back * step));
  }
  /// Returns the signed value at x + step, positive on the free side.
  [[nodiscard]] double value(const Vec3& step) const noexcept {
    return scale * skin->sign * (field().value(beside(step), cache()) - level);
  }
  /// Returns the slope of the interpolated value at x + step, in W [unit / m].
  [[nodiscard]] Vec3 slope(const Vec3& step) const noexcept {
    const Vec3 rest = field().cellGradient(beside(step), cache());
    const Vec3 in_W = pose == nullptr ? rest : pose->gradient(rest);
    return scale * skin->sign / skin->metres_per_unit * in_W;
  }
};

const Vec3& gradientOf(const Surface& surface) noexcept {
  return surface.felt->properties->vectors[static_cast<std::size_t>(surface.skin->gradient)].value;
}

/// Initialises `surface` from `ahead`. Returns false without a surface, or if its strength is zero.
bool surfaceOf(const Tick& tick, const SurfaceAhead& ahead, const Felt& felt, const Vec3& x,
               Surface& surface) noexcept {
  if (ahead.skin == nullptr) return false;
  if (!(ahead.strength->at(*felt.properties, ahead.skin->value, ahead.level) > 0.0)) return false;
  const auto field = static_cast<std::size_t>(ahead.skin->field);
  const Body* body = tick.around.bodies.of(felt.graph().scalar_motions[field]);
  surface.skin = ahead.skin;
  surface.felt = &felt;
  surface.level = ahead.level;
  surface.pose = body == nullptr ? nullptr : &body->pose;
  surface.seen = body == nullptr ? x : body->seen;
  surface.scale = 1.0;
  return true;
}

/// Returns the sum of the loads of a groove's walls, as a multiple of the load L of the one plane
/// that replaces them.
///
/// The gradient is a mean of the walls' gradients, g = sum w_m g_m, and the plane bears L along g.
/// So wall m bears L w_m |g_m| / |g|. All walls together bear L C / |g|, where C is the norm of
/// each gradient, 1 in a distance field. g is a difference over a voxel to each side. The lattice
/// affects this difference least.
///
/// In a groove the slopes to both sides along the normal are equal, except for errors of the
/// lattice. In a sheet or slit of one or two voxels the slopes differ, because one side contains
/// the other face, which bears no load. So the more the slopes differ, the more weight the steeper
/// slope has. Between walls that face each other the ratio would be unbounded; kMostWalls limits
/// it. The ratio is 1 where the surface is convex, tr(dn/dx) >= 0.
double wallsLoad(const Surface& surface, const Vec3& normal, const Mat3& jacobian) noexcept {
  // largest difference of the slopes to both sides of a rotated groove
  constexpr double kLattice = 0.4;
  const double turn = jacobian.trace() - normal.dot(jacobian * normal);
  if (!(surface.skin->sign * turn < 0.0)) return 1.0;
  const FieldFrame& frame = surface.field().frame();
  const Mat3 lattice = frame.voxel / frame.reach.colwise().norm().minCoeff() * frame.reach;
  const auto value_at = [&](const Vec3& step) {
    return surface.field().value(surface.seen + step, surface.cache());
  };
  Vec3 d;
  for (Eigen::Index a = 0; a < 3; ++a) {
    const Vec3 step = lattice.col(a);
    d[a] = 0.5 * (value_at(step) - value_at(-step));
  }
  const double unit = surface.skin->metres_per_unit;
  Vec3 g = unit * (lattice.transpose().inverse() * d);
  const Vec3 n = g.normalized();
  const Vec3 step = frame.voxel * n;
  const double here = value_at(Vec3::Zero());
  const double to_voxel = unit / frame.voxel;
  const double ahead = to_voxel * (value_at(step) - here);
  const double back = to_voxel * (here - value_at(-step));
  const double one_sided = std::clamp((std::abs(ahead - back) - kLattice) / kLattice, 0.0, 1.0);
  g += one_sided * std::max(0.0, std::max(ahead, back) - n.dot(g)) * n;
  const double norm = g.norm();
  return norm > 0.0 ? std::clamp(1.0 / norm, 1.0, kMostWalls) : 1.0;
}

/// Replaces the samples of a surface's gradient by lower samples of the other surfaces.
void fill(const Surface& self, std::span<const Surface> others, const Mat3& steps,
          Seam& seam) noexcept {
  const double here = self.value(Vec3::Zero());
  const Vec3 across = self.slope(Vec3::Zero());
  Vec3 d = Vec3::Zero();
  Mat3 turn = Mat3::Zero();
  for (Eigen::Index a = 0; a < 3; ++a) {
    for (const double sense : {1.0, -1.0}) {
      const Vec3 step = sense * steps.col(a);
      const double value = self.value(step);
      const double tangent = here + across.dot(step);
      if (!(tangent < value)) continue;
      const Surface* lowest = nullptr;
      double least = value;
      for (const Surface& other : others) {
        const double height = other.value(step);
        if (!(height < least)) continue;
        least = height;
        lowest = &other;
      }
      if (lowest == nullptr) continue;
      const bool by_other = least > tangent;
      d[a] += 0.5 * sense * ((by_other ? least : tangent) - value);
      const Vec3 slope = by_other ? lowest->slope(step) : across;
      turn.row(a) += 0.5 * sense * (slope - self.slope(step)).transpose();
    }
  }
  if (d.isZero(0.0)) return;
  const Mat3 to_gradient = self.skin->metres_per_unit * steps.transpose().inverse();
  const Vec3 gradient = to_gradient * d;
  turn = to_gradient * turn;
  if (!gradient.allFinite() || !turn.allFinite()) return;
  seam.gradient = gradient;
  seam.turn = turn;
}

}  // namespace

std::optional<Seam> seamOf(const Tick& tick, const Mode& mode, ModeMemory& memory, const Felt& felt,
                           const Vec3& x) noexcept {
  const SurfaceAhead ahead = surfaceAhead(mode, memory);
  if (ahead.skin == nullptr) return {};
  const bool lone = tick.felt().size() == 1 && felt.graph().surfaces.size() == 1;
  if (lone && !ahead.skin->grooves) return {};
  // A free proxy that does not touch the surface gets no plane.
  const double value = felt.properties->scalars[static_cast<std::size_t>(ahead.skin->value)].value;
  const bool free = ahead.skin->sign * (value - ahead.level) >= 0.0;
  if (free && !ahead.contact->placed && !ahead.contact->touched) return {};
  Surface self;
  if (!surfaceOf(tick, ahead, felt, x, self)) return {};
  const Mat3& reach = self.field().frame().reach;
  // In coarse bricks the steps of the differences are longer than those of the frame.
  if (reach.isZero(0.0) || felt.properties->coarse) return {};
  std::array<Surface, kMostOthers> others;
  std::size_t count = 0;
  eachSurface(tick.felt(), [&](const Mode& one, ModeMemory& of, const Felt& in, std::size_t) {
    if (&of == &memory || count == others.size()) return;
    const SurfaceAhead by = surfaceAhead(one, of);
    if (by.skin == nullptr || (&in == &felt && by.skin->field == self.skin->field)) return;
    const SurfaceReading sight = look(*by.skin, by.level, *in.properties);
    const double longest = reach.colwise().norm().maxCoeff();
    if (!sight.data || !(sight.off * by.skin->voxel <= kNearSteps * longest)) return;
    Surface other;
    if (!surfaceOf(tick, by, in, x, other)) return;
    const double norm = gradientOf(other).norm() / other.skin->metres_per_unit;
    if (!(norm > kFlat * other.slope(Vec3::Zero()).norm())) return;
    other.scale = gradientOf(self).norm() / self.skin->metres_per_unit / norm;
    others[count++] = other;
  });
  if (count == 0 && !self.skin->grooves) return {};
  const SurfaceReading own = look(*self.skin, self.level, *felt.properties);
  if (!own.clear) return {};
  Seam seam;
  if (self.skin->grooves) {
    seam.walls = wallsLoad(self, own.normal,
                           felt.bound.gradientJacobian(static_cast<std::size_t>(self.skin->field),
                                                       x, tick.around.bodies.items()));
  }
  if (count > 0) {
    const Mat3 steps = self.pose == nullptr ? reach : Mat3(self.pose->linear * reach);
    fill(self, {others.data(), count}, steps, seam);
  }
  return seam;
}

}  // namespace palpate
