/// Tests a proxy on a stream: its distance from the exact proxy, and its cost.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/motion_problems.h"
#include "tests/support/random.h"
#include "tests/support/theorem.h"

namespace palpate::stream_test {
using namespace palpate::bench;
using palpate::test::Random;

TEST_CASE("over 1280 voxels the proxy departs from its stream by at most 0.01 voxel",
          "[motion][release]") {
  // The requirement is a sum of departures of at most 0.02 voxel (goal 0.01), with at most 20
  // samples per tick. A Taylor-Green stream may take 26 samples, because it turns in small loops,
  // and each bend needs a search for the nearest point.
  const auto count = static_cast<std::size_t>(palpate::test::share(3));
  for (const int wavelength : {16, 32}) {
    for (const bool abc : {true, false}) {
      const auto flow = abc ? abcFlow(wavelength) : taylorGreen(wavelength);
      for (const Stream& stream : streamsOfFlow(flow, wavelength, 1280.0, count, 1.0)) {
        const StreamResult r = feelStream(stream, 0.5, 1.0, {});
        CAPTURE(abc, wavelength, r.off_max, r.departures, r.samples, r.most_samples);
        CHECK(r.departures <= 0.01);
        CHECK(r.samples <= (abc ? 20.0 : 26.0));
        CHECK(r.capped == 0.0);
        // A Taylor-Green stream may report hairpins, because it turns in small loops.
        if (abc) CHECK(r.hairpins == 0.0);
      }
    }
  }
}

TEST_CASE("the proxy follows a stream within 0.005 voxel at 0.05 to 2 m/s", "[motion][release]") {
  const auto count = static_cast<std::size_t>(palpate::test::share(6));
  for (const double tolerance : {1e-2, 1e-3}) {
    for (const double speed : {0.05, 0.5, 1.0, 2.0}) {
      double off = 0.0;
      double departures = 0.0;
      for (const int wavelength : {16, 32}) {
        for (const Stream& stream :
             streamsOfFlow(abcFlow(wavelength), wavelength, 128.0, count, 1.0)) {
          StepParams step;
          step.tolerance_voxels = tolerance;
          const StreamResult r = feelStream(stream, speed, 1.0, step);
          CHECK(r.capped == 0.0);
          off = std::max(off, r.off_max);
          departures = std::max(departures, r.departures);
        }
      }
      CAPTURE(tolerance, speed, off, departures);
      // Between two ticks a fast hand leaves the curve, which reduces the precision.
      CHECK(off <= (speed < 2.0 ? 0.1 * tolerance + 1e-3 : 5e-3));
      CHECK(departures <= 0.01);
    }
  }
}

TEST_CASE("beside another mode a proxy with one sub-step lags on its stream and reports the limit",
          "[motion]") {
  // Each tick has one reading, and the hand moves by 1.28 voxels per tick. Beside another mode, a
  // reading of a stream is valid for one voxel. A stream alone is traced along the whole path.
  StepParams step;
  step.max_substeps = 1;
  for (const Stream& stream : streamsOfFlow(abcFlow(16), 16, 128.0, 3, 1.0)) {
    const StreamResult alone = feelStream(stream, 1.0, 1.0, step);
    CHECK(alone.capped == 0.0);
    CHECK(alone.departures <= 0.01);
    GraphSpec spec;
    spec.modes.resize(2);
    spec.modes[0].kind = ModeKind::kFollow;
    spec.modes[0].of = "it";
    spec.modes[0].strength = 1.0;
    spec.modes[1].kind = ModeKind::kForce;
    spec.modes[1].of = "it";
    spec.modes[1].strength = 1e-3;
    const auto scene = makeScene(spec, {{"it", stream.field}}, {kMotionStiffness, 0.0}, step);
    Reader reader;
    ProxyState state({1e3, 1e12});
    const Stepper pushed = [&](const Vec3& hand) {
      const StepReport r = provenStep(*scene, reader, {hand}, state, kMotionTick);
      Ticked out;
      out.proxy = r.proxy;
      out.force = r.wanted;
      out.samples = r.samples + r.traced;
      out.capped = r.status > StepStatus::kHairpin;
      return out;
    };
    const StreamResult r = feelStream(stream, pushed, 1.0, 1.0);
    CAPTURE(r.off_max, r.departures, r.capped, r.most_samples);
    CHECK(r.capped > 0.1);
    CHECK(r.most_samples <= 60.0);
    // The proxy stays on its stream, although it lags behind the hand.
    CHECK(r.departures <= 0.1);
  }
}

TEST_CASE("streams of real flows are followed within 0.01 voxel", "[.][data][motion]") {
  // tests/motion/data_test.sh imports the flows.
  const char* folder = std::getenv("PALPATE_IMPORTED");
  REQUIRE(folder != nullptr);
  const long count = std::max(palpate::test::share(24), 6L);
  for (const char* name : {"carotid", "kitchen", "storm"}) {
    long followed = 0;
    double off = 0.0;
    double departures = 0.0;  // sum over all streams, per 1,280 voxels
    double worst = 0.0;       // largest departure of one stream, scaled to 1,280 voxels
    double samples = 0.0;
    double length = 0.0;
    for (const Stream& stream : streamsOfFile(std::string(folder) + "/" + name + ".vdb",
                                              static_cast<std::size_t>(count), 1280.0)) {
      if (stream.mostBend(1.0) >= kMostBend) continue;
      const StreamResult r = feelStream(stream, 0.5, 1.0, {});
      ++followed;
      off = std::max(off, r.off_max);
      departures += r.departures * stream.length();
      worst = std::max(worst, r.departures);
      samples += r.samples * stream.length();
      length += stream.length();
      CHECK(r.capped == 0.0);
      CHECK(r.hairpins <= 0.05);  // at a kink of the kitchen's flow
    }
    departures /= length;
    samples /= length;
    WARN(name << ": " << followed << " streams, " << length << " voxels; off by at most " << off
              << " voxel; departures per 1,280 voxels: mean " << departures << ", worst " << worst
              << " voxel; " << samples << " samples per tick");
    CHECK(followed >= (name == std::string("storm") ? 1 : 5 * count / 24));
    CHECK(off <= 0.01);
    CHECK(worst <= 0.02);  // goal: 0.01
    // The storm's streams turn at the edges of its grid of 25 x 14 x 8 voxels, which takes more
    // samples.
    CHECK(samples <= (name == std::string("storm") ? 24.0 : 20.0));
  }
}

TEST_CASE("the proxy follows a streamline of a spline flow with at most 20 samples per tick",
          "[motion]") {
  for (const char* interpolation : {"quadratic", "cubic"}) {
    // The exact path is known only for the trilinear field, so this test checks the cost, and that
    // the proxy stays within a voxel of that path.
    for (const Stream& stream : streamsOfFlow(abcFlow(32), 32, 128.0, 2, 1.0, interpolation)) {
      const StreamResult r = feelStream(stream, 0.5, 1.0, {});
      CAPTURE(interpolation, r.samples, r.off_max);
      CHECK(r.samples <= 20.0);
      CHECK(r.capped == 0.0);
      CHECK(r.off_max < 1.0);
    }
  }
}

TEST_CASE(
    "the status reports a hairpin, and the force changes by at most the strength and the hand's "
    "pull",
    "[motion][release]") {
  // If the hand is beyond the centre of curvature, the stream has no unique nearest point. With a
  // strength of 1 N the stream sometimes releases a hand 2.2 voxels to the side. With 3 N it always
  // holds a hand one voxel to the side.
  const long count = palpate::test::share(6);
  for (const auto& [pull, strength] : {std::pair{2.2, 1.0}, {1.0, 3.0}}) {
    Random random(9);
    int hairpins = 0;
    for (int i = 0; i < 400 && hairpins < count; ++i) {
      Stream stream = traceStream("", abcFlow(16), Vec3::Constant(8.0) + random.inCube(8.0), 200.0);
      if (stream.mostBend(pull) < 1.2) continue;
      ++hairpins;
      stream.field = fieldAbout(stream);
      const StreamResult r = feelStream(stream, engineOn(stream, {}, strength), 0.5, pull, false);
      CAPTURE(pull, r.force_step, r.force_most, r.off_max, r.capped, r.hairpins);
      // The waiting pull along the stream adds to the strength.
      CHECK(r.force_most <= strength + 0.4 * voxelsPerTick(0.5));
      // The hand's own motion stretches the spring in addition to the strength.
      CHECK(r.force_step <= strength + 0.4 * voxelsPerTick(0.5));
      if (strength == 3.0) CHECK(r.hairpins > 0.0);
    }
    CHECK(hairpins == count);
  }
}

namespace {

/// Results of ticks on one stream without other modes.
struct Streamed {
  long converged = 0;
  /// Number of converged ticks in which the line holds, but the proxy is off along the stream by
  /// more than the tolerance.
  long off = 0;
  long hairpins = 0;
  double along = 0.0;  ///< Largest force along the stream while the line holds [N].
  double rise = 0.0;   ///< Largest rise of the spring's energy by the proxy's motion [J].
};

/// Moves a hand through positions [voxels] beside a stream. `direction` returns the exact direction
/// of the stream.
Streamed feelAlong(const Stepper& tick, double strength, const std::vector<Vec3>& hands,
                   const std::function<Vec3(const Vec3&)>& direction) {
  const double tolerance = StepParams{}.tolerance_voxels * kVoxel;
  Streamed out;
  Vec3 before = kVoxel * hands[0];
  for (const Vec3& at : hands) {
    const Vec3 hand = kVoxel * at;
    const Ticked r = tick(hand);
    const Vec3 left = hand - r.proxy;
    const double rise =
        0.5 * kMotionStiffness * (left.squaredNorm() - (hand - before).squaredNorm());
    out.rise = std::max(out.rise, rise);
    out.hairpins += r.hairpin ? 1 : 0;
    before = r.proxy;
    if (r.capped || r.hairpin) continue;
    ++out.converged;
    // Skips ticks in which the line yields: it then holds perpendicular to the mean of two
    // directions.
    if (kMotionStiffness * left.norm() > 0.999 * strength) continue;
    const double along = std::abs(direction(r.proxy / kVoxel).dot(left));
    out.along = std::max(out.along, kMotionStiffness * along);
    out.off += along > tolerance ? 1 : 0;
  }
  return out;
}

/// Returns a flow in circles about an axis through `centre`. The flow is linear, so trilinear
/// interpolation is exact.
FieldPtr circlesAbout(const Vec3& centre, const Vec3& axis) {
  return vectorGrid(Vec3::Constant(41.0),
                    [=](const Vec3& p) { return Vec3(axis.cross(p - centre)); });
}

}  // namespace

TEST_CASE("a hand beside a bent stream feels no force along the stream on either side of the bend",
          "[motion]") {
  const Vec3 centre(20.3, 19.7, 20.45);
  const Vec3 axis = Vec3(0.2, -0.3, 0.93).normalized();
  Stream stream;
  stream.field = circlesAbout(centre, axis);
  const Vec3 u = axis.cross(Vec3::UnitX()).normalized();
  const Vec3 w = axis.cross(u);
  const auto direction = [&](const Vec3& p) { return Vec3(axis.cross(p - centre).normalized()); };
  constexpr double kRadius = 10.0;
  constexpr double kStrength = 8.0;
  for (const double speed : {0.05, 0.2, 0.5}) {
    for (const double outside : {-5.0, -2.0, 2.0, 4.0}) {
      const double radius = kRadius + outside;
      std::vector<Vec3> hands;
      for (int i = 0; i < 100; ++i) hands.emplace_back(centre + (kRadius + 0.01 * i * outside) * u);
      const double step = voxelsPerTick(speed) / radius;
      for (int i = 0; i < 1000; ++i) {
        hands.emplace_back(centre + radius * (std::cos(i * step) * u + std::sin(i * step) * w));
      }
      const Streamed r = feelAlong(engineOn(stream, {}, kStrength), kStrength, hands, direction);
      CAPTURE(speed, outside, r.along, r.rise);
      CHECK(r.along <= kMotionStiffness * kVoxel * StepParams{}.tolerance_voxels);
      CHECK(r.converged == static_cast<long>(hands.size()));
      CHECK(r.rise <= 1e-12);
    }
  }
}

TEST_CASE(
    "a proxy that has converged on a stream is at the place of the stream nearest to the hand",
    "[motion]") {
  const auto count = static_cast<std::size_t>(palpate::test::share(3));
  for (const bool abc : {true, false}) {
    const auto flow = abc ? abcFlow(16) : taylorGreen(16);
    for (const double speed : {0.05, 0.5, 2.0}) {
      for (const Stream& stream : streamsOfFlow(flow, 16, 128.0, count, 1.0)) {
        const double spacing = voxelsPerTick(speed) / stream.spacing;
        std::vector<Vec3> hands;
        for (double at = 0.0; at < static_cast<double>(stream.x.size()) - 1.0; at += spacing) {
          const auto i = static_cast<std::size_t>(at);
          hands.emplace_back(stream.x[i] + std::min(1.0, at * stream.spacing / 6.0) * stream.n[i]);
        }
        const Streamed r = feelAlong(engineOn(stream, {}), 1.0, hands,
                                     [&](const Vec3& p) { return stream.directionAt(p); });
        CAPTURE(abc, speed, r.along, r.rise, r.converged);
        CHECK(r.off == 0);
        CHECK(r.converged > static_cast<long>(hands.size() / 2));
        if (speed < 1.0) CHECK(r.rise <= 1e-12);  // fast hands need several moves
      }
    }
  }
}

TEST_CASE(
    "a hand beyond a stream's centre of curvature makes the proxy move to the next nearest place",
    "[motion]") {
  // The hand crosses random bends, where curvature times distance is up to 3. Where a local minimum
  // of the distance vanishes, the proxy must move on to the next.
  Random random(5);
  Stream stream = traceStream("", abcFlow(16), Vec3::Constant(24.0), 1.0);
  stream.field = vectorGrid(Vec3::Constant(49.0), [&](const Vec3& p) {
    return stream.voxel(static_cast<int>(p.x()), static_cast<int>(p.y()), static_cast<int>(p.z()));
  });
  for (const double strength : {3.0, 6.0}) {
    std::vector<Vec3> hands{Vec3::Constant(24.0)};
    Vec3 way = random.direction();
    const double pace = voxelsPerTick(0.3);
    for (long i = 0; i < std::max(palpate::test::share(3000), 1500L); ++i) {
      way = (way + 0.2 * random.direction()).normalized();
      const Vec3 from = hands.back() - Vec3::Constant(24.0);
      if (from.norm() > 14.0 && from.dot(way) > 0.0) way = -way;
      hands.emplace_back(hands.back() + pace * way);
    }
    const Streamed r = feelAlong(engineOn(stream, {}, strength), strength, hands,
                                 [&](const Vec3& p) { return stream.directionAt(p); });
    CAPTURE(strength, r.along, r.rise, r.off, r.converged, r.hairpins);
    CHECK(r.off == 0);
    CHECK(r.rise <= 1e-12);
    CHECK(r.hairpins > 0);
    CHECK(1000 * (r.converged + r.hairpins) >= 999 * static_cast<long>(hands.size()));
  }
}

TEST_CASE(
    "the force of a bent stream stays constant while a hand rests 0.5 to 2 radii outside the bend",
    "[motion]") {
  // The streams are circles of curvature kappa, with the hand at distance d outside. A step along
  // the tangent overshoots the nearest point by kappa d times the step's length.
  const Vec3 centre(20.3, 19.7, 20.45);
  const Vec3 axis = Vec3(0.2, -0.3, 0.93).normalized();
  const FieldPtr field = circlesAbout(centre, axis);
  const Vec3 u = axis.cross(Vec3::UnitX()).normalized();
  const Vec3 w = axis.cross(u);
  for (const double radius : {2.0, 3.0, 5.0}) {
    for (const double turns : {0.5, 0.95, 1.05, 1.5, 2.0}) {
      const double d = turns * radius;
      Stream stream;
      stream.field = field;
      const Stepper tick = engineOn(stream, {}, 1.5 * kMotionStiffness * kVoxel * d);
      double injected = 0.0;
      double step = 0.0;
      Vec3 force = Vec3::Zero();
      for (int t = 0; t < 900; ++t) {
        const Vec3 hand =
            centre + (radius + d * std::min(1.0, t / 200.0)) * u + (t < 200 ? 0.0 : 0.05) * w;
        const Ticked r = tick(kVoxel * hand);
        if (t > 400) step = std::max(step, (r.force - force).norm());
        if (t > 230) injected += r.injected;
        force = r.force;
      }
      CAPTURE(radius, turns, step, injected);
      CHECK(force.norm() == Approx(kMotionStiffness * kVoxel * d).epsilon(0.02));
      CHECK(step < 1e-3);
      CHECK(injected < 1e-9);
    }
  }
}

TEST_CASE("a stream of random directions pulls a hand with at most 1.3 times its strength",
          "[motion]") {
  // The directions are random. If `axes` is true, their signs have no meaning, as in the background
  // of a diffusion image.
  Random random(11);
  std::vector<Vec3> noise(41 * 41 * 41);
  for (Vec3& v : noise) v = random.direction();
  const auto at = [&](const Vec3& p) {
    return noise[static_cast<std::size_t>((p.x() * 41 + p.y()) * 41 + p.z())];
  };
  for (const bool axes : {false, true}) {
    Stream stream;
    stream.field = vectorGrid(Vec3::Constant(41.0), at, "trilinear", axes);
    constexpr double kStrength = 0.5;
    const double pace = 0.06;  // voxels per tick
    for (int path = 0; path < 30; ++path) {
      const Stepper tick = engineOn(stream, {}, kStrength);
      Vec3 hand = Vec3::Constant(20.0) + random.inCube(12.0);
      Vec3 way = random.direction();
      double most = 0.0;
      for (int t = 0; t < 1500; ++t) {
        way = (way + 0.05 * random.direction()).normalized();
        hand += pace * way;
        if ((hand - Vec3::Constant(20.0)).cwiseAbs().maxCoeff() > 17.0) way = -way;
        const Ticked r = tick(kVoxel * hand);
        most = std::max(most, r.force.norm());
      }
      CAPTURE(axes, path, most);
      CHECK(most <= 1.3 * kStrength);
    }
  }
}

namespace {

/// Returns a scene of streams with these strengths [N], and with `wall` if it is not null.
std::unique_ptr<const Scene> streamsScene(const std::vector<std::pair<FieldPtr, double>>& streams,
                                          const FieldPtr* wall = nullptr) {
  GraphSpec spec;
  std::map<std::string, FieldPtr> fields;
  for (const auto& [field, strength] : streams) {
    ModeSpec mode;
    mode.kind = ModeKind::kFollow;
    mode.of = "stream " + std::to_string(fields.size());
    mode.strength = strength;
    fields[mode.of] = field;
    spec.modes.push_back(mode);
  }
  if (wall != nullptr) {
    ModeSpec mode;
    mode.kind = ModeKind::kIsosurface;
    mode.of = "wall";
    mode.solid = Solid::kBelow;
    mode.strength = 20.0;
    fields[mode.of] = *wall;
    spec.modes.push_back(mode);
  }
  return makeScene(spec, fields, {kMotionStiffness, 0.0});
}

/// Results of ticks at given positions of the hand.
struct Walked {
  std::vector<Vec3> proxies;  ///< [voxels]
  double rise = 0.0;          ///< Largest rise of the spring's energy by the proxy's motion [J].
  long capped = 0;
};

Walked walk(const Scene& scene, const std::vector<Vec3>& hands) {
  Walked out;
  Reader reader;
  ProxyState state({1e3, 1e12});
  Vec3 before = kVoxel * hands[0];
  for (const Vec3& at : hands) {
    const Vec3 hand = kVoxel * at;
    const StepReport r = provenStep(scene, reader, {hand}, state, kMotionTick);
    const double rise = (r.proxy - hand).squaredNorm() - (before - hand).squaredNorm();
    out.rise = std::max(out.rise, 0.5 * kMotionStiffness * rise);
    out.capped += r.status > StepStatus::kHairpin ? 1 : 0;
    out.proxies.emplace_back(r.proxy / kVoxel);
    before = r.proxy;
  }
  return out;
}

double apart(const Walked& a, const Walked& b) {
  double most = 0.0;
  for (std::size_t i = 0; i < a.proxies.size(); ++i) {
    most = std::max(most, (a.proxies[i] - b.proxies[i]).norm());
  }
  return most;
}

}  // namespace

TEST_CASE("two streams act the same in any order, and two streams of one field act as one",
          "[motion]") {
  for (const double speed : {0.05, 0.5}) {
    for (const Stream& stream : streamsOfFlow(abcFlow(16), 16, 64.0, 2, 1.0)) {
      Stream other = stream;
      other.voxel = [flow = taylorGreen(16)](int i, int j, int k) {
        return Vec3(flow(i, j, k) + Vec3(0.1, 0.05, 0.2));
      };
      const FieldPtr weak = fieldAbout(other);
      const double spacing = voxelsPerTick(speed) / stream.spacing;
      std::vector<Vec3> hands;
      for (double at = 0.0; at < static_cast<double>(stream.x.size()) - 1.0; at += spacing) {
        const auto i = static_cast<std::size_t>(at);
        hands.emplace_back(stream.x[i] + std::min(1.0, at * stream.spacing / 6.0) * stream.n[i]);
      }
      const Walked strong_first = walk(*streamsScene({{stream.field, 1.0}, {weak, 0.05}}), hands);
      const Walked weak_first = walk(*streamsScene({{weak, 0.05}, {stream.field, 1.0}}), hands);
      CAPTURE(speed, apart(strong_first, weak_first));
      CHECK(apart(strong_first, weak_first) <= 1e-9);
      CHECK(strong_first.capped == 0);
      CHECK(strong_first.rise <= 1e-12);
      // A hand one voxel to the side pulls with 0.39 N. A strength of 0.5 N can hold the proxy
      // against this pull, a strength of 0.2 N cannot.
      for (const double strength : {0.5, 0.2}) {
        const double part = 0.3 * strength;
        const Walked one = walk(*streamsScene({{stream.field, strength}}), hands);
        const Walked two =
            walk(*streamsScene({{stream.field, part}, {stream.field, strength - part}}), hands);
        CAPTURE(strength, apart(one, two));
        CHECK(apart(one, two) <= 0.02);
        CHECK(two.capped == 0);
      }
    }
  }
}

TEST_CASE("a proxy on a stream stops at a wall that the stream crosses", "[motion]") {
  // The stream turns, so the wall's force must not count as constant along the curve.
  const Vec3 middle = Vec3::Constant(24.0);
  const FieldPtr flow = vectorGrid(Vec3::Constant(49.0), [turns = taylorGreen(16)](const Vec3& p) {
    return turns(static_cast<int>(p.x()), static_cast<int>(p.y()), static_cast<int>(p.z()));
  });
  long capped = 0;
  long ticks = 0;
  double rise = 0.0;
  for (const std::uint64_t seed : {5, 7}) {
    Random random(seed);
    const Vec3 normal = random.direction();
    const FieldPtr wall = scalarGrid(
        49, [&](const Vec3& p) { return std::clamp(normal.dot(p - middle), -3.0, 3.0); });
    std::vector<Vec3> hands{middle + 8.0 * normal};
    Vec3 way = random.direction();
    for (long i = 0; i < 1500; ++i) {
      way = (way + 0.2 * random.direction()).normalized();
      const Vec3 from = hands.back() - middle;
      if (from.norm() > 12.0 && from.dot(way) > 0.0) way = -way;
      if (normal.dot(from) < -6.0 && normal.dot(way) < 0.0) way -= 2.0 * normal.dot(way) * normal;
      hands.emplace_back(hands.back() + voxelsPerTick(0.3) * way);
    }
    const Walked r = walk(*streamsScene({{flow, 3.0}}, &wall), hands);
    capped += r.capped;
    ticks += static_cast<long>(hands.size());
    rise = std::max(rise, r.rise);
  }
  CAPTURE(capped, ticks, rise);
  CHECK(1000 * capped <= 2 * ticks);
  CHECK(rise <= 1e-9);
}

namespace {

/// A constant shear, x -> x + S x.
class Shear final : public Warp {
 public:
  explicit Shear(const Mat3& slope) : slope_(slope) {}
  [[nodiscard]] Displacement at(const Vec3& x, double /*time*/) const noexcept override {
    Displacement u;
    u.shift = slope_ * x;
    u.slope = slope_;
    return u;
  }
  [[nodiscard]] Box shifts() const override { return {Vec3::Constant(-0.1), Vec3::Constant(0.1)}; }
  [[nodiscard]] double topSpeed() const override { return 0.0; }
  [[nodiscard]] double topAcceleration() const noexcept override { return 0.0; }

 private:
  Mat3 slope_;
};

}  // namespace

TEST_CASE(
    "a proxy on a stream in a sheared volume is at the place nearest to the hand in world space",
    "[motion][warp]") {
  // The point nearest in the frame of rest is not the nearest in W.
  const Vec3 centre(20.3, 19.7, 20.45);
  const Vec3 axis = Vec3(0.2, -0.3, 0.93).normalized();
  const Vec3 u = axis.cross(Vec3::UnitX()).normalized();
  const Vec3 w = axis.cross(u);
  constexpr double kStrength = 8.0;
  for (const double sheared : {0.3, 0.8}) {
    const Mat3 slope = sheared * u * w.transpose() - 0.5 * sheared * axis * u.transpose();
    const Mat3 to_rest = Mat3::Identity() + slope;
    const Mat3 from_rest = to_rest.inverse();
    GraphSpec spec;
    spec.modes.resize(1);
    spec.modes[0].kind = ModeKind::kFollow;
    spec.modes[0].of = "flow";
    spec.modes[0].strength = kStrength;
    spec.motions["flow"] = std::make_shared<const Motion>(std::make_shared<const Shear>(slope));
    const auto scene =
        makeScene(spec, {{"flow", circlesAbout(centre, axis)}}, {kMotionStiffness, 0.0});
    const auto direction = [&](const Vec3& p) {
      return Vec3((from_rest * axis.cross(to_rest * p - centre)).normalized());
    };
    for (const double speed : {0.05, 0.5}) {
      for (const double outside : {-2.0, 2.0}) {
        std::vector<Vec3> hands;
        const auto at = [&](double radius, double angle) {
          hands.emplace_back(from_rest *
                             (centre + radius * (std::cos(angle) * u + std::sin(angle) * w)));
        };
        for (int i = 0; i < 100; ++i) at(10.0 + 0.01 * i * outside, 0.0);
        const double step = voxelsPerTick(speed) / 10.0;
        for (int i = 0; i < 600; ++i) at(10.0 + outside, i * step);
        Reader reader;
        ProxyState state({1e3, 1e12});
        const Stepper tick = [&](const Vec3& hand) {
          const StepReport r = provenStep(*scene, reader, {hand}, state, kMotionTick);
          Ticked out;
          out.proxy = r.proxy;
          out.force = r.wanted;
          out.capped = r.status > StepStatus::kHairpin;
          out.hairpin = r.status == StepStatus::kHairpin;
          return out;
        };
        const Streamed r = feelAlong(tick, kStrength, hands, direction);
        CAPTURE(sheared, speed, outside, r.along, r.rise, r.converged, r.hairpins);
        CHECK(r.off == 0);
        CHECK(r.converged + r.hairpins == static_cast<long>(hands.size()));
        CHECK(r.rise <= 1e-12);
        double off = 0.0;  // distance from the circle in the frame of rest [voxels]
        const Vec3 d = to_rest * (state.proxy() / kVoxel) - centre;
        off = std::hypot(axis.dot(d), (d - axis.dot(d) * axis).norm() - 10.0);
        CHECK(off <= 0.01);
      }
    }
  }
}

}  // namespace palpate::stream_test
