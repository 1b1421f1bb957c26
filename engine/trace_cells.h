/// How a stream is traced: RK4 with the derivative at the end of the step for an estimate of third
/// order, one cell of the grid at a time. A trilinear field has kinks at the faces of its cells,
/// over which every method is of second order; a step that is cut at the face keeps the fourth.
#pragma once

#include <algorithm>
#include <cmath>

#include "engine/trace.h"
#include "engine/types.h"

namespace palpate {

/// Traces through a `Flow`, which knows cells:
///
///     bool enter(const Vec3& u, const Vec3& direction)  the cell that holds u, on a face the one
///         that the direction leads into; false where there is no data
///     bool pass(int axis, int side)     on to the neighbour: side +1 or -1
///     Vec3 lower()                      the cell is [lower, lower + 1] in u, or
///     constexpr bool kCells             false: one smooth piece without faces
///     Vec3 value(const Vec3& u)         v by the cell's own polynomial, a little outside as well
///     Vec3 rate(const Vec3& v)          du / ds of a unit vector of W, s in voxels
///
/// u and the direction of `enter` are in the cells' own coordinates. The result is in them, too;
/// `length` in voxels, as order.length is here. Where v has no direction the trace ends.
template <class Flow>
struct CellTrace {
  Flow& flow;
  int samples = 0;

  /// v/|v| turned the way of `like`; false where there is none.
  bool direction(const Vec3& u, const Vec3& like, Vec3& d) noexcept {
    ++samples;
    const Vec3 v = flow.value(u);
    const double length = std::sqrt(v.x() * v.x() + v.y() * v.y() + v.z() * v.z());
    if (!(length > 1e-300) || !std::isfinite(length)) return false;
    const double sign = v.x() * like.x() + v.y() * like.y() + v.z() * like.z() < 0.0 ? -1.0 : 1.0;
    const double f = sign / length;
    d = Vec3(f * v.x(), f * v.y(), f * v.z());
    return true;
  }
};

template <class Flow>
[[nodiscard]] Trace traceCells(Flow& flow, const Vec3& start, const TraceOrder& order) noexcept {
  constexpr double kLeast = 0.05;    // shortest step [voxels]
  constexpr double kLongest = 1.0;   // and longest
  constexpr double kPast = 1.03;     // a step that is to reach a face goes so much farther
  constexpr double kEnough = 1e-12;  // [voxels] left: arrived
  Trace out;
  out.position = start;
  out.direction = order.along;
  out.stride = std::clamp(order.stride, kLeast, kLongest);
  const double sense = order.length < 0.0 ? -1.0 : 1.0;
  double left = std::abs(order.length);
  Vec3 u = start;
  Vec3 way = sense * order.along;  // unit, in W: the way we go
  CellTrace<Flow> cell{flow};
  const auto finish = [&] {
    out.position = u;
    out.direction = sense * way;
    out.length = sense * (std::abs(order.length) - left);
    out.samples = cell.samples;
    return out;
  };
  Vec3 k1;
  if (!flow.enter(u, flow.rate(way)) || !cell.direction(u, way, k1)) return finish();
  way = k1;
  Vec3 bend = Vec3::Zero();  // half the derivative of du/ds over the last step
  int steps = 0;
  const int most = 4 * order.max_steps;  // with those that were too long
  for (int tries = 0; left > kEnough; ++tries) {
    if (steps >= order.max_steps || tries >= most) {
      out.capped = true;
      break;
    }
    // To the end, as far as the estimate allows, or to the face ahead.
    double h = std::min(left, out.stride);
    bool to_face = false;
    const Vec3 r1 = flow.rate(k1);
    if constexpr (Flow::kCells) {
      double face = 1e9;
      for (int a = 0; a < 3; ++a) {
        const double t = u[a] - flow.lower()[a];
        for (const double side : {-1.0, 1.0}) {
          const double gap = std::max(side > 0.0 ? 1.0 - t : t, 0.0);
          const double speed = side * r1[a];
          const double turn = 0.5 * side * bend[a];
          const double root = speed * speed + 4.0 * turn * gap;
          if (root < 0.0) continue;
          const double sum = speed + std::sqrt(root);
          if (sum > 1e-12) face = std::min(face, 2.0 * gap / sum);
        }
      }
      const double reach = kPast * face + 0.01;
      to_face = reach < h;
      h = std::min(h, reach);
    }
    Vec3 k2;
    Vec3 k3;
    Vec3 k4;
    Vec3 k5;
    Vec3 r2;
    Vec3 r3;
    Vec3 r4;
    Vec3 end;
    const auto stages = [&] {
      if (!cell.direction(u + 0.5 * h * r1, k1, k2)) return false;
      r2 = flow.rate(k2);
      if (!cell.direction(u + 0.5 * h * r2, k1, k3)) return false;
      r3 = flow.rate(k3);
      if (!cell.direction(u + h * r3, k1, k4)) return false;
      r4 = flow.rate(k4);
      end = u + (h / 6.0) * (r1 + 2.0 * r2 + 2.0 * r3 + r4);
      return cell.direction(end, k1, k5);
    };
    if (!stages()) {
      // A place without a direction is near.
      if (h <= kLeast) break;
      out.stride = std::max(0.5 * std::min(h, out.stride), kLeast);
      continue;
    }
    const Vec3 r5 = flow.rate(k5);
    const double error = h / 6.0 * (k4 - k5).norm();
    const double grow = error > 0.0 ? 0.9 * std::sqrt(std::sqrt(order.tolerance / error)) : 4.0;
    if (error > order.tolerance && h > 1.2 * kLeast) {
      out.stride = std::clamp(h * std::clamp(grow, 0.3, 0.9), kLeast, kLongest);
      continue;
    }
    // A step cut short by a face tells of longer ones only that they may be as long as before.
    const double next = h * std::clamp(grow, 0.5, 2.0);
    const bool cut = to_face || h >= left;
    out.stride =
        std::clamp(cut && grow >= 1.0 ? std::max(out.stride, next) : next, kLeast, kLongest);
    bend = (r5 - r1) / h;
    ++steps;
    if constexpr (Flow::kCells) {
      // Past a face: back to it, on the cubic through both ends.
      const auto cubic = [&](double t, int a) {
        const double t2 = t * t;
        const double t3 = t2 * t;
        return (2.0 * t3 - 3.0 * t2 + 1.0) * u[a] + (t3 - 2.0 * t2 + t) * h * r1[a] +
               (3.0 * t2 - 2.0 * t3) * end[a] + (t3 - t2) * h * r5[a];
      };
      double share = 2.0;
      int axis = -1;
      int side = 0;
      for (int a = 0; a < 3; ++a) {
        for (const int s : {-1, 1}) {
          const double face = flow.lower()[a] + (s > 0 ? 1.0 : 0.0);
          if (!(s * (end[a] - face) > 0.0)) continue;
          double low = 0.0;
          double high = 1.0;
          for (int i = 0; i < 40; ++i) {
            const double middle = 0.5 * (low + high);
            (s * (cubic(middle, a) - face) > 0.0 ? high : low) = middle;
          }
          if (high < share) {
            share = high;
            axis = a;
            side = s;
          }
        }
      }
      if (axis >= 0) {
        const double face = flow.lower()[axis] + (side > 0 ? 1.0 : 0.0);
        Vec3 at(cubic(share, 0), cubic(share, 1), cubic(share, 2));
        at[axis] = face;
        u = at;
        left -= share * h;
        way = k1 + share * (k5 - k1);
        if (!flow.pass(axis, side) || !cell.direction(u, way, k1)) {
          way.normalize();
          return finish();
        }
        way = k1;
        continue;
      }
    }
    u = end;
    k1 = way = k5;
    left -= h;
  }
  return finish();
}

}  // namespace palpate
