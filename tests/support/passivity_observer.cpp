#include "tests/support/passivity_observer.h"

namespace palpate::methods {

Vec3 PassivityObserver::control(const Vec3& wanted, const Vec3& hand, double dt,
                                double peak) noexcept {
  Vec3 force = wanted;
  const Vec3 moved = known_ ? Vec3(hand - last_) : Vec3(Vec3::Zero());
  energy_ -= sent_.dot(moved);
  if (energy_ < 0.0 && moved.squaredNorm() > 0.0) {
    const double damper = -energy_ * dt / moved.squaredNorm();
    force -= damper * moved / dt;
    if (force.norm() > peak) force *= peak / force.norm();
  }
  known_ = true;
  last_ = hand;
  sent_ = force;
  return force;
}

}  // namespace palpate::methods
