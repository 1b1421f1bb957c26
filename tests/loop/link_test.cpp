/// Two hands linked by networks that are as bad as they like: the energy at both ends.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/link.h"
#include "tests/support/random.h"

namespace palpate {
namespace {

using test::Random;

constexpr double kDt = 1e-3;

/// What a network does to messages.
struct Network {
  double delay = 0.0;    ///< [s]
  double jitter = 0.0;   ///< More than that, at most [s].
  double lost = 0.0;     ///< Share.
  double doubled = 0.0;  ///< Share that comes once more, up to a second later.
  double apart = 0.0;    ///< From here [s]
  double again = 0.0;    ///< to here it carries nothing [s].
};

/// On their way to one end, by when they arrive.
using Way = std::multimap<double, LinkWord>;

/// A hand that somebody moves: a mass at a spring whose other end goes as he likes.
struct Hand {
  Vec3 position = Vec3::Zero();
  Vec3 velocity = Vec3::Zero();
  double mass = 0.2;
  double damping = 2.0;
  double grip = 0.0;            ///< [N/m]
  Vec3 swing = Vec3::Zero();    ///< Amplitude [m]
  double frequency = 1.0;       ///< [Hz]
  double phase = 0.0;

  /// One tick with a force that is held over it.
  void move(const Vec3& force, double now) {
    const Vec3 wanted = std::sin(2.0 * M_PI * frequency * now + phase) * swing;
    const Vec3 all = force + grip * (wanted - position) - damping * velocity;
    // No arm and no hand is more nimble.
    Vec3 a = all / mass;
    const double most = 0.49 * kLinkNimble;
    if (a.norm() > most) a *= most / a.norm();
    velocity += kDt * a;
    position += kDt * velocity;
  }
};

/// One end, and what the test itself counts there.
struct End {
  explicit End(std::uint64_t life, const LinkParams& params) : link(life, params) {}
  Link link;
  Hand hand;
  Vec3 force = Vec3::Zero();
  double work = 0.0;   ///< On the hand [J].
  double lowest = 0.0; ///< Of the tank.
  std::uint64_t lives = 1;
  double next = 0.0;   ///< When it speaks.
};

struct Session {
  Session(std::uint64_t seed, const LinkParams& p)
      : random(seed), ends{End(1, p), End(1, p)}, params(p) {}

  void tick(double now) {
    for (std::size_t i = 0; i < 2; ++i) {
      End& end = ends[i];
      while (!ways[i].empty() && ways[i].begin()->first <= now) {
        end.link.hear(ways[i].begin()->second);
        ways[i].erase(ways[i].begin());
      }
      const double share = random.uniform() < unsent ? 0.0 : 1.0;
      end.force = share * end.link.pull(end.hand.position, end.hand.position, true, kDt);
      end.link.pulled(share, Mat3::Identity());
      end.lowest = std::min(end.lowest, end.link.energy());
      if (now >= end.next) {
        end.next = now + every;
        send(1 - i, end.link.word(end.hand.position), now);
      }
    }
    for (End& end : ends) {
      const Vec3 before = end.hand.position;
      end.hand.move(end.force, now);
      end.work += end.force.dot(end.hand.position - before);
    }
    most = std::max(most, ends[0].work + ends[1].work);
  }

  void send(std::size_t to, const LinkWord& word, double now) {
    if (now >= network.apart && now < network.again) return;
    if (random.uniform() < network.lost) return;
    const auto arrives = [&] { return now + network.delay + random.uniform() * network.jitter; };
    ways[to].emplace(arrives(), word);
    if (random.uniform() < network.doubled) ways[to].emplace(arrives() + random.uniform(), word);
  }

  /// One end is started anew; what is on its way stays there.
  void restart(std::size_t i) {
    End& end = ends[i];
    end.link = Link(++end.lives, params);
  }

  Random random;
  std::array<End, 2> ends;
  std::array<Way, 2> ways;
  LinkParams params;
  Network network;
  double every = 0.005;  ///< Between two messages [s].
  double unsent = 0.0;   ///< Share of forces that somebody cut.
  double most = 0.0;     ///< That both hands together had got at any time [J].
};

Network anyNetwork(Random& random, double seconds) {
  Network n;
  n.delay = random.integer(4) == 0 ? 0.0 : random.logUniform(1e-4, 0.3);
  n.jitter = random.integer(3) == 0 ? 0.0 : random.logUniform(1e-4, 0.3);
  n.lost = random.integer(3) == 0 ? 0.0 : random.uniform(0.0, 0.9);
  n.doubled = random.integer(3) == 0 ? 0.0 : random.uniform(0.0, 0.9);
  if (random.integer(3) == 0) {
    n.apart = random.uniform(0.0, seconds);
    n.again = n.apart + random.uniform(0.0, seconds);
  }
  return n;
}

Hand anyHand(Random& random) {
  Hand h;
  h.position = random.inCube(0.02);
  h.mass = random.logUniform(0.05, 0.5);
  h.damping = random.integer(3) == 0 ? 0.0 : random.logUniform(0.1, 10.0);
  h.grip = random.integer(4) == 0 ? 0.0 : random.logUniform(10.0, 1000.0);
  h.swing = random.inCube(0.05);
  h.frequency = random.logUniform(0.2, 15.0);
  h.phase = random.uniform(0.0, 2.0 * M_PI);
  return h;
}

}  // namespace

TEST_CASE("two hands never get more than their tanks began with, whatever the network does",
          "[loop][link]") {
  const long count = test::cases(100000);
  double nearest = -std::numeric_limits<double>::infinity();
  for (long seed = 0; seed < count; ++seed) {
    Random random(static_cast<std::uint64_t>(seed));
    LinkParams params;
    params.stiffness = random.logUniform(20.0, 2000.0);
    params.peak = random.uniform(0.5, 5.0);
    const double seconds = 0.4;
    Session session(static_cast<std::uint64_t>(seed) + 1000000, params);
    session.network = anyNetwork(random, seconds);
    session.every = random.logUniform(1e-3, 0.05);
    session.unsent = random.integer(4) == 0 ? random.uniform() : 0.0;
    for (End& end : session.ends) end.hand = anyHand(random);
    const double restarts = random.integer(3) == 0 ? random.uniform(0.0, seconds) : 2.0 * seconds;
    bool restarted = false;
    for (int n = 0; n * kDt < seconds; ++n) {
      if (!restarted && n * kDt > restarts) {
        restarted = true;
        session.restart(static_cast<std::size_t>(random.integer(2)));
      }
      session.tick(n * kDt);
    }
    const double bound = params.start * static_cast<double>(session.ends[0].lives +
                                                            session.ends[1].lives);
    INFO("seed " << seed);
    for (const End& end : session.ends) REQUIRE(end.lowest >= -1e-12);
    REQUIRE(session.most <= bound + 1e-12);
    nearest = std::max(nearest, session.most / bound);
  }
  // The bound is near: some network gets most of it out.
  CHECK(nearest > 0.5);
}

TEST_CASE("a hand is led by another one", "[loop][link]") {
  std::string rows;
  for (const double delay : {0.0, 0.005, 0.02, 0.05, 0.1}) {
    for (const double lost : {0.0, 0.1, 0.5}) {
      Session session(1, {});
      session.network.delay = delay;
      session.network.lost = lost;
      Hand& teacher = session.ends[0].hand;
      teacher.grip = 500.0;
      teacher.damping = 10.0;
      teacher.swing = {0.05, 0.0, 0.0};
      teacher.frequency = 0.5;
      session.ends[1].hand.damping = 1.0;
      double off = 0.0;
      int count = 0;
      double last = 0.0;
      for (int n = 0; n < 10000; ++n) {
        session.tick(n * kDt);
        if (n < 4000) continue;
        ++count;
        const double d = (session.ends[0].hand.position - session.ends[1].hand.position).norm();
        off += d * d;
        last = std::max(last, session.ends[1].hand.position.norm());
      }
      rows += std::to_string(delay) + " " + std::to_string(lost) + " rms apart " +
              std::to_string(1e3 * std::sqrt(off / count)) + " mm, student's way " +
              std::to_string(1e3 * last) + " mm, work " + std::to_string(session.ends[0].work) +
              " " + std::to_string(session.ends[1].work) + "\n";
    }
  }
  WARN(rows);
}

}  // namespace palpate
