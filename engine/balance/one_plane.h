/// Private to engine/balance: the closed form for one plane with friction and drags.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "palpate/engine/balance/friction.h"
#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/types.h"

namespace palpate::friction {

inline Vec3 across(const Vec3& q, const Vec3& v) noexcept {
  return v - q.dot(v) * q;
}

/// Balances one plane, its friction and drags. Drags are points at the old proxy, where the
/// friction grips. Lengths are in metres, and forces are divided by k. N is the depth of the
/// spring's end behind the plane, and T its distance from the grip along the plane. r is the
/// distance of the proxy from the grip, and u the part of r along the plane.
///
/// If the plane bears N and also all drags, the proxy is on the plane. The plane may be some
/// micrometres in front of the grip. Drags would then press on the plane, friction would slip at
/// two loads, and the balance would have two or three solutions. In that case the drags act only
/// along the plane, from the foot of the grip:
///
///     n = max(0, N),   friction = min(T, mu n),   drags = the rest, at most s_d.
///
/// If the grip is in front of the plane, the drags pull towards the grip. For a proxy on the plane
///
///     u + mu n + s_d u/r = T,   n = N - s_d h/r,   where h is the grip's height.
///
/// The left side grows with u. Without drags, the first line is valid for any height, with n <= s.
class OnePlane {
 public:
  OnePlane(const Vec3& probe, double stiffness, const PrimitiveSet& set) noexcept
      : stiffness_(stiffness),
        link_(set.links()[0]),
        plane_(set.items()[link_.plane]),
        grip_(set.items()[link_.line].position),
        from_(grip_ - probe),
        q_(plane_.direction.normalized()),
        height_(q_.dot(grip_ - plane_.position)),
        most_(plane_.strength / stiffness) {
    spring_ = -from_;
    for (const Primitive& p : set.items()) {
      const double strength = p.strength / stiffness;
      size_ += strength;
      if (p.kind == PrimitiveKind::kForce) spring_ += strength * p.direction.normalized();
      if (p.kind == PrimitiveKind::kPoint) drags_ += strength;
    }
  }

  /// Returns true if all primitives are valid, and all strength belongs to one plane, its friction,
  /// drags at the friction's grip, and directed forces.
  [[nodiscard]] static bool fits(const PrimitiveSet& set) noexcept {
    if (set.links().size() != 1) return false;
    const FrictionLink& link = set.links()[0];
    const auto items = set.items();
    const auto among = [&](const Primitive& p) {
      switch (p.kind) {
        case PrimitiveKind::kForce:
          return true;
        case PrimitiveKind::kPoint:
          return p.position == items[link.line].position || p.strength == 0.0;
        case PrimitiveKind::kLine:
          return &p == &items[link.line] || p.strength == 0.0;
        case PrimitiveKind::kPlane:
          return &p == &items[link.plane] || p.strength == 0.0;
      }
      return false;
    };
    return std::all_of(items.begin(), items.end(),
                       [&](const auto& p) { return isValid(p) && among(p); });
  }

  /// Finds the balance. Returns false if the plane might yield to drags.
  bool solve() noexcept {
    const double into = -(q_.dot(spring_) + height_);
    if (height_ > 0.0) {
      moved_ = pulled(spring_);
      if (q_.dot(moved_) + height_ >= 0.0) {
        share(spring_ - moved_);
        return true;
      }
      if (drags_ > 0.0) return into <= most_ && solveInFront(into);
    }
    if (drags_ > 0.0 && std::max(into, 0.0) + drags_ > most_) return false;
    foot_ = -height_ * q_;
    load_ = std::clamp(into, 0.0, most_);
    const Vec3 left = spring_ - foot_;
    along_ = across(q_, left);
    const double way = along_.norm();
    const double grips = std::min(way, link_.coefficient * load_);
    if (way > 0.0) friction_ = (grips / way) * along_;
    const Vec3 rest = left + load_ * q_ - friction_;
    moved_ = foot_ + pulled(rest);
    share(rest - (moved_ - foot_));
    return true;
  }

  /// Returns the result and fills `forces` as solveProxy does. Writes friction and drags to the
  /// set.
  SolveResult tell(const Vec3& probe, PrimitiveSet& set, std::span<Vec3> forces) const noexcept {
    SolveResult result;
    result.offset = from_ + moved_;
    result.proxy = probe + result.offset;
    // The bound covers the rounding of sums, and of positions relative to the probe, the plane and
    // the drags.
    const double reach = from_.lpNorm<Eigen::Infinity>() +
                         (grip_ - plane_.position).lpNorm<Eigen::Infinity>() + size_ +
                         (foot_.isZero(0.0) ? 0.0 : grip_.lpNorm<Eigen::Infinity>());
    result.error_bound = 8.0 * std::numeric_limits<double>::epsilon() * reach;
    result.iterations = solves_;
    if (solves_ > 0) result.solver = SolverKind::kPair;
    for (std::size_t i = 0; i < set.size(); ++i) {
      const Primitive& p = set.items()[i];
      forces[i].setZero();
      if (p.kind == PrimitiveKind::kForce) forces[i] = p.strength * p.direction.normalized();
      if (p.kind != PrimitiveKind::kPoint || p.strength == 0.0) continue;
      forces[i] = -p.strength * dragged_;
      set.setPosition(i, grip_ + foot_);
    }
    forces[link_.plane] = stiffness_ * load_ * q_;
    forces[link_.line] = -stiffness_ * friction_;
    set.setStrength(link_, link_.coefficient * load_ * stiffness_);
    set.setPosition(link_.line, grip_ + foot_);
    return result;
  }

 private:
  /// Returns the displacement of a proxy that `pull` moves against the drags.
  [[nodiscard]] Vec3 pulled(const Vec3& pull) const noexcept {
    const double length = pull.norm();
    return length > drags_ ? Vec3((1.0 - drags_ / length) * pull) : Vec3(Vec3::Zero());
  }

  /// Writes the load of the drags: `pull` if friction is at its limit. If the proxy has not moved,
  /// friction and drags share the load in proportion to their strengths; friction bears more if the
  /// drags cannot bear their part.
  void share(Vec3 pull) noexcept {
    if (!(drags_ > 0.0)) return;
    const double sliding = link_.coefficient * load_;
    const double way = along_.norm();
    if (moved_ == foot_ && sliding > 0.0 && way > 0.0) {
      const double pressing = pull.dot(q_);
      const double room = std::sqrt(std::max(0.0, drags_ * drags_ - pressing * pressing));
      const double held = std::max(way - room, way * sliding / (sliding + drags_));
      pull += friction_;
      friction_ = (held / way) * along_;
      pull -= friction_;
    }
    dragged_ = pull / drags_;
  }

  /// Finds the proxy on a plane that is behind the grip, by Newton's method between bounds.
  bool solveInFront(double into) noexcept {
    constexpr int kMost = 60;
    const double mu = link_.coefficient;
    along_ = across(q_, spring_);
    const double way = along_.norm();
    double low = std::max(0.0, way - mu * into - drags_);
    double high = way;
    double u = low;
    double r = std::max(height_, std::hypot(u, height_));
    if (mu * (into - drags_) < way) {
      while (solves_ < kMost) {
        ++solves_;
        const double left = u + mu * (into - drags_ * height_ / r) + drags_ * u / r - way;
        (left > 0.0 ? high : low) = u;
        const double slope = 1.0 + drags_ * height_ * (height_ + mu * u) / (r * r * r);
        double next = u - left / slope;
        if (!(next >= low && next <= high)) next = 0.5 * (low + high);
        // The rounding of the left side and of the direction from the grip limits the accuracy.
        const double least = std::numeric_limits<double>::epsilon() * (r + way / slope);
        const bool there = std::abs(next - u) <= 4.0 * least;
        u = next;
        r = std::hypot(u, height_);
        if (there) break;
      }
    } else {
      u = 0.0;
      r = height_;
    }
    load_ = std::max(0.0, into - drags_ * height_ / r);
    if (way > 0.0) friction_ = (std::min(way, mu * load_) / way) * along_;
    moved_ = (way > 0.0 ? Vec3((u / way) * along_) : Vec3(Vec3::Zero())) - height_ * q_;
    dragged_ = moved_ / r;
    return true;
  }

  double stiffness_;
  const FrictionLink& link_;
  const Primitive& plane_;
  Vec3 grip_;
  Vec3 from_;  ///< Vector from the probe to the grip.
  Vec3 q_;
  double height_;  ///< Height of the grip over the plane.
  double most_;
  double drags_ = 0.0;
  double size_ = 0.0;
  Vec3 spring_;  ///< End of the spring, displaced by directed forces. This and the members below
                 ///< are relative to the grip.
  Vec3 foot_ = Vec3::Zero();
  Vec3 along_ = Vec3::Zero();
  Vec3 friction_ = Vec3::Zero();
  Vec3 dragged_ = Vec3::Zero();
  Vec3 moved_ = Vec3::Zero();
  double load_ = 0.0;
  int solves_ = 0;
};

}  // namespace palpate::friction
