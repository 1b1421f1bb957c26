#include "bench/motion_methods.h"

#include <algorithm>
#include <utility>

namespace palpate::methods {

MemorylessSurface::MemorylessSurface(std::shared_ptr<const ScalarField> field, double level,
                                     double sign, double give, const SurfaceRule& rule)
    : field_(std::move(field)),
      cache_(std::make_unique<FieldCache>()),
      level_(level),
      sign_(sign),
      give_(give),
      rule_(rule) {
  field_->reset(*cache_);
}

Moved MemorylessSurface::tick(const Vec3& probe) noexcept {
  Moved moved;
  if (!placed_) {
    placed_ = true;
    proxy_ = probe;
    probe_ = probe;
  }
  const Vec3 from = probe_;
  for (int i = 1; i <= rule_.substeps; ++i) {
    move(from + (static_cast<double>(i) / rule_.substeps) * (probe - from), moved);
  }
  probe_ = probe;
  moved.proxy = proxy_;
  moved.held = !free_;
  return moved;
}

void MemorylessSurface::move(const Vec3& probe, Moved& moved) noexcept {
  if (free_) {
    const Crossing met = field_->firstFall(proxy_, probe, level_, sign_, *cache_);
    moved.cells += met.cells;
    proxy_ += (met.found ? met.share : 1.0) * (probe - proxy_);
    free_ = !met.found;
    if (free_) return;
  }
  Vec3 end = probe;
  bool held = balance(proxy_, probe, end, moved);
  for (int i = 0; i < rule_.midpoints && held; ++i) {
    held = balance(0.5 * (proxy_ + end), probe, end, moved);
  }
  proxy_ = held ? end : probe;
  free_ = !held;
}

bool MemorylessSurface::balance(const Vec3& at, const Vec3& probe, Vec3& end,
                                Moved& moved) noexcept {
  const ScalarSample read = field_->sample(at, *cache_);
  ++moved.reads;
  const double steep = read.gradient.norm();
  if (!read.inside || !(steep > 0.0)) return false;
  const Vec3 q = (sign_ / steep) * read.gradient;  // q: unit normal, out of the solid
  const double depth = q.dot(proxy_ - probe);
  if (!(depth > 0.0)) return false;
  end = probe + std::min(depth, give_) * q;
  return true;
}

MemorylessStream::MemorylessStream(std::shared_ptr<const VectorField> field, double give,
                                   const StreamRule& rule)
    : field_(std::move(field)), cache_(std::make_unique<FieldCache>()), give_(give), rule_(rule) {
  field_->reset(*cache_);
}

Moved MemorylessStream::tick(const Vec3& probe) noexcept {
  Moved moved;
  if (!placed_) {
    placed_ = true;
    proxy_ = probe;
    probe_ = probe;
  }
  const Vec3 from = probe_;
  moved.held = true;
  for (int i = 1; i <= rule_.substeps; ++i) {
    move(from + (static_cast<double>(i) / rule_.substeps) * (probe - from), moved);
  }
  probe_ = probe;
  moved.proxy = proxy_;
  return moved;
}

Vec3 MemorylessStream::direction(const Vec3& at, Moved& moved) noexcept {
  const VectorSample read = field_->sample(at, *cache_);
  ++moved.reads;
  const double speed = read.value.norm();
  return read.inside && speed > 0.0 ? Vec3(read.value / speed) : Vec3::Zero();
}

void MemorylessStream::move(const Vec3& probe, Moved& moved) noexcept {
  const Vec3 k1 = direction(proxy_, moved);
  if (k1.isZero()) {
    proxy_ = probe;
    moved.held = false;
    return;
  }
  const Vec3 pull = probe - proxy_;
  const double length = k1.dot(pull);
  const Vec3 aside = pull - length * k1;

  // Limits the step of the rules of higher order, because samples farther away are not reliable.
  const double reach = 4.0 * field_->frame().voxel;
  const double way = std::clamp(length, -reach, reach);
  switch (rule_.along) {
    case Along::kTangent:
      proxy_ += length * k1;
      break;
    case Along::kMidpoint:
      proxy_ += way * direction(proxy_ + 0.5 * way * k1, moved);
      break;
    case Along::kRk4: {
      const Vec3 k2 = direction(proxy_ + 0.5 * way * k1, moved);
      const Vec3 k3 = direction(proxy_ + 0.5 * way * k2, moved);
      const Vec3 k4 = direction(proxy_ + way * k3, moved);
      proxy_ += way / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
      break;
    }
  }
  // Perpendicular to the line, the proxy moves by the part of its distance to the hand that exceeds
  // give_.
  const double off = aside.norm();
  if (off > give_) proxy_ += (1.0 - give_ / off) * aside;
}

}  // namespace palpate::methods
