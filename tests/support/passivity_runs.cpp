#include "tests/support/passivity_runs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <random>

#include <Eigen/Geometry>

#include "tests/support/passivity_observer.h"

namespace palpate::bench {

namespace {

constexpr int kPieces = 4;      // number of straight pieces of the hand's path per tick
constexpr double kSoft = 25.0;  // stiffness that sets the tank's capacity [N/m]

/// Returns a hash of an integer as a number in [0, 1).
double hashed(std::uint64_t a) noexcept {
  a ^= a >> 33U;
  a *= 0xff51afd7ed558ccdULL;
  a ^= a >> 33U;
  a *= 0xc4ceb9fe1a85ec53ULL;
  a ^= a >> 33U;
  return static_cast<double>(a >> 11U) / 9007199254740992.0;
}

class Draw {
 public:
  explicit Draw(std::uint64_t seed) : random_(seed) {}
  double uniform(double a, double b) { return a + (b - a) * unit_(random_); }
  double log(double a, double b) { return std::exp(uniform(std::log(a), std::log(b))); }
  Vec3 direction() {
    const double z = uniform(-1.0, 1.0);
    const double turn = uniform(0.0, 2.0 * M_PI);
    const double r = std::sqrt(std::max(0.0, 1.0 - z * z));
    return {r * std::cos(turn), r * std::sin(turn), z};
  }

 private:
  std::mt19937_64 random_;
  std::uniform_real_distribution<double> unit_{0.0, 1.0};
};

/// Delays and low-passes forces as an arm's amplifiers do. Shares no code with the tank.
class Wire {
 public:
  Wire(double delay, double lag) : delay_(delay), lag_(lag) {}
  /// Sends a force with an additional delay `off` [s]. Forces arrive in the order of sending.
  void send(const Vec3& force, double now, double off) {
    last_ = std::max(last_, now + delay_ + off);
    orders_.push_back({last_, force});
  }
  /// Returns the integral of the force over `time`, from `now` on [N s].
  Vec3 over(double now, double time) {
    Vec3 sum = Vec3::Zero();
    const double end = now + time;
    while (now < end) {
      while (!orders_.empty() && orders_.front().first <= now) {
        order_ = orders_.front().second;
        orders_.pop_front();
      }
      const double until = orders_.empty() ? end : std::min(end, orders_.front().first);
      const double held = until - now;
      if (lag_ > 0.0) {
        const Vec3 before = force_;
        force_ = order_ + std::exp(-held / lag_) * (before - order_);
        sum += held * order_ + lag_ * (before - force_);
      } else {
        force_ = order_;
        sum += held * order_;
      }
      now = until;
    }
    return sum;
  }

 private:
  double delay_, lag_;
  double last_ = 0.0;
  std::deque<std::pair<double, Vec3>> orders_;
  Vec3 order_ = Vec3::Zero();
  Vec3 force_ = Vec3::Zero();
};

/// Computes the scene's force on the hand.
class Scene {
 public:
  Scene(const PassivityRun& run, Draw& draw)
      : run_(run), normal_(draw.direction()), across_(normal_.unitOrthogonal()) {}

  [[nodiscard]] const Vec3& normal() const { return normal_; }
  Vec3 at(const Vec3& hand, const Vec3& velocity, double time) {
    const double in = normal_.dot(hand);  // > 0: inside
    const double speed = normal_.dot(velocity);
    filtered_ = 0.7 * filtered_ + 0.3 * speed;
    const double k = run_.stiffness;
    Vec3 force = Vec3::Zero();
    switch (run_.scene) {
      case ActiveScene::kWall:
        if (in > 0.0) force = -std::max(0.0, k * in + run_.damping * speed) * normal_;
        break;
      case ActiveScene::kWaves:
        force = run_.amplitude * std::sin(run_.wave * in) * (normal_ + across_);
        break;
      case ActiveScene::kUndamped:
        force = (0.2 * run_.damping * filtered_ - (in > 0.0 ? k * in : 0.0)) * normal_;
        break;
      case ActiveScene::kNoise: {
        const auto cell = static_cast<std::int64_t>(std::floor(in * run_.wave));
        const auto era = static_cast<std::int64_t>(10.0 * time);
        const auto any = [&](std::uint64_t axis) {
          return 2.0 * hashed(run_.seed + axis + static_cast<std::uint64_t>(cell) * 7919U +
                              static_cast<std::uint64_t>(era) * 104729U) -
                 1.0;
        };
        force = run_.amplitude * Vec3(any(1), any(2), any(3));
        break;
      }
      case ActiveScene::kMoving: {
        const double wall = 0.004 * std::sin(0.02 * run_.wave * time + 1.0);
        if (in > wall) force = -k * (in - wall) * normal_;
        break;
      }
      case ActiveScene::kSticky:
        if (in > 0.0) force = -(speed < 0.0 ? 1.5 : 1.0) * k * in * normal_;
        break;
      case ActiveScene::kAppearing:
        if (time > 0.3 && in > -0.003) force = -0.3 * k * (in + 0.003) * normal_;
        break;
      case ActiveScene::kWhirl:
        force = run_.stiffness * normal_.cross(hand);
        break;
    }
    const double size = force.norm();
    return size > run_.peak ? Vec3(run_.peak / size * force) : force;
  }

 private:
  const PassivityRun& run_;
  Vec3 normal_, across_;
  double filtered_ = 0.0;
};

/// Returns the deviation of a delay, from -1 (earliest) to 1 (latest). It is constant, random,
/// alternating, or depends on whether the force grows.
double howLate(std::uint64_t kind, long tick, bool grows, Draw& draw) {
  const double either = draw.uniform(-1.0, 1.0);
  switch (kind % 6) {
    case 0:
      return 1.0;
    case 1:
      return -1.0;
    case 2:
      return tick % 2 == 0 ? 1.0 : -1.0;
    case 3:
      return grows ? -1.0 : 1.0;
    case 4:
      return grows ? 1.0 : -1.0;
    default:
      return either;
  }
}

/// Returns the position at a time, by interpolation of positions at ascending times. Drops
/// positions that are no longer needed.
Vec3 placeAt(std::deque<std::pair<double, Vec3>>& past, double time) {
  while (past.size() > 2 && past[1].first <= time) past.pop_front();
  const auto& [from, a] = past[0];
  const auto& [to, b] = past[1];
  const double share = std::clamp((time - from) / (to - from), 0.0, 1.0);
  return a + share * (b - a);
}

/// Returns the path in this tick of a hand that knows the whole state: along the force, at about
/// the best speed against friction, or over encoder steps, or at random.
Vec3 worstWay(const PassivityRun& run, const Vec3& x, const Vec3& force, double time, double mood,
              Draw& draw) {
  const Vec3 best = time / (2.0 * run.viscous) * force;
  const double d = run.encoder;
  if (mood < 0.4) {
    Vec3 way = draw.uniform(0.5, 1.2) * best;
    const double luck = draw.uniform(0.0, 1.0);
    if (luck < 0.3) way += draw.uniform(-1.0, 1.0) * d * draw.direction();
    if (luck > 0.95)
      way = draw.uniform(-3.0, 3.0) * run.peak * time / (2.0 * run.viscous) * draw.direction();
    return way;
  }
  if (mood < 0.8) {
    // Moves each axis to just before or just after the position at which its reading changes.
    Vec3 way;
    for (int a = 0; a < 3; ++a) {
      const double edge = (std::floor(x[a] / d + 0.5) + (force[a] > 0.0 ? 0.5 : -0.5)) * d;
      const double luck = draw.uniform(0.0, 1.0);
      way[a] = edge + (force[a] > 0.0 ? -1e-3 : 1e-3) * d - x[a];
      if (luck < 0.2 || std::abs(way[a]) < 1e-2 * d) {
        way[a] = (luck < 0.1 ? 1.0 : -1.0) * draw.uniform(0.0, 2.0) * d;
      }
    }
    return way;
  }
  return draw.uniform(0.0, 1.0) < 0.5 ? best : Vec3(draw.uniform(-3.0, 3.0) * d * draw.direction());
}

}  // namespace

PassivityRun randomRun(std::uint64_t seed, bool fractional) {
  Draw draw(seed * 2654435761U + 12345U);
  PassivityRun run;
  run.seed = seed;
  run.mass = draw.log(0.05, 0.5);
  run.viscous = draw.log(0.05, 5.0);
  run.coulomb = draw.uniform(0, 1) < 0.2 ? 0.0 : draw.log(0.003, 0.5);
  run.encoder = draw.log(1e-7, 1e-4);
  run.period = draw.uniform(0, 1) < 0.9 ? 1e-3 : 2.5e-4;
  const double whole = draw.uniform(0, 1) < 0.5 ? 0.0 : std::floor(draw.uniform(0, 4));
  const double part = fractional && draw.uniform(0, 1) < 0.5 ? draw.uniform(0.05, 0.95) : 0.0;
  run.delay = (whole + part) * run.period;
  if (draw.uniform(0, 1) < 0.75) {
    run.grip = draw.log(20.0, 1000.0);
    run.grip_damping = draw.log(0.3, 15.0);
  }
  if (draw.uniform(0, 1) < 0.3) run.release = draw.uniform(0.2, 2.0);
  run.peak = draw.log(1.0, 10.0);
  run.known_viscous = draw.uniform(0.7, 1.0);
  run.known_coulomb = draw.uniform(0.7, 1.0);
  run.scene = static_cast<ActiveScene>(static_cast<int>(draw.uniform(0, kActiveScenes)));
  run.stiffness = draw.log(50.0, 5e4);
  run.damping = draw.uniform(0, 1) < 0.4 ? 0.0 : draw.log(0.1, 50.0);
  run.wave = draw.log(200.0, 2e4);
  run.amplitude = draw.uniform(0.2, 1.0) * run.peak;
  return run;
}

namespace {

/// Returns a value from `least` to `most`. Its logarithm is uniform over the seeds.
double within(double least, double most, std::uint64_t seed, std::uint64_t cycle) {
  const double share = static_cast<double>(seed % cycle) / static_cast<double>(cycle);
  return least * std::pow(most / least, share);
}

}  // namespace

void letLag(PassivityRun& run) {
  run.lag = run.period * within(0.03, 3.0, run.seed, 101);
}

void doubtDelay(PassivityRun& run) {
  run.doubt = run.period * within(0.03, 3.0, run.seed, 103);
  run.delay = std::max(run.delay, run.doubt);
  if (run.seed % 4 < 2) run.lag = 0.2 * run.period;
}

void shakeReadings(PassivityRun& run) {
  run.reading_jitter = 0.5 * run.period * within(0.03, 1.0, run.seed, 97);
}

void forgetOften(PassivityRun& run) {
  run.every = 1 + static_cast<int>(run.seed % 8);
  run.forgets = within(0.003, 0.3, run.seed, 89);
  run.away = static_cast<int>(run.seed / 8 % 4);
}

namespace {

/// Decides, tick by tick, when the tank is reset.
class Interruptions {
 public:
  explicit Interruptions(const PassivityRun& run) : run_(run) {}

  enum class What : std::uint8_t {
    kNone,
    kForget,  ///< The tank is reset, then passes a force.
    kZero,    ///< The tank is reset, and a zero force is sent.
  };
  What next(Draw& draw) {
    // Without resets, draws no random number, so that the other random numbers stay the same.
    if (!(run_.forgets > 0.0)) return What::kNone;
    if (left_ == 0 && draw.uniform(0, 1) < run_.forgets) {
      left_ = 1 + static_cast<int>(draw.uniform(0.0, run_.away + 1.0));
    }
    if (left_ == 0) return What::kNone;
    return --left_ == 0 ? What::kForget : What::kZero;
  }

 private:
  const PassivityRun& run_;
  int left_ = 0;
};

}  // namespace

PassivityResult play(const PassivityRun& run, Keeper keeper) {
  Draw draw(run.seed + 99);
  Scene scene(run, draw);
  Wire wire(run.delay, run.lag);
  TankParams params;
  params.use = TankUse::kAct;
  params.arm.viscous = run.known_viscous * run.viscous;
  params.arm.coulomb = run.known_coulomb * run.coulomb;
  params.arm.step = std::sqrt(3.0) * run.encoder;
  params.arm.delay = run.delay;
  params.arm.doubt = run.tells_doubt ? run.doubt : 0.0;
  if (run.tells_doubt) {
    params.arm.delay += run.reading_jitter;
    params.arm.doubt += run.reading_jitter;
    params.arm.jitter = run.reading_jitter;
  }
  params.arm.lag = run.lag;
  params.arm.period = run.period;
  const double cap = run.peak * run.peak / (2.0 * kSoft);
  Tank tank;
  methods::PassivityObserver observer;

  // The hand starts outside: inside a wall, the force would need energy that the hand has not put
  // in.
  Vec3 x = 1e-3 * draw.direction() - 2e-3 * scene.normal();
  Vec3 v = draw.uniform(0.0, 0.6) * draw.direction();
  std::array<Vec3, 3> swing;
  std::array<double, 3> turning{};
  for (std::size_t i = 0; i < 3; ++i) {
    swing[i] = draw.log(1e-4, 8e-3) * draw.direction();
    turning[i] = 2.0 * M_PI * draw.log(0.3, 6.0);
  }
  const Vec3 tremor = (draw.uniform(0, 1) < 0.5 ? 0.0 : draw.log(1e-5, 3e-4)) * draw.direction();
  double mood = draw.uniform(0, 1);

  PassivityResult result;
  double energy = 0.0;
  double time = 0.0;
  double dt = run.period;
  std::deque<std::pair<double, Vec3>> past{{-1.0, x}, {0.0, x}};
  Vec3 read = x;
  Vec3 before = x;
  Vec3 mean = Vec3::Zero();  // mean force over the present tick
  Vec3 gone = Vec3::Zero();  // force sent in the last tick
  long ticks = 0;
  long scaled = 0;
  double asked = 0.0;
  double lost = 0.0;
  Interruptions interruptions(run);
  using What = Interruptions::What;
  result.spare = std::numeric_limits<double>::infinity();
  for (; time < run.seconds; ++ticks) {
    const bool fresh = ticks % run.every == 0;
    if (fresh) {
      Vec3 at = x;
      if (run.reading_jitter > 0.0) {
        const double off = howLate(run.seed / 6, ticks, false, draw);
        at = placeAt(past, time - run.reading_jitter * (1.0 + off));
      }
      read = (at / run.encoder).array().round().matrix() * run.encoder;
    }
    const Vec3 wanted =
        scene.at(read, ticks > 0 ? Vec3((read - before) / dt) : Vec3(Vec3::Zero()), time);
    before = read;
    Vec3 sent = wanted;
    if (keeper == Keeper::kObserver) sent = observer.control(wanted, read, dt, run.peak);
    if (keeper == Keeper::kTank) {
      const What what = interruptions.next(draw);
      if (what != What::kNone) tank.forget();
      if (what == What::kZero) {
        sent.setZero();
      } else {
        sent *= tank.pass(wanted, read, fresh || !run.tells_age, dt, params, cap);
      }
    }
    if (run.weak > 0.0 && draw.uniform(0, 1) < run.weak) {
      const double share = draw.uniform(0.0, 1.0);
      sent *= share;
      if (run.tells_weak) tank.weaken(share, params.arm);
    }
    // Judges the last interval after the tank has accounted for it.
    result.margin = std::min(result.margin, energy + tank.debt());
    if (tank.energy() > 0.0) {
      result.spare = std::min(result.spare, energy + tank.debt() - tank.energy());
    }
    // Without uncertainty, draws no random number, so that the other random numbers stay the same.
    double off = 0.0;
    if (run.doubt > 0.0) {
      off = run.doubt * howLate(run.seed, ticks, sent.squaredNorm() > gone.squaredNorm(), draw);
    }
    gone = sent;
    wire.send(sent, time, off);
    const double changed = (sent - wanted).norm();
    scaled += static_cast<long>(changed > 1e-9);
    lost += changed;
    asked += wanted.norm();
    result.nominal = std::max(result.nominal, sent.norm());

    dt = run.period * (1.0 - draw.uniform(0.0, run.jitter));
    if (run.late > 0.0 && draw.uniform(0, 1) < run.late) dt = run.period * draw.uniform(1.0, 10.0);
    // The forces in this tick, which an adversary knows.
    std::array<Vec3, kPieces> forces;
    mean.setZero();
    const double piece = dt / kPieces;
    for (std::size_t i = 0; i < kPieces; ++i) {
      forces[i] = wire.over(time + static_cast<double>(i) * piece, piece) / piece;
      mean += forces[i] / kPieces;
    }
    if (draw.uniform(0, 1) < 0.002) mood = draw.uniform(0, 1);
    const Vec3 way = run.adversary ? worstWay(run, x, mean, dt, mood, draw) : Vec3(Vec3::Zero());
    for (std::size_t i = 0; i < kPieces; ++i) {
      Vec3 moved;
      if (run.adversary) {
        // Against viscous friction, the best path is faster where the force exceeds its mean.
        moved = way / kPieces + piece / (2.0 * run.viscous) * (forces[i] - mean);
      } else {
        Vec3 pull = Vec3::Zero();
        if (time < run.release && run.grip > 0.0) {
          Vec3 at = Vec3(0.001, 0, 0) + std::sin(62.8 * time) * tremor;
          for (std::size_t s = 0; s < 3; ++s) at += std::sin(turning[s] * time) * swing[s];
          pull = run.grip * (at - x) - run.grip_damping * v;
        }
        v += piece / run.mass * (forces[i] + pull - run.viscous * v);
        const double stop = run.coulomb * piece / run.mass;
        v *= v.norm() > stop ? 1.0 - stop / v.norm() : 0.0;
        moved = piece * v;
      }
      x += moved;
      if (run.reading_jitter > 0.0) past.push_back({time + static_cast<double>(i + 1) * piece, x});
      energy += -forces[i].dot(moved) + run.viscous * moved.squaredNorm() / piece +
                run.coulomb * moved.norm();
    }
    time += dt;
    result.least = std::min(result.least, energy);
    if (!(x.norm() < 10.0)) break;
  }
  result.debt = tank.debt();
  result.scaled = static_cast<double>(scaled) / static_cast<double>(std::max(1L, ticks));
  result.lost = asked > 0.0 ? lost / asked : 0.0;
  return result;
}

void PassivityTally::add(const PassivityResult& r) {
  // Bounds the rounding of sums over thousands of ticks [J].
  constexpr double kRounding = 1e-12;
  const bool more = r.margin < -kRounding || r.spare < -kRounding;
  add(PassivityTally{1, r.least < -kRounding, r.least<-1e-3, more, r.debt> 0.0, r.least, r.margin,
                     r.debt, r.scaled, r.lost});
}

void PassivityTally::add(const PassivityTally& other) {
  runs += other.runs;
  active += other.active;
  large += other.large;
  broken += other.broken;
  indebted += other.indebted;
  worst = std::min(worst, other.worst);
  margin = std::min(margin, other.margin);
  debt = std::max(debt, other.debt);
  scaled += other.scaled;
  lost += other.lost;
}

namespace {

/// Returns a copy of a run with about a third of its numbers changed.
PassivityRun changed(PassivityRun run, Draw& draw) {
  const auto turn = [&](double& x, double least, double most) {
    if (draw.uniform(0, 1) < 0.3) {
      x = std::clamp(std::max(x, least) * std::exp(draw.uniform(-0.7, 0.7)), least, most);
    }
  };
  const double t = run.period;
  turn(run.viscous, 0.05, 5.0);
  turn(run.coulomb, 1e-4, 0.5);
  turn(run.encoder, 1e-7, 1e-4);
  turn(run.delay, 0.01 * t, 5.0 * t);
  turn(run.doubt, 0.001 * t, 3.0 * t);
  turn(run.reading_jitter, 0.001 * t, 0.5 * t);
  turn(run.lag, 0.001 * t, 3.0 * t);
  turn(run.jitter, 0.001, 0.95);
  turn(run.forgets, 0.001, 0.5);
  turn(run.stiffness, 50.0, 5e4);
  turn(run.wave, 200.0, 2e4);
  turn(run.amplitude, 0.1, run.peak);
  run.delay = std::max(run.delay, run.doubt);
  const auto whole = [&](int& x, int least, int most) {
    if (draw.uniform(0, 1) < 0.3) {
      x = std::clamp(x + (draw.uniform(0, 1) < 0.5 ? -1 : 1), least, most);
    }
  };
  whole(run.every, 1, 10);
  whole(run.away, 0, 10);
  if (draw.uniform(0, 1) < 0.2) {
    run.scene = static_cast<ActiveScene>(static_cast<int>(draw.uniform(0, kActiveScenes)));
  }
  if (draw.uniform(0, 1) < 0.3) run.adversary = !run.adversary;
  if (draw.uniform(0, 1) < 0.5) run.seed += 1000003;
  return run;
}

}  // namespace

PassivityTally playSearched(std::uint64_t seed, long plays, bool at_once) {
  Draw draw(seed * 31 + 7);
  PassivityTally tally;
  PassivityRun best = randomRun(seed, true);
  best.seconds = 0.2;
  best.adversary = true;
  forgetOften(best);
  double least = std::numeric_limits<double>::infinity();
  for (long i = 0; i < plays; ++i) {
    PassivityRun run = changed(best, draw);
    if (at_once) run.delay = run.doubt = run.lag = run.reading_jitter = 0.0;
    const PassivityResult result = play(run, Keeper::kTank);
    tally.add(result);
    // Compares spare energies in units of the energy that the peak force can extract in a tick.
    const double unit = run.peak * run.peak * run.period / (4.0 * run.viscous);
    if (result.spare / unit < least) {
      least = result.spare / unit;
      best = run;
    }
  }
  return tally;
}

}  // namespace palpate::bench
