#include "palpate/engine/safety/passivity.h"

#include <algorithm>
#include <cmath>

namespace palpate {

/// The output of the amplifier, which follows each sent force with a first-order lag.
struct Tank::Amplifier {
  Acting now;
  double lag;  ///< [s]

  /// Advances by a time [s] of constant `order` [N], and adds the acting force to `acted`.
  void hold(const Vec3& order, double time, Acted& acted) noexcept {
    if (time <= 0.0) return;
    const double square = order.squaredNorm();
    const double left = lag > 0.0 ? std::exp(-time / lag) : 0.0;
    const double behind = lag * (1.0 - left);
    acted.force += time * order + behind * (now.force - order);
    acted.square += time * square + behind * (now.square - square);
    now.force = order + left * (now.force - order);
    // Upper bound, because the square of a mean is at most the mean of the squares.
    now.square = square + left * (now.square - square);
  }
};

void Tank::forget() noexcept {
  sure_ = 0.0;
  counted_ = 0.0;
  known_ = false;
  recovers_ = true;
  since_ = {};
  span_ = 0.0;
  mean_.setZero();
  acting_ = {};
  recent_ = 0.0;
  count_ = 1;
  sent_[0] = {};
}

void Tank::refill(double energy) noexcept {
  if (!(energy > 0.0) || !std::isfinite(energy)) return;
  sure_ += energy;
  counted_ += energy;
  refilled_ += energy;
}

void Tank::elapse(double dt, const ArmDissipation& arm) noexcept {
  if (arm.doubt > 0.0) elapseDoubt(dt, arm);
  Amplifier amplifier{acting_, arm.lag};
  Acted acted;
  double at = 0.0;
  std::size_t past = 0;  // number of forces no longer needed
  for (std::size_t i = 0; i < count_; ++i) {
    const bool last = i + 1 == count_;
    const double until = last ? dt : std::clamp(sent_[i + 1].from, at, dt);
    amplifier.hold(sent_[i].force, until - at, acted);
    at = until;
    if (!last && sent_[i + 1].from + arm.doubt < dt) past = i + 1;
  }
  acting_ = amplifier.now;
  for (std::size_t i = past; i < count_; ++i) {
    sent_[i - past] = sent_[i];
    sent_[i - past].from -= dt;
  }
  count_ -= past;
  since_.force += acted.force;
  since_.square += acted.square;
  span_ += dt;
  // No motion can have taken out more energy: the maximum of F v - b v^2 over v is F^2 / (4 b).
  sure_ -= acted.square / (4.0 * arm.viscous);
}

void Tank::elapseDoubt(double dt, const ArmDissipation& arm) noexcept {
  const auto left = [&](double time) { return arm.lag > 0.0 ? std::exp(-time / arm.lag) : 0.0; };
  Acting then{};
  then.change = acting_.change * left(dt);
  then.jump = acting_.jump * left(dt);
  double ordered = 0.0;
  double most = acting_.change;
  double square = std::max(acting_.square, sent_[0].force.squaredNorm()) + acting_.jump;
  for (std::size_t i = 1; i < count_; ++i) {
    const double from = std::clamp(sent_[i].from - arm.doubt, 0.0, dt);
    const double to = std::clamp(sent_[i].from + arm.doubt, 0.0, dt);
    if (!(to > from)) continue;
    const double share = arm.lag > 0.0 ? left(dt - to) - left(dt - from) : 0.0;
    ordered += (to - from) * sent_[i].change;
    most += sent_[i].change;
    square += sent_[i].jump;
    then.change += share * sent_[i].change;
    then.jump += share * sent_[i].jump;
  }
  since_.change += ordered - arm.lag * (then.change - acting_.change);
  since_.most = std::max(since_.most, most);
  // An earlier change of the force is counted in Acting::jump or certainly complete.
  recent_ = dt < 2.0 * arm.jitter ? std::max(recent_, square) : square;
  acting_.change = then.change;
  acting_.jump = then.jump;
}

void Tank::arrive(const Vec3& hand, const ArmDissipation& arm) noexcept {
  if (!(span_ > 0.0)) return;
  // The mean force does work over the path. A hand that moves with the variation of the force about
  // its mean could gain further energy, but the damping b limits that gain.
  const Vec3 mean = since_.force / span_;
  const Vec3 moved = hand - last_;
  const double way = moved.norm();
  // If the time between the readings was longer than span_, friction has dissipated less.
  const double viscous = arm.viscous * span_ / (span_ + 2.0 * arm.jitter);
  double varies = std::max(0.0, since_.square - span_ * mean.squaredNorm());
  if (since_.change > 0.0) {
    // Because the delays are uncertain, the variation of the force may have been this large.
    const double other = std::sqrt(varies) + std::sqrt(since_.change * since_.most);
    varies = other * other;
    counted_ -= since_.change / span_ * (way + arm.step);
  }
  // Forces are those on the hand; the hand puts in the negative of their work.
  counted_ -= mean.dot(moved) + varies / (4.0 * viscous) + 0.5 * arm.step * (mean - mean_).norm();
  const double surely = std::max(0.0, way - arm.step);
  counted_ += viscous / span_ * surely * surely;
  // Coulomb friction: each position is known only to D/2. Let the hand drag an anchor on a rope of
  // length D. The path of the hand is at least the anchor's path times the cosine of 30 degrees.
  const Vec3 rope = hand - anchor_;
  const double length = rope.norm();
  if (length > arm.step) {
    const double certain = arm.step > 0.0 ? 0.5 * std::sqrt(3.0) : 1.0;
    counted_ += certain * arm.coulomb * (length - arm.step);
    anchor_ += (1.0 - arm.step / length) * rope;
  }
  mean_ = mean;
  last_ = hand;
  since_ = {};
  span_ = 0.0;
}

double Tank::certain(const ArmDissipation& arm) const noexcept {
  // Deducts the largest possible cost of forces and readings at other times than assumed.
  double later = arm.lag * acting_.jump + arm.jitter * recent_;
  for (std::size_t i = 1; i < count_; ++i) later += arm.doubt * sent_[i].jump;
  return counted_ - 0.5 * arm.step * mean_.norm() - later / (4.0 * arm.viscous);
}

double Tank::reserve(const Vec3& next, const ArmDissipation& arm) const noexcept {
  Amplifier amplifier{acting_, arm.lag};
  Acted acted;
  const double begins = std::max(arm.delay, sent_[count_ - 1].from);
  double at = 0.0;
  for (std::size_t i = 0; i < count_; ++i) {
    const double until = std::max(at, i + 1 < count_ ? sent_[i + 1].from : begins);
    amplifier.hold(sent_[i].force, until - at, acted);
    at = until;
  }
  amplifier.hold(next, arm.period, acted);
  // Finally the output of the amplifier decays with its lag. `next` may begin earlier or later by
  // `doubt`. Earlier forces have already paid for their uncertainty.
  const double square = next.squaredNorm();
  const double jumps = std::abs(square - sent_[count_ - 1].force.squaredNorm()) + square;
  return (acted.square + arm.lag * amplifier.now.square + arm.doubt * jumps) / (4.0 * arm.viscous);
}

void Tank::send(const Vec3& force, const ArmDissipation& arm) noexcept {
  const Vec3& before = sent_[count_ - 1].force;
  const SentForce sent{force, std::max(arm.delay, sent_[count_ - 1].from), (force - before).norm(),
                       std::abs(force.squaredNorm() - before.squaredNorm())};
  sure_ -= arm.doubt * sent.jump / (4.0 * arm.viscous);
  if (arm.delay > 0.0) {
    sent_[count_++] = sent;
  } else {
    sent_[0] = sent;
    count_ = 1;
  }
}

void Tank::weaken(double share, const ArmDissipation& arm) noexcept {
  if (!(share >= 0.0 && share < 1.0) || !(arm.viscous > 0.0)) return;
  SentForce& sent = sent_[count_ - 1];
  sent.force *= share;
  if (count_ == 1) return;
  const Vec3& before = sent_[count_ - 2].force;
  const double jump = std::abs(sent.force.squaredNorm() - before.squaredNorm());
  sure_ -= arm.doubt * (jump - sent.jump) / (4.0 * arm.viscous);
  sent.change = (sent.force - before).norm();
  sent.jump = jump;
}

double Tank::pass(const Vec3& wanted, const Vec3& hand, bool fresh, double dt,
                  const TankParams& params, double cap) noexcept {
  const ArmDissipation& arm = params.arm;
  if (params.use == TankUse::kOff) return 1.0;
  const bool acts = params.use == TankUse::kAct;
  constexpr double kFarthest = 1e6;  // [m]: positions beyond this are invalid
  if (!(hand.cwiseAbs().maxCoeff() < kFarthest) || !(arm.viscous > 0.0) || !(arm.period > 0.0)) {
    forget();
    return acts ? 0.0 : 1.0;
  }
  constexpr double kShortest = 1e-9;  // [s]: a shorter time step counts as zero
  const bool timed = dt > kShortest && std::isfinite(dt);
  const bool recovers = recovers_;
  if (recovers) {
    constexpr double kDead = 25.0;  // number of lags after which a force is over
    recovers_ = false;
    blind_ = arm.delay + arm.doubt + 2.0 * arm.jitter + kDead * arm.lag;
  }
  if (timed) elapse(dt, arm);
  if (!known_) {
    // The tank credits no energy until the zero that is sent now acts, because an unknown force may
    // act until then. After forget() the last position is unknown, because the hand left it at an
    // unknown time, or the arm was not homed.
    if (timed && !recovers) blind_ -= dt;
    known_ = fresh && !recovers && blind_ <= 0.0;
    last_ = anchor_ = hand;
    sure_ = std::min(sure_, 0.0);
    counted_ = sure_;
    since_ = {};
    span_ = 0.0;
    mean_ = acting_.force;
    if (!known_ && acts) {
      sent_[0] = {};
      count_ = 1;
      sure_ = counted_ = 0.0;
      return 0.0;
    }
  } else if (timed && fresh) {
    arrive(hand, arm);
    counted_ = std::min(counted_, cap);
    sure_ = std::max(sure_, certain(arm));
  }
  sure_ = std::min(sure_, cap);
  if (!std::isfinite(sure_ + counted_) || count_ == kForces) {
    // After an overflow, or if sent_ is full, the tank restarts without forces on their way.
    forget();
    return acts ? 0.0 : 1.0;
  }
  double share = 1.0;
  // If the reserve is NaN, the force must be reduced too.
  if (!(reserve(wanted, arm) <= sure_)) {
    // The reserve grows with the share. Bisection finds the largest share that is paid for.
    double more = 1.0;
    share = 0.0;
    constexpr int kHalvings = 30;
    for (int i = 0; i < kHalvings; ++i) {
      const double middle = 0.5 * (share + more);
      (reserve(middle * wanted, arm) <= sure_ ? share : more) = middle;
    }
    const double owed = acts && share == 0.0 ? reserve(Vec3::Zero(), arm) - sure_ : 0.0;
    if (owed > 1e-15) {  // rounding is not a debt
      debt_ += owed;
      counted_ += owed;
      sure_ += owed;
    }
  }
  const Vec3 scaled = share > 0.0 ? Vec3(share * wanted) : Vec3(Vec3::Zero());
  send(acts ? scaled : wanted, arm);
  return share;
}

}  // namespace palpate
