#include "palpate/engine/solver.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Geometry>

namespace palpate {
namespace {

// The plan. Lengths in units of T/k and forces in units of T, T the strengths of points and lines
// and half of the planes', make the potential of solver.h
//
//     |y - spring|^2 / 2 + sum sigma |P y - b|,   sum sigma = 1.
//
//     eq. (8)         moves the spring's end, and is gone
//     eq. (9)         P = I
//     eqs (10), (11)  P = I - q q^T
//     eqs (12), (13)  max(0, t) = (t + |t|)/2: half of it as eq. (8), half with P = q q^T
//     eq. (14)        minus the gradient; on a kink, where P y = b, any -sigma z with |z| <= 1
//     eq. (15)        y, and a z for each primitive, of gradient zero
//
// balance(), at the end of this file, tries in this order what is exact or cheap: orthogonal
// primitives one by one, a plane and one other by a scalar equation, pivots where all are planes,
// Newton on what held the proxy a tick ago, and the method of multipliers. docs/decisions/0005 and
// 0012 say why these.

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
/// A line search ends where this share of the slope is left.
constexpr double kSlopeLeft = 0.03;
/// A multiplier of at least this cosine with its displacement points along it.
constexpr double kAlong = 1.0 - 1e-4;
/// |z|^2 of a multiplier inside its ball: the primitive holds the proxy on its kink.
constexpr double kOnKink = 1.0 - 1e-12;

/// The primitives of one balance other than directed forces, as sigma |P y - b|, P = alpha I +
/// beta q q^T the projector on the point's three, the line's two or the plane's one constrained
/// directions. Field by field, so that the loops below run several terms at a time.
///
/// b = P a, a the anchor: where on its line or plane a primitive stands does not matter, and b is
/// small wherever the kink is near the origin, so that distances to near kinks keep their digits.
struct Terms {
  std::size_t count = 0;
  double* sigma;
  double* alpha;             ///< point 1, line 1, plane 0
  double* beta;              ///< point 0, line -1, plane 1
  std::array<double*, 3> q;  ///< unit direction
  std::array<double*, 3> b;
  std::array<double*, 3> z;  ///< multiplier: the force is -sigma z, |z| <= 1, in the range of P
  std::array<double*, 3>
      u;                ///< scratch: u of the last envelopeGradient, then Line's fields; or Pivots'
  std::size_t* source;  ///< index of the primitive

  /// b <- P (scale (b - origin)).
  void placeFeet(const Vec3& origin, double scale) noexcept;
  /// Projects the multipliers of a tick ago into the range of P, turned with their line or plane.
  /// Their length says whether the primitive held the proxy, and is kept, to 1 at most.
  void turnMultipliers() noexcept;

  static constexpr std::size_t kFields = 15;
};

template <std::size_t Capacity>
struct Storage {
  // A cache line more than needed: at a power of two all fields would share one set of the cache.
  std::array<std::array<double, Capacity + 8>, Terms::kFields> fields;
  std::array<std::size_t, Capacity> source;

  Terms view() noexcept {
    const auto at = [&](std::size_t i) { return fields[i].data(); };
    return {0,
            at(0),
            at(1),
            at(2),
            {at(3), at(4), at(5)},
            {at(6), at(7), at(8)},
            {at(9), at(10), at(11)},
            {at(12), at(13), at(14)},
            source.data()};
  }
};

Vec3 get(const std::array<double*, 3>& field, std::size_t i) noexcept {
  return {field[0][i], field[1][i], field[2][i]};
}

void set(const std::array<double*, 3>& field, std::size_t i, const Vec3& v) noexcept {
  for (std::size_t axis = 0; axis < 3; ++axis) field[axis][i] = v[static_cast<Eigen::Index>(axis)];
}

/// std::max by value: its references keep the compiler from running the loops several at a time.
double larger(double a, double b) noexcept {
  return a > b ? a : b;
}

/// Solves H x = b for a symmetric H with eigenvalues >= 1, by L D L^T.
Vec3 solve3(const Mat3& H, const Vec3& b) noexcept {
  const double i0 = 1.0 / H(0, 0);
  const double l10 = H(1, 0) * i0;
  const double l20 = H(2, 0) * i0;
  const double i1 = 1.0 / (H(1, 1) - l10 * H(1, 0));
  const double m = H(2, 1) - l10 * H(2, 0);
  const double l21 = m * i1;
  const double d2 = H(2, 2) - l20 * H(2, 0) - l21 * m;
  const double y1 = b[1] - l10 * b[0];
  const double y2 = b[2] - l20 * b[0] - l21 * y1;
  Vec3 x;
  x[2] = y2 / d2;
  x[1] = y1 * i1 - l21 * x[2];
  x[0] = b[0] * i0 - l10 * x[1] - l20 * x[2];
  return x;
}

/// Three doubles that the loops below can keep in vector registers, as they cannot a Vec3.
struct Triple {
  double x;
  double y;
  double z;
};

/// P (x, y, z) of term i.
inline Triple constrained(const Terms& t, std::size_t i, double x, double y, double z) noexcept {
  const double qx = t.q[0][i];
  const double qy = t.q[1][i];
  const double qz = t.q[2][i];
  const double alpha = t.alpha[i];
  const double along = t.beta[i] * (qx * x + qy * y + qz * z);
  return {alpha * x + along * qx, alpha * y + along * qy, alpha * z + along * qz};
}

/// P v of term i.
Vec3 project(const Terms& terms, std::size_t i, const Vec3& v) noexcept {
  const auto [x, y, z] = constrained(terms, i, v.x(), v.y(), v.z());
  return {x, y, z};
}

void Terms::placeFeet(const Vec3& origin, double scale) noexcept {
  const double ox = origin.x();
  const double oy = origin.y();
  const double oz = origin.z();
#pragma omp simd
  for (std::size_t i = 0; i < count; ++i) {
    // Projected twice: what rounding leaves outside the range of P is not small beside a near foot.
    const auto [ax, ay, az] = constrained(*this, i, scale * (b[0][i] - ox), scale * (b[1][i] - oy),
                                          scale * (b[2][i] - oz));
    const auto [bx, by, bz] = constrained(*this, i, ax, ay, az);
    b[0][i] = bx;
    b[1][i] = by;
    b[2][i] = bz;
  }
}

void Terms::turnMultipliers() noexcept {
#pragma omp simd
  for (std::size_t i = 0; i < count; ++i) {
    const double zx = z[0][i];
    const double zy = z[1][i];
    const double zz = z[2][i];
    const auto [ax, ay, az] = constrained(*this, i, zx, zy, zz);
    const auto [bx, by, bz] = constrained(*this, i, ax, ay, az);
    const double length = std::sqrt(zx * zx + zy * zy + zz * zz);
    const double turned = std::sqrt(bx * bx + by * by + bz * bz);
    const double scale = (length < 1.0 ? length : 1.0) / larger(turned, kEpsilon);
    z[0][i] = scale * bx;
    z[1][i] = scale * by;
    z[2][i] = scale * bz;
  }
}

/// The potential that is to be minimised, and the numbers that restore metres.
struct Problem {
  Vec3 w = Vec3::Zero();  ///< the spring's end, relative to the probe [m]: directed forces only
                          ///< move it
  double length = 0.0;    ///< T/k [m]
  Vec3 spring = Vec3::Zero();  ///< the spring's end, in units of T/k from the origin
  Terms terms;

  /// Moves the origin, so that small distances near it are not rounded to the size of others.
  void moveOrigin(const Vec3& to) noexcept {
    spring -= to;
    terms.placeFeet(to, 1.0);
  }
  /// A solution as a displacement from the probe [m].
  [[nodiscard]] Vec3 offset(const Vec3& y) const noexcept { return w + length * (y - spring); }
};

/// d = P y - b of term i.
inline Triple displacement(const Terms& t, std::size_t i, double x, double y, double z) noexcept {
  const auto [px, py, pz] = constrained(t, i, x, y, z);
  return {px - t.b[0][i], py - t.b[1][i], pz - t.b[2][i]};
}

/// u = z + d/gamma of term i. Projected: what rounding leaves of d outside the range of P would be
/// no force that the primitive can exert, and 1/gamma makes it large.
inline Triple multiplierAt(const Terms& t, std::size_t i, double per_gamma, double x, double y,
                           double z) noexcept {
  const auto [dx, dy, dz] = displacement(t, i, x, y, z);
  return constrained(t, i, t.z[0][i] + per_gamma * dx, t.z[1][i] + per_gamma * dy,
                     t.z[2][i] + per_gamma * dz);
}

/// Which side of a norm's envelope a primitive is on.
enum class Pieces : std::uint8_t {
  kActual,    ///< As u says: on its kink where |u| <= 1.
  kBelieved,  ///< As the multiplier says: on its kink where |z| < 1.
};

/// Gradient at y of the potential with each norm replaced by its Moreau envelope around z, and its
/// (generalised) Hessian. u = z + (P y - b)/gamma; gradient sigma u on the kink, sigma u/|u| off
/// it.
template <Pieces pieces>
Vec3 envelopeGradient(Problem& problem, double gamma, const Vec3& at, Mat3& H) noexcept {
  Terms& t = problem.terms;
  const double x = at.x();
  const double y = at.y();
  const double z = at.z();
  const double per_gamma = 1.0 / gamma;
  double gx = 0.0;
  double gy = 0.0;
  double gz = 0.0;
  double hxx = 0.0;
  double hyy = 0.0;
  double hzz = 0.0;
  double hxy = 0.0;
  double hxz = 0.0;
  double hyz = 0.0;
#pragma omp simd reduction(+ : gx, gy, gz, hxx, hyy, hzz, hxy, hxz, hyz)
  for (std::size_t i = 0; i < t.count; ++i) {
    const double alpha = t.alpha[i];
    const double beta = t.beta[i];
    const double qx = t.q[0][i];
    const double qy = t.q[1][i];
    const double qz = t.q[2][i];
    const auto [ux, uy, uz] = multiplierAt(t, i, per_gamma, x, y, z);
    t.u[0][i] = ux;
    t.u[1][i] = uy;
    t.u[2][i] = uz;
    const double r = std::sqrt(ux * ux + uy * uy + uz * uz);
    bool on = r <= 1.0;
    double shrink = 1.0 / larger(r, 1.0);
    if constexpr (pieces == Pieces::kBelieved) {
      on = t.z[0][i] * t.z[0][i] + t.z[1][i] * t.z[1][i] + t.z[2][i] * t.z[2][i] < kOnKink;
      shrink = on ? 1.0 : 1.0 / larger(r, kEpsilon);
    }
    const double ex = shrink * ux;
    const double ey = shrink * uy;
    const double ez = shrink * uz;
    const double sigma = t.sigma[i];
    gx += sigma * ex;
    gy += sigma * ey;
    gz += sigma * ez;
    // c P on the kink, c (P - e e^T) off it, where a plane has P = e e^T.
    const double c = per_gamma * sigma * shrink * (on ? 1.0 : alpha);
    const double curl = on ? 0.0 : c;
    const double cb = c * beta;
    const double ca = c * alpha;
    hxx += ca + cb * qx * qx - curl * ex * ex;
    hyy += ca + cb * qy * qy - curl * ey * ey;
    hzz += ca + cb * qz * qz - curl * ez * ez;
    hxy += cb * qx * qy - curl * ex * ey;
    hxz += cb * qx * qz - curl * ex * ez;
    hyz += cb * qy * qz - curl * ey * ez;
  }
  H << 1.0 + hxx, hxy, hxz, hxy, 1.0 + hyy, hyz, hxz, hyz, 1.0 + hzz;
  return at - problem.spring + Vec3(gx, gy, gz);
}

/// The envelope along a line from the place of the last envelopeGradient: with v = P step / gamma,
/// u + t v has the length sqrt(c (t - turn)^2 + nearest).
class Line {
 public:
  Line(Problem& problem, double gamma, const Vec3& at, const Vec3& step) noexcept
      : terms_(problem.terms),
        gamma_(gamma),
        slope_((at - problem.spring).dot(step)),
        curvature_(step.squaredNorm()) {
    Terms& t = terms_;
    const double per_gamma = 1.0 / gamma;
    const double x = step.x();
    const double y = step.y();
    const double z = step.z();
#pragma omp simd
    for (std::size_t i = 0; i < t.count; ++i) {
      const auto [px, py, pz] = constrained(t, i, x, y, z);
      const double vx = per_gamma * px;
      const double vy = per_gamma * py;
      const double vz = per_gamma * pz;
      const double c = vx * vx + vy * vy + vz * vz;
      const double ux = t.u[0][i];
      const double uy = t.u[1][i];
      const double uz = t.u[2][i];
      const double turn =
          -(ux * vx + uy * vy + uz * vz) / larger(c, std::numeric_limits<double>::min());
      const double nx = ux + turn * vx;
      const double ny = uy + turn * vy;
      const double nz = uz + turn * vz;
      t.u[0][i] = turn;
      t.u[1][i] = c;
      t.u[2][i] = nx * nx + ny * ny + nz * nz;
    }
  }

  /// The envelope's derivative by t. It rises with t, and unlike energies is not lost in rounding.
  [[nodiscard]] double slope(double at) const noexcept {
    const Terms& t = terms_;
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (std::size_t i = 0; i < t.count; ++i) {
      const double past = at - t.u[0][i];
      const double c = t.u[1][i];
      const double r = std::sqrt(c * past * past + t.u[2][i]);
      sum += t.sigma[i] * c * past / larger(r, 1.0);
    }
    return slope_ + at * curvature_ + gamma_ * sum;
  }

  /// Where between 0 and 1 the slope, `at_start` < 0 at 0 and `at_end` > 0 at 1, has nearly
  /// vanished: bracketed, by Chandrupatla's mix of inverse quadratic interpolation and halving.
  /// Kinks may be many decades nearer than 1, so what is halved is the exponent.
  [[nodiscard]] double lowest(double at_start, double at_end) const noexcept {
    constexpr int kMostTrials = 40;
    constexpr double kNearest = 1e-15;
    const double enough = -kSlopeLeft * at_start;
    // a is the newest point, b the other end of the bracket, c the point before.
    double a = 1.0;
    double at_a = at_end;
    double b = 0.0;
    double at_b = at_start;
    double t = at_start / (at_start - at_end);
    for (int i = 0; i < kMostTrials; ++i) {
      const double at_t = slope(t);
      if (std::abs(at_t) <= enough) break;
      const bool same_side = (at_t > 0.0) == (at_a > 0.0);
      const double c = same_side ? a : b;
      const double at_c = same_side ? at_a : at_b;
      if (!same_side) {
        b = a;
        at_b = at_a;
      }
      a = t;
      at_a = at_t;
      const double shortest = kEpsilon / std::abs(b - a);
      if (shortest > 0.5) break;
      const double xi = (a - b) / (c - b);
      const double phi = (at_a - at_b) / (at_c - at_b);
      double share = 0.0;  // share of the interval from a to b
      if (phi * phi < xi && (1.0 - phi) * (1.0 - phi) < 1.0 - xi) {
        share = at_a / (at_b - at_a) * at_c / (at_b - at_c) +
                (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b);
      } else {
        const double low = std::max(std::min(a, b), kNearest);
        const double high = std::max(a, b);
        share = ((high > 10.0 * low ? std::sqrt(low * high) : 0.5 * (a + b)) - a) / (b - a);
      }
      t = a + std::clamp(share, shortest, 1.0 - shortest) * (b - a);
    }
    return t;
  }

 private:
  Terms& terms_;
  double gamma_;
  double slope_;
  double curvature_;
};

/// Sets the multipliers to u, or to its nearest point of the unit ball.
template <Pieces pieces>
void updateMultipliers(Problem& problem, double gamma, const Vec3& at) noexcept {
  Terms& t = problem.terms;
  const double x = at.x();
  const double y = at.y();
  const double z = at.z();
  const double per_gamma = 1.0 / gamma;
#pragma omp simd
  for (std::size_t i = 0; i < t.count; ++i) {
    const double zx = t.z[0][i];
    const double zy = t.z[1][i];
    const double zz = t.z[2][i];
    const auto [ux, uy, uz] = multiplierAt(t, i, per_gamma, x, y, z);
    const double r = std::sqrt(ux * ux + uy * uy + uz * uz);
    const double shrink = 1.0 / larger(r, 1.0);
    double nx = shrink * ux;
    double ny = shrink * uy;
    double nz = shrink * uz;
    if constexpr (pieces == Pieces::kBelieved) {
      // A term believed off its kink that comes out on the other side is on its kink.
      const bool crossed = ux * zx + uy * zy + uz * zz < 0.0;
      nx = crossed ? 0.9 * zx : nx;
      ny = crossed ? 0.9 * zy : ny;
      nz = crossed ? 0.9 * zz : nz;
    }
    t.z[0][i] = nx;
    t.z[1][i] = ny;
    t.z[2][i] = nz;
  }
}

/// Upper bound on |y - y*| by the duality gap, written without cancellation: every term is >= 0.
/// Two dual points are tried: the multipliers; and d/|d| instead for those primitives whose
/// multiplier points along d = P y - b. `by_multipliers` says whether the first was the better.
double certify(const Problem& problem, const Vec3& at, bool& by_multipliers) noexcept {
  constexpr double kLastDigits = 4.0 * kEpsilon;
  const Terms& t = problem.terms;
  const double x = at.x();
  const double y = at.y();
  const double z = at.z();
  double gap = 0.0;
  double mx = 0.0;
  double my = 0.0;
  double mz = 0.0;
  double off_gap = 0.0;
  double ox = 0.0;
  double oy = 0.0;
  double oz = 0.0;
#pragma omp simd reduction(+ : gap, mx, my, mz, off_gap, ox, oy, oz)
  for (std::size_t i = 0; i < t.count; ++i) {
    const auto [dx, dy, dz] = displacement(t, i, x, y, z);
    const double zx = t.z[0][i];
    const double zy = t.z[1][i];
    const double zz = t.z[2][i];
    const double sigma = t.sigma[i];
    const double distance = std::sqrt(dx * dx + dy * dy + dz * dz);
    const double held = zx * dx + zy * dy + zz * dz;
    // The difference is rounded to its terms' last digits: what that can hide counts as well.
    const double loss = sigma * (larger(distance - held, 0.0) + kLastDigits * distance);
    const bool off = held > kAlong * distance;
    const double per = 1.0 / larger(distance, std::numeric_limits<double>::min());
    gap += loss;
    mx += sigma * zx;
    my += sigma * zy;
    mz += sigma * zz;
    off_gap += off ? 0.0 : loss;
    ox += sigma * (off ? per * dx : zx);
    oy += sigma * (off ? per * dy : zy);
    oz += sigma * (off ? per * dz : zz);
  }
  const Vec3 stretch = at - problem.spring;
  const double by_z = 2.0 * gap + (stretch + Vec3(mx, my, mz)).squaredNorm();
  const double by_d = 2.0 * off_gap + (stretch + Vec3(ox, oy, oz)).squaredNorm();
  by_multipliers = by_z <= by_d;
  return std::sqrt(std::min(by_z, by_d));
}

/// The multipliers become the better dual point of certify().
void turnAlongDisplacements(Problem& problem, const Vec3& at) noexcept {
  const Terms& t = problem.terms;
  for (std::size_t i = 0; i < t.count; ++i) {
    const auto [x, y, z] = displacement(t, i, at.x(), at.y(), at.z());
    const Vec3 d(x, y, z);
    const double distance = d.norm();
    if (get(t.z, i).dot(d) > kAlong * distance) set(t.z, i, d / distance);
  }
}

/// Semismooth Newton on the envelope from y, until a step is expected to lower it by less than
/// `enough`. Counts linear solves in `solves`; false after `most` of them.
bool minimiseEnvelope(Problem& problem, double gamma, double enough, int most, Vec3& y,
                      int& solves) noexcept {
  for (int i = 0; i < most; ++i) {
    Mat3 H;
    const Vec3 g = envelopeGradient<Pieces::kActual>(problem, gamma, y, H);
    const Vec3 step = -solve3(H, g);
    ++solves;
    const double slope = g.dot(step);  // < 0: the envelope falls by about -slope/2
    const Line line(problem, gamma, y, step);
    const double end = line.slope(1.0);
    y += (end > -kSlopeLeft * slope ? line.lowest(slope, end) : 1.0) * step;
    if (-0.5 * slope <= enough) return true;
  }
  return false;
}

/// Guesses and proofs of one general balance.
class Search {
 public:
  Search(Problem& problem, const SolverParams& params) noexcept
      : problem_(problem), params_(params) {}

  /// Speculates: the primitives that held the proxy in the last tick hold it still. Newton on the
  /// norms of the others, the kinks of these as all but rigid springs. True when proved.
  bool warm(Vec3 y) noexcept {
    constexpr double kGamma = 1e-10;
    constexpr int kMostSolves = 4;
    for (int i = 0; i < std::min(kMostSolves, left()); ++i) {
      Mat3 H;
      const Vec3 g = envelopeGradient<Pieces::kBelieved>(problem_, kGamma, y, H);
      y -= solve3(H, g);
      ++solves_;
      updateMultipliers<Pieces::kBelieved>(problem_, kGamma, y);
      if (prove(y)) return true;
    }
    return false;
  }

  /// The proximal method of multipliers: envelopes around z, minimised by Newton, tightened. Kinks
  /// come out exact, and nothing degenerates as the tolerance falls. From a cold start: a start on
  /// the edge of the unit balls can jam the Newton. True when proved.
  bool cold() noexcept {
    constexpr double kFirstGamma = 0.3;
    constexpr double kTighten = 0.03;
    constexpr double kLastGamma = 1e-13;
    constexpr double kNear = 1e-3;  // below this gamma the origin follows the iterate
    // Each envelope is minimised loosely, to some hundred gamma: the multipliers make up for it.
    constexpr double kLoose = 1e5;
    // A round that takes longer than this was tightened too fast: gamma is relaxed, and tightened
    // with care from then on. (By the same factor once more, rounds can go in a circle.)
    constexpr int kMostOfRound = 8;
    constexpr double kRelax = 12.0;
    constexpr double kCareful = 0.35;

    for (auto& axis : problem_.terms.z) std::fill_n(axis, problem_.terms.count, 0.0);
    Vec3 y = problem_.spring;
    double gamma = kFirstGamma;
    double tighten = kTighten;
    while (left() > 0) {
      if (gamma < kNear) {
        moveOrigin(y);
        y.setZero();
      }
      const double enough = std::max(kLoose * gamma * gamma, 1e-30);
      if (minimiseEnvelope(problem_, gamma, enough, std::min(kMostOfRound, left()), y, solves_)) {
        updateMultipliers<Pieces::kActual>(problem_, gamma, y);
        if (prove(y)) return true;
        gamma = std::max(tighten * gamma, kLastGamma);
      } else {
        gamma *= kRelax;
        tighten = kCareful;
      }
    }
    return false;
  }

  /// True where the guess is within the tolerance, by the multipliers or along the displacements.
  bool prove(const Vec3& guess) noexcept {
    bool by_multipliers = true;
    const double bound = certify(problem_, guess, by_multipliers);
    if (bound < best_bound_) {
      best_bound_ = bound;
      best_ = guess;
    }
    if (best_bound_ > params_.tolerance) return false;
    if (!by_multipliers) turnAlongDisplacements(problem_, guess);
    return true;
  }

  /// The best guess so far, its bound [m], and the linear solves that it took.
  [[nodiscard]] Vec3 offset() const noexcept { return problem_.offset(best_); }
  [[nodiscard]] double bound() const noexcept { return problem_.length * best_bound_; }
  [[nodiscard]] int solves() const noexcept { return solves_; }

  void moveOrigin(const Vec3& to) noexcept {
    problem_.moveOrigin(to);
    best_ -= to;
  }

 private:
  [[nodiscard]] int left() const noexcept { return params_.max_iterations - solves_; }

  Problem& problem_;
  const SolverParams& params_;
  int solves_ = 0;
  Vec3 best_ = problem_.spring;
  double best_bound_ = 1.0;  // all terms together pull with at most T: |y* - spring| <= 1
};

/// The balance of planes alone, by pivots: the potential is quadratic in each cell that the planes
/// divide space into, so it falls along a straight line to a plane that holds or to a cell's own
/// minimum, and a plane in the active set that would take more than its strength is released. No
/// plane is rounded off. In three dimensions at most three hold at once; a few pivots are enough,
/// however many planes there are, unless many kinks are one point that the proxy stays in.
class Pivots {
 public:
  explicit Pivots(Problem& problem) noexcept : problem_(problem), terms_(problem.terms) {}

  /// Lines and points have no cells.
  [[nodiscard]] static bool fits(const Terms& terms) noexcept {
    return std::all_of(terms.alpha, terms.alpha + terms.count, [](double a) { return a == 0.0; });
  }

  /// Moves y towards the balance and sets the multipliers there; false where it was not reached.
  bool solve(Vec3& y) noexcept {
    place(y);
    while (pivots_ < kMostPivots) {
      ++pivots_;
      const Vec3 g = gradient(y);
      const Vec3 d = -across(g);
      const double slope = d.squaredNorm();
      if (held_ == 3 || slope <= square(8.0 * kEpsilon * (1.0 + g.norm()))) {
        if (letGo(g)) continue;
        speak(g);
        return true;
      }
      y += fall(d, slope) * d;
    }
    speak(gradient(y));
    return false;
  }
  /// The solution again, once the origin has been moved to it: heights there are no longer rounded
  /// to the size of others, and those of the planes that hold vanish. Sets the multipliers, too.
  [[nodiscard]] Vec3 onHeld() noexcept {
    Vec3 y = Vec3::Zero();
    for (std::size_t k = 0; k < held_; ++k) {
      const Vec3 q = get(terms_.q, holder_[k]);
      y += q.dot(get(terms_.b, holder_[k]) - y) / q.dot(basis_[k]) * basis_[k];
    }
    speak(gradient(y));
    return y;
  }
  [[nodiscard]] int pivots() const noexcept { return pivots_; }

 private:
  static double square(double x) noexcept { return x * x; }
  /// Term i's height q.y - q.b; its rate along the step; its side, 0 where the plane holds.
  [[nodiscard]] double& height(std::size_t i) const noexcept { return terms_.u[0][i]; }
  [[nodiscard]] double& rate(std::size_t i) const noexcept { return terms_.u[1][i]; }
  [[nodiscard]] double& side(std::size_t i) const noexcept { return terms_.u[2][i]; }

  void place(const Vec3& y) noexcept {
    for (std::size_t i = 0; i < terms_.count; ++i) {
      const Vec3 q = get(terms_.q, i);
      height(i) = q.dot(y - get(terms_.b, i));
      side(i) = height(i) >= 0.0 ? 1.0 : -1.0;
    }
  }

  /// The gradient at y of the potential without the planes that hold.
  [[nodiscard]] Vec3 gradient(const Vec3& y) const noexcept {
    const Terms& t = terms_;
    double gx = y.x() - problem_.spring.x();
    double gy = y.y() - problem_.spring.y();
    double gz = y.z() - problem_.spring.z();
#pragma omp simd reduction(+ : gx, gy, gz)
    for (std::size_t i = 0; i < t.count; ++i) {
      const double push = t.sigma[i] * t.u[2][i];
      gx += push * t.q[0][i];
      gy += push * t.q[1][i];
      gz += push * t.q[2][i];
    }
    return {gx, gy, gz};
  }

  /// The component of v across the normals that hold. Projected twice, as Gram and Schmidt need.
  [[nodiscard]] Vec3 across(Vec3 v) const noexcept {
    for (int twice = 0; twice < 2; ++twice) {
      for (std::size_t k = 0; k < held_; ++k) v -= basis_[k].dot(v) * basis_[k];
    }
    return v;
  }

  void hold(std::size_t i) noexcept {
    side(i) = 0.0;
    height(i) = 0.0;
    holder_[held_] = i;
    basis_[held_] = across(get(terms_.q, i)).normalized();
    ++held_;
  }

  /// The share of the step d that leads to the lowest place along it: past planes, to one that
  /// stops it, or to where the slope vanishes by itself.
  double fall(const Vec3& d, double slope) noexcept {
    const Terms& t = terms_;
    const double dx = d.x();
    const double dy = d.y();
    const double dz = d.z();
#pragma omp simd
    for (std::size_t i = 0; i < t.count; ++i) {
      t.u[1][i] = t.q[0][i] * dx + t.q[1][i] * dy + t.q[2][i] * dz;
    }
    // The planes on the step, and which of them it gets past: a weighted median, found by parting
    // them about one of them again and again.
    std::size_t count = 0;
    for (std::size_t i = 0; i < t.count; ++i) {
      const double toward = -side(i) * rate(i);
      const double off = side(i) * height(i);
      if (toward > 0.0 && off < toward) met_[count++] = {std::max(off, 0.0) / toward, i};
    }
    const auto less = [&](const Met& met) {
      return 2.0 * t.sigma[met.plane] * std::abs(rate(met.plane)) / slope;
    };
    double way = 1.0;  // the share of d at which the slope would vanish
    std::size_t stop = t.count;
    Met* first = met_.data();
    Met* last = first + count;
    constexpr int kMostPartings = 64;  // six are enough on average
    for (int parting = 0; first != last && parting < kMostPartings; ++parting) {
      const double at = first[(last - first) / 2].way;
      Met* const here = std::partition(first, last, [at](const Met& m) { return m.way < at; });
      Met* const beyond = std::partition(here, last, [at](const Met& m) { return m.way == at; });
      double before = 0.0;
      for (const Met* m = first; m != here; ++m) before += less(*m);
      if (way - before <= at) {
        last = here;  // the step does not come as far
        continue;
      }
      for (const Met* m = first; m != here; ++m) side(m->plane) = -side(m->plane);
      way -= before;
      for (first = here; first != beyond && stop == t.count; ++first) {
        way -= less(*first);
        if (way > at) {
          side(first->plane) = -side(first->plane);
        } else {
          stop = first->plane;
          way = at;
        }
      }
      if (stop != t.count) break;
    }
    for (std::size_t i = 0; i < t.count; ++i) height(i) += way * rate(i);
    for (std::size_t k = 0; k < held_; ++k) height(holder_[k]) = 0.0;
    if (stop < t.count) hold(stop);
    return way;
  }

  /// The forces of the planes that hold: sum of push_k q_k = -g, solved from the last plane on.
  [[nodiscard]] std::array<double, 3> pushes(const Vec3& g) const noexcept {
    std::array<double, 3> push{};
    Vec3 left = -g;
    for (std::size_t k = held_; k-- > 0;) {
      const Vec3 q = get(terms_.q, holder_[k]);
      push[k] = left.dot(basis_[k]) / q.dot(basis_[k]);
      left -= push[k] * q;
    }
    return push;
  }

  /// Releases the plane of the active set that would have to exert most beyond its strength; false
  /// where none would.
  bool letGo(const Vec3& g) noexcept {
    const std::array<double, 3> push = pushes(g);
    double worst = 64.0 * kEpsilon;
    std::size_t drop = held_;
    for (std::size_t k = 0; k < held_; ++k) {
      const double beyond = std::abs(push[k]) - terms_.sigma[holder_[k]];
      if (beyond > worst) {
        worst = beyond;
        drop = k;
      }
    }
    if (drop == held_) return false;
    side(holder_[drop]) = push[drop] > 0.0 ? 1.0 : -1.0;
    const std::array<std::size_t, 3> before = holder_;
    const std::size_t count = std::exchange(held_, 0);
    for (std::size_t k = 0; k < count; ++k) {
      if (k != drop) hold(before[k]);
    }
    return true;
  }

  /// Sets the multipliers of the present place, by sides and, where planes hold, by their forces.
  void speak(const Vec3& g) noexcept {
    const std::array<double, 3> push = pushes(g);
    for (std::size_t i = 0; i < terms_.count; ++i) set(terms_.z, i, side(i) * get(terms_.q, i));
    for (std::size_t k = 0; k < held_; ++k) {
      const double share = push[k] / terms_.sigma[holder_[k]];
      set(terms_.z, holder_[k], std::clamp(share, -1.0, 1.0) * get(terms_.q, holder_[k]));
    }
  }

  static constexpr int kMostPivots = 40;

  Problem& problem_;
  const Terms& terms_;
  /// A plane on the step, and the share of the step at which the step reaches it.
  struct Met {
    double way;
    std::size_t plane;
  };
  std::array<Met, kMaxPrimitives> met_;  ///< Scratch.
  std::array<std::size_t, 3> holder_{};
  std::array<Vec3, 3> basis_;  ///< The normals that hold, each made orthogonal to those before it.
  std::size_t held_ = 0;
  int pivots_ = 0;
};

/// True where the projectors annihilate each other, to rounding.
bool orthogonal(const Terms& terms) noexcept {
  constexpr double kNothing = 1e-30;
  for (std::size_t i = 1; i < terms.count; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      // One of two must be a plane, and the other's projector must take its normal to nothing.
      const std::size_t plane = terms.alpha[i] == 0.0 ? i : j;
      const std::size_t other = plane == i ? j : i;
      if (terms.alpha[plane] != 0.0) return false;
      if (project(terms, other, get(terms.q, plane)).squaredNorm() > kNothing) return false;
    }
  }
  return true;
}

/// The balance of orthogonal primitives, each of which acts as if it were alone: the soft
/// threshold, exact. This is where eq. (2) is right, and only here.
Vec3 balanceOrthogonal(const Problem& problem) noexcept {
  const Terms& terms = problem.terms;
  Vec3 pull = Vec3::Zero();
  for (std::size_t i = 0; i < terms.count; ++i) {
    const Vec3 d = project(terms, i, problem.spring) - get(terms.b, i);
    const double r = d.norm();
    // On its kink a primitive takes all of d, off it as much as its strength.
    pull += r > terms.sigma[i] ? Vec3((terms.sigma[i] / r) * d) : d;
    set(terms.z, i, d / std::max(r, terms.sigma[i]));
  }
  return problem.w - problem.length * pull;
}

/// The balance of a plane and one other primitive, as a surface with its friction or drag: the
/// commonest case of all, and a scalar equation. The plane's force a = sigma_plane zeta shifts the
/// spring's end for the other, whose balance is the soft threshold; the plane's own condition (y
/// before it: zeta = 1; on it: between; behind it: zeta = -1) is monotone in that force.
///
/// With e = P q, d the other's displacement from its kink before its own force acts, s = q.d, so
/// that a = (s_0 - s)/|e|^2 and |d|^2 = s^2/|e|^2 + aside^2, the height over the plane is
///
///     h(s) = h_0 - (1/|e|^2 - 1) (s_0 - s) + max(0, 1 - sigma/|d|) s,
///
/// s_0 and h_0 at a = 0: a line where the other holds (|d| <= sigma), beyond it convex on one side
/// and concave on the other.
class Pair {
 public:
  Pair(const Problem& problem, std::size_t plane, std::size_t other) noexcept
      : q_(get(problem.terms.q, plane)),
        foot_(q_.dot(get(problem.terms.b, plane))),
        most_(problem.terms.sigma[plane]),
        sigma_(problem.terms.sigma[other]),
        e_(project(problem.terms, other, q_)),
        d_(project(problem.terms, other, problem.spring) - get(problem.terms.b, other)),
        // A point's kink is one point, to the last digit.
        kink_(problem.terms.beta[other] == 0.0 ? get(problem.terms.b, other)
                                               : Vec3(problem.spring - d_)),
        e2_(e_.squaredNorm()),
        slope_(1.0 / e2_ - 1.0),
        s0_(e_.dot(d_)),
        h0_(q_.dot(kink_) - foot_),
        aside2_((d_ - (s0_ / e2_) * e_).squaredNorm()) {}

  /// Finds the plane's force, to a height of `enough`. Returns the heights evaluated.
  int solve(double enough) noexcept {
    double low = s0_ - most_ * e2_;
    double high = s0_ + most_ * e2_;
    int evaluations = 1;
    double s = low;
    if (height(low) < 0.0) {
      ++evaluations;
      s = high;
      if (height(high) > 0.0) {
        // The other primitive holds for s from -edge to edge.
        const double room = sigma_ * sigma_ - aside2_;
        const double edge = room > 0.0 ? std::sqrt(room * e2_) : 0.0;
        const double left = std::clamp(-edge, low, high);
        const double right = std::clamp(edge, low, high);
        if (held(right) < 0.0) {
          evaluations += slide(right, high, right, enough, s);
        } else if (held(left) > 0.0) {
          evaluations += slide(low, left, left, enough, s);
        } else {
          // A point holds whatever the plane does, where both kinks are one.
          s = slope_ > kEpsilon ? std::clamp(s0_ - h0_ / slope_, left, right) : left;
        }
      }
    }
    force_ = std::clamp((s0_ - s) / e2_, -most_, most_);
    return evaluations;
  }

  /// The proxy. Off the kink y - b keeps the direction of d to the last digit, however small.
  [[nodiscard]] Vec3 proxy() const noexcept {
    const Vec3 d = d_ - force_ * e_;
    const Vec3 kink = kink_ - force_ * (q_ - e_);
    const double r = d.norm();
    return r > sigma_ ? Vec3(kink + ((r - sigma_) / r) * d) : kink;
  }

  /// The multipliers of the plane and of the other primitive.
  [[nodiscard]] Vec3 planeMultiplier() const noexcept { return (force_ / most_) * q_; }
  [[nodiscard]] Vec3 otherMultiplier() const noexcept {
    const Vec3 d = d_ - force_ * e_;
    return d / std::max(d.norm(), sigma_);
  }

  /// Upper bound on |y - y*|: in the duality gap the other's term and the imbalance vanish. What
  /// rounding can hide in h counts: a point's kink is exact and q - e = 0, a line's or plane's not.
  [[nodiscard]] double bound(const Vec3& y) const noexcept {
    const double h = q_.dot(y) - foot_;
    const double lever = e_ == q_ ? 0.0 : std::abs(force_) + d_.norm();
    const double hidden = 4.0 * kEpsilon * (kink_.norm() + y.norm() + std::abs(foot_) + lever);
    return std::sqrt(2.0 * (most_ * (std::abs(h) + hidden) - force_ * h));
  }

 private:
  /// h(s) as long as the other holds.
  [[nodiscard]] double held(double s) const noexcept { return h0_ - slope_ * (s0_ - s); }
  [[nodiscard]] double distance(double s) const noexcept {
    return std::sqrt(s * s / e2_ + aside2_);
  }
  [[nodiscard]] double height(double s) const noexcept {
    return held(s) + (1.0 - sigma_ / std::max(distance(s), sigma_)) * s;
  }

  /// Newton from s within [low, high], h(low) <= 0 <= h(high), where h is convex or concave: it can
  /// overshoot but once. Returns the heights evaluated.
  int slide(double low, double high, double start, double enough, double& s) const noexcept {
    constexpr int kMost = 22;
    const double last_digit = kEpsilon * (std::abs(s0_) + most_ * e2_);
    s = start;
    for (int i = 1; i < kMost; ++i) {
      const double h = height(s);
      if (std::abs(h) <= enough) return i;
      (h > 0.0 ? high : low) = s;
      const double r = std::max(distance(s), sigma_);
      const double slope = slope_ + 1.0 - sigma_ * aside2_ / (r * r * r);
      double next = s - h / slope;
      if (!(next > low && next < high)) next = 0.5 * (low + high);
      if (std::abs(next - s) <= last_digit) return i;
      s = next;
    }
    return kMost;
  }

  Vec3 q_;
  double foot_;   ///< q.b of the plane
  double most_;   ///< sigma of the plane
  double sigma_;  ///< sigma of the other
  Vec3 e_;
  Vec3 d_;     ///< d at zero force of the plane
  Vec3 kink_;  ///< the other's kink nearest to the spring's end, at no force of the plane
  double e2_;
  double slope_;
  double s0_;
  double h0_;
  double aside2_;
  double force_ = 0.0;  ///< a
};

/// Tries Pair; false where neither is a plane, both are all but orthogonal, or the bound fails.
bool trySolvePair(const Problem& problem, const SolverParams& params,
                  SolveResult& result) noexcept {
  const std::size_t plane = problem.terms.alpha[0] == 0.0 ? 0 : 1;
  if (problem.terms.alpha[plane] != 0.0) return false;
  Pair pair(problem, plane, 1 - plane);
  const double enough = std::max(4.0 * kEpsilon, 0.01 * params.tolerance * params.tolerance);
  const int evaluations = pair.solve(enough);
  const Vec3 y = pair.proxy();
  const double bound = pair.bound(y);
  if (!(bound <= params.tolerance)) return false;
  result.iterations = evaluations;
  result.offset = problem.offset(y);
  result.error_bound = problem.length * bound;
  set(problem.terms.z, plane, pair.planeMultiplier());
  set(problem.terms.z, 1 - plane, pair.otherMultiplier());
  return true;
}

/// Normalises a nearly unit vector (isValid() saw to that) by two Newton steps, of which the first
/// is exact to 1e-12.
Vec3 unit(const Vec3& q) noexcept {
  const double once = 1.5 - 0.5 * q.squaredNorm();
  return (once * (1.5 - 0.5 * once * once * q.squaredNorm())) * q;
}

/// True where plane i and the next are opposed: same place and strength, opposite normals. Together
/// they are a slab, s |q.(x - x_i)|, one norm and no constant force.
bool slab(std::span<const Primitive> primitives, std::size_t i) noexcept {
  if (i + 1 >= primitives.size()) return false;
  const Primitive& a = primitives[i];
  const Primitive& b = primitives[i + 1];
  return a.kind == PrimitiveKind::kPlane && b.kind == PrimitiveKind::kPlane &&
         a.strength == b.strength && a.position == b.position && a.direction == -b.direction;
}

/// A primitive's strength as a norm [N]: max(0, t) = (t + |t|)/2, so a plane is half a directed
/// force and half a norm.
double share(const Primitive& primitive) noexcept {
  switch (primitive.kind) {
    case PrimitiveKind::kPoint:
    case PrimitiveKind::kLine:
      return primitive.strength;
    case PrimitiveKind::kPlane:
      return 0.5 * primitive.strength;
    case PrimitiveKind::kForce:
      break;
  }
  return 0.0;
}

/// What makeProblem returns besides the problem.
struct Remainder {
  Vec3 origin = Vec3::Zero();  ///< origin of the terms, from the probe [m]
  double bound = 0.0;          ///< what rounding and primitives left out can move the answer by [m]
};

/// Eqs (8) to (13), dimensionless: `terms` is empty where nothing but directed forces is left.
Problem makeProblem(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                    const Terms& storage, Remainder& remainder) noexcept {
  Problem problem;
  problem.terms = storage;

  // Sizes that enter the bound on rounding [m]: the largest distance, and the sum of the directed
  // forces before they cancel, divided by k.
  const double per_stiffness = 1.0 / stiffness;
  double sum = 0.0;
  double reach = 0.0;
  double pushed = 0.0;
  double pushes = 0.0;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    if (!(p.strength > 0.0)) continue;
    const bool both = slab(primitives, i);
    const double norm = both ? p.strength : share(p);
    const double force = p.strength - norm;
    sum += norm;
    if (force > 0.0) {
      problem.w += (force * per_stiffness) * unit(p.direction);
      pushed += force * per_stiffness;
      pushes += 1.0;
    }
    if (norm > 0.0) reach = std::max(reach, (p.position - probe).lpNorm<Eigen::Infinity>());
    if (both) ++i;
  }
  problem.length = sum * per_stiffness;
  remainder.bound = 8.0 * kEpsilon * (reach + problem.length) + (8.0 + pushes) * kEpsilon * pushed;

  // Strengths that cannot move the proxy beyond rounding enter the bound only.
  if (problem.length <= remainder.bound || problem.length < std::numeric_limits<double>::min()) {
    remainder.bound += problem.length;
    return problem;
  }

  // The origin is the nearest anchor that the proxy can reach, so that kinks that share an anchor
  // do so to the last digit; where all are farther than T/k, it is the spring's end.
  // Primitives may be too weak to matter beside the rest: what they can move goes into the bound.
  constexpr double kNothing = 1e-20;
  Terms& terms = problem.terms;
  remainder.origin = problem.w;
  double nearest = problem.length * problem.length;
  const double per_sum = 1.0 / sum;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    const bool both = slab(primitives, i);
    const double norm = both ? p.strength : share(p);
    const std::size_t source = i;
    if (both) ++i;
    if (!(norm > 0.0)) continue;
    if (norm < kNothing * sum) {
      remainder.bound += kNothing * problem.length;
      continue;
    }
    const bool plane = p.kind == PrimitiveKind::kPlane;
    const bool point = p.kind == PrimitiveKind::kPoint;
    const Vec3 anchor = p.position - probe;
    const double distance = (anchor - problem.w).squaredNorm();
    if (distance < nearest) {
      nearest = distance;
      remainder.origin = anchor;
    }
    const std::size_t n = terms.count++;
    terms.source[n] = source;
    terms.sigma[n] = norm * per_sum;
    terms.alpha[n] = plane ? 0.0 : 1.0;
    terms.beta[n] = plane ? 1.0 : (point ? 0.0 : -1.0);
    set(terms.q, n, point ? Vec3(Vec3::Zero()) : unit(p.direction));
    set(terms.b, n, anchor);
  }
  const double per_length = 1.0 / problem.length;
  terms.placeFeet(remainder.origin, per_length);
  problem.spring = per_length * (problem.w - remainder.origin);
  return problem;
}

/// Balances two or more primitives that are not orthogonal, nor a plane and one other.
void balanceGeneral(Problem& problem, const Vec3& guess, std::size_t count,
                    const SolverParams& params, WarmStart* warm, SolveResult& result) noexcept {
  result.solver = SolverKind::kGeneral;
  const Terms& terms = problem.terms;
  Search search(problem, params);
  Vec3 from = guess;
  bool done = false;
  int pivots = 0;
  if (Pivots::fits(terms)) {
    Pivots planes(problem);
    const bool known = warm != nullptr && warm->count == count && guess.allFinite();
    Vec3 y = known ? guess : problem.spring;
    const bool solved = planes.solve(y);
    done = search.prove(y);
    if (solved && !done) {
      search.moveOrigin(y);
      from -= y;
      done = search.prove(planes.onHeld());
    }
    pivots = planes.pivots();
  }
  if (!done && warm != nullptr && warm->count == count && guess.allFinite()) {
    for (std::size_t i = 0; i < terms.count; ++i) {
      set(terms.z, i, warm->multipliers[terms.source[i]]);
    }
    problem.terms.turnMultipliers();
    done = search.warm(from);
  }
  if (!done) done = search.cold();
  if (!done) result.status = SolveStatus::kIterationLimit;
  result.iterations = pivots + search.solves();
  result.offset = search.offset();
  result.error_bound = search.bound();
  if (warm == nullptr) return;
  warm->count = done ? count : 0;
  for (std::size_t i = 0; done && i < terms.count; ++i) {
    warm->multipliers[terms.source[i]] = get(terms.z, i);
  }
}

/// What each primitive does to the proxy [N]: its constant part, and -sigma z in newtons.
void writeForces(const Terms& terms, std::span<const Primitive> primitives,
                 std::span<Vec3> forces) noexcept {
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    const double constant = p.strength - share(p);
    const bool pushes = p.kind == PrimitiveKind::kForce || p.kind == PrimitiveKind::kPlane;
    forces[i] = pushes ? Vec3(constant * unit(p.direction)) : Vec3(Vec3::Zero());
  }
  for (std::size_t i = 0; i < terms.count; ++i) {
    const std::size_t source = terms.source[i];
    const Primitive& p = primitives[source];
    const Vec3 z = get(terms.z, i);
    if (slab(primitives, source)) {
      // The plane that the proxy is pressed against carries the load.
      forces[source] = forces[source + 1] = Vec3::Zero();
      forces[p.direction.dot(z) > 0.0 ? source + 1 : source] = -p.strength * z;
    } else {
      forces[source] -= share(p) * z;
    }
  }
}

/// The balance, by the first method that fits.
template <std::size_t Capacity>
void balance(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
             const Vec3& start, const SolverParams& params, WarmStart* warm, std::span<Vec3> forces,
             SolveResult& result) noexcept {
  Storage<Capacity> storage;
  Remainder remainder;
  Problem problem = makeProblem(probe, stiffness, primitives, storage.view(), remainder);
  const std::size_t count = problem.terms.count;
  // No tighter tolerance is asked for than the input's own rounding allows.
  SolverParams wanted = params;
  const double least = remainder.bound / problem.length;
  wanted.tolerance = params.tolerance > least ? params.tolerance : least;

  if (count == 0) {
    result.offset = problem.w;
  } else if (count <= 3 && orthogonal(problem.terms)) {
    result.offset = balanceOrthogonal(problem);
  } else if (count == 2 && trySolvePair(problem, wanted, result)) {
    result.solver = SolverKind::kPair;
  } else {
    // The proxy is expected to move as it did last time.
    Vec3 guess = Vec3::Zero();
    if (warm != nullptr) guess = start - probe + warm->motion - remainder.origin;
    balanceGeneral(problem, guess / problem.length, primitives.size(), wanted, warm, result);
  }
  result.error_bound += remainder.bound;
  if (!forces.empty()) writeForces(problem.terms, primitives, forces);
  if (warm == nullptr) return;
  if (result.solver != SolverKind::kGeneral) warm->forget();
  warm->motion = probe + result.offset - start;
}

/// The balance of no primitive or one, before anything is set up: most ticks need no more.
SolveResult balanceFew(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                       const Vec3& start, WarmStart* warm, std::span<Vec3> forces) noexcept {
  SolveResult result;
  if (!primitives.empty()) {
    const Primitive& p = primitives[0];
    const double most = p.strength / stiffness;
    const bool free = p.kind == PrimitiveKind::kForce;
    Vec3 to = free ? Vec3(Vec3::Zero()) : Vec3(p.position - probe);
    const double reach = to.lpNorm<Eigen::Infinity>();
    const Vec3 q = p.kind == PrimitiveKind::kPoint ? Vec3(Vec3::Zero()) : unit(p.direction);
    if (free) {
      result.offset = most * q;
    } else if (p.kind == PrimitiveKind::kPlane) {
      result.offset = std::clamp(q.dot(to), 0.0, most) * q;
    } else {
      to -= q.dot(to) * q;
      const double far = to.norm();
      result.offset = far > most ? Vec3((most / far) * to) : to;
    }
    result.error_bound = 8.0 * kEpsilon * (reach + most);
    if (!forces.empty()) forces[0] = stiffness * result.offset;
  }
  if (warm != nullptr) {
    warm->forget();
    warm->motion = probe + result.offset - start;
  }
  return result;
}

}  // namespace

SolveResult solveProxy(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                       const Vec3& start, const SolverParams& params, WarmStart* warm,
                       std::span<Vec3> forces) noexcept {
  constexpr std::size_t kFew = 16;
  SolveResult result;
  const bool good = probe.allFinite() && std::isfinite(stiffness) && stiffness > 0.0 &&
                    primitives.size() <= kMaxPrimitives &&
                    (forces.empty() || forces.size() >= primitives.size()) &&
                    std::all_of(primitives.begin(), primitives.end(), isValid);
  if (warm != nullptr && warm->multipliers.size() < primitives.size()) warm = nullptr;
  if (good) {
    // Most ticks balance a few primitives: their terms fit into a few cache lines of stack.
    if (primitives.size() <= 1) {
      result = balanceFew(probe, stiffness, primitives, start, warm, forces);
    } else if (primitives.size() <= kFew) {
      balance<kFew>(probe, stiffness, primitives, start, params, warm, forces, result);
    } else {
      balance<kMaxPrimitives>(probe, stiffness, primitives, start, params, warm, forces, result);
    }
  }
  // Sums and quotients of finite numbers can still overflow.
  if (!good || !result.offset.allFinite() || !std::isfinite(result.error_bound)) {
    result = {};
    result.status = SolveStatus::kBadInput;
    result.error_bound = std::numeric_limits<double>::infinity();
    if (warm != nullptr) warm->forget();
    result.proxy = start;
    result.offset = start - probe;
    if (!result.offset.allFinite()) result.offset.setZero();
    return result;
  }
  result.proxy = probe + result.offset;
  return result;
}

}  // namespace palpate
