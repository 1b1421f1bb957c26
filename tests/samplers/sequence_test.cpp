/// Tests sequences: fields that change continuously between frames.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <span>
#include <thread>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/time/sequence_field.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"
#include "tests/support/vdb_grids.h"

namespace palpate::sequence_test {
using namespace palpate::test;
using Catch::Contains;

namespace {

namespace fs = std::filesystem;

constexpr double kVoxel = 1e-3;  // [m]
constexpr double kTick = 1e-3;   // [s]

Placement placed() {
  Placement place;
  place.scale = kVoxel;
  return place;
}

/// Writes `count` frames, which `make` returns, to one file each. Returns requests to load them.
template <class Make>
std::vector<VolumeRequest> framesIn(const TemporaryFolder& folder, int count, const Make& make) {
  std::vector<VolumeRequest> frames;
  for (int i = 0; i < count; ++i) {
    frames.push_back({folder / ("frame_" + std::to_string(i) + ".vdb"), ""});
    writeVdb(frames.back().file, {make(i)});
  }
  return frames;
}

/// Returns a grid of 14^3 voxels with V = 100 i + x + 2 y - (3 + i) z.
openvdb::FloatGrid::Ptr ramp(int i) {
  return makeGrid<openvdb::FloatGrid>(
      14, openvdb::math::Transform::createLinearTransform(1.0), [i](const openvdb::Vec3d& p) {
        return static_cast<float>(100.0 * i + p.x() + 2.0 * p.y() - (3.0 + i) * p.z());
      });
}

/// Returns the level set of a ball with this radius [voxels].
openvdb::FloatGrid::Ptr ball(double radius) {
  return makeBall(radius, 1.0);
}

std::shared_ptr<const FrameSequence> sequenceOf(const std::vector<VolumeRequest>& frames,
                                                double rate, bool repeat = false,
                                                const SequenceParams& params = {}) {
  return std::make_shared<const FrameSequence>(frames, evenTimes(frames.size(), rate, repeat),
                                               placed(), Sampling{}, params);
}

/// Waits for the frames around a play time [s]. Returns false if they do not arrive.
bool arrives(const FrameSequence& sequence, double play) {
  const PlayMoment at = sequence.at(play);
  return sequence.wait(std::span(&at, 1), 20.0);
}

/// Reads a sequence's field tick by tick.
struct Player {
  explicit Player(const std::shared_ptr<const FrameSequence>& of)
      : sequence(of), field(std::get<0>(makeSequenceField(of))) {
    field->reset(*cache);
  }
  /// Returns the sample at p in a tick at play time `play` [s].
  ScalarSample at(double play, const Vec3& p, double rate = 0.0) const {
    field->attend({p, p, kTick, play, rate}, *cache);
    const ScalarSample out = field->sample(p, *cache);
    field->leave(*cache);
    return out;
  }
  /// Returns the sample after 60 ticks at play time `play` [s], when any fade has ended.
  ScalarSample settled(double play, const Vec3& p) const {
    ScalarSample out;
    REQUIRE(arrives(*sequence, play));
    for (int i = 0; i < 60; ++i) out = at(play, p);
    return out;
  }

  std::shared_ptr<const FrameSequence> sequence;
  std::shared_ptr<const ScalarField> field;
  std::unique_ptr<FieldCache> cache = std::make_unique<FieldCache>();
};

/// Builds a scene with an isosurface at value 0 that is solid below this value.
std::unique_ptr<const Scene> sceneOf(const FieldPtr& field, double strength = 50.0,
                                     double friction = 0.0) {
  GraphSpec spec = ballSpec(strength);
  spec.modes[0].friction = friction;
  return makeScene(spec, {{"ball", field}}, {500.0, 0.0});
}

std::uint64_t bytesOf(const VolumeRequest& frame) {
  return sequenceOf({frame}, 1.0)->state().bytes;
}

/// Returns parameters with a budget of `count` frames of the first frame's size.
SequenceParams budgetOf(const std::vector<VolumeRequest>& frames, double count) {
  SequenceParams params;
  params.budget = static_cast<std::uint64_t>(count * static_cast<double>(bytesOf(frames.front())));
  return params;
}

}  // namespace

TEST_CASE("a sequence of scalar grids interpolates between two frames", "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 4, ramp);
  const Player of(sequenceOf(frames, 10.0));
  const Vec3 p = kVoxel * Vec3(6.3, 5.2, 4.7);
  const auto V = [](double i) { return 100.0 * i + 6.3 + 2.0 * 5.2 - (3.0 + i) * 4.7; };
  for (const double i : {0.0, 0.25, 0.5, 0.99, 1.0, 1.7, 3.0}) {
    const ScalarSample at = of.settled(i / 10.0, p);
    CHECK(at.value == Approx(V(i)).margin(1e-3));
    CHECK((at.gradient - Vec3(1.0, 2.0, -3.0 - i)).norm() < 1e-3);
    CHECK(at.inside);
    CHECK_FALSE(at.coarse);
  }
  // Before the first frame, the field has the first frame's values; after the last frame, the last
  // frame's.
  CHECK(of.settled(-5.0, p).value == of.settled(0.0, p).value);
  CHECK(of.settled(99.0, p).value == of.settled(0.3, p).value);
  // Outside of a tick, the field has the first frame's values.
  CHECK(of.field->value(p, *of.cache) == Approx(V(0.0)).margin(1e-3));
  // In a repeated sequence, the first frame follows the last frame.
  const Player round(sequenceOf(frames, 10.0, true));
  CHECK(round.settled(0.35, p).value == Approx(0.5 * (V(3.0) + V(0.0))).margin(1e-3));
  CHECK(round.settled(0.4, p).value == Approx(V(0.0)).margin(1e-3));
  CHECK(round.settled(-0.05, p).value == Approx(0.5 * (V(3.0) + V(0.0))).margin(1e-3));
}

TEST_CASE(
    "the blend of frames follows uneven frame times, also beyond the end of a repeated sequence",
    "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 3, ramp);
  const auto of = std::make_shared<const FrameSequence>(
      frames, FrameTimes{{1.0, 2.0, 6.0, 7.0}, true}, placed(), Sampling{});
  const auto is = [&](double play, int low, int high, double share) {
    const PlayMoment at = of->at(play);
    CHECK(at.low == low);
    CHECK(at.high == high);
    CHECK(at.share == Approx(share).margin(1e-9));
  };
  is(1.0, 0, 1, 0.0);
  is(3.0, 1, 2, 0.25);
  is(6.5, 2, 0, 0.5);
  is(7.25, 0, 1, 0.25);
  is(0.5, 2, 0, 0.5);
}

TEST_CASE("a step by a frame keeps the share of the interval when intervals are uneven",
          "[sequence]") {
  FrameTimes once{{1.0, 1.1, 2.1, 2.3}};
  CHECK(once.stepFrom(1.0, true) == Approx(0.1));
  CHECK(once.stepFrom(1.1, true) == Approx(1.0));
  CHECK(once.stepFrom(2.1, true) == Approx(0.2));
  CHECK(once.stepFrom(2.3, true) == 0.0);
  CHECK(once.stepFrom(2.3, false) == Approx(-0.2));
  CHECK(once.stepFrom(2.1, false) == Approx(-1.0));
  CHECK(once.stepFrom(1.1, false) == Approx(-0.1));
  CHECK(once.stepFrom(1.0, false) == 0.0);
  CHECK(once.stepFrom(1.6, true) == Approx(0.6));     // from half of the second interval to 2.2
  CHECK(once.stepFrom(1.6, false) == Approx(-0.55));  // to 1.05
  CHECK(once.stepFrom(1.05, false) == Approx(-0.05));
  CHECK(once.stepFrom(0.0, true) == 1.0);
  CHECK(once.stepFrom(0.0, false) == 0.0);
  CHECK(once.stepFrom(3.0, true) == 0.0);
  CHECK(once.stepFrom(3.0, false) == Approx(-0.7));
  const FrameTimes cycle{once.times, true};
  CHECK(cycle.stepFrom(2.2, true) == Approx(0.15));     // from half of the last interval to 2.35
  CHECK(cycle.stepFrom(1.05, false) == Approx(-0.15));  // to half of the last interval
  CHECK(cycle.stepFrom(1.1 + 13.0, true) == Approx(1.0));
  CHECK(cycle.stepFrom(1.1 - 13.0, false) == Approx(-0.1));
  CHECK(FrameTimes{{0.5}}.stepFrom(0.5, true) == 0.0);
}

TEST_CASE("a sequence of vector grids interpolates between two frames", "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 2, [](int i) {
    return makeGrid<openvdb::Vec3SGrid>(
        10, openvdb::math::Transform::createLinearTransform(1.0), [i](const openvdb::Vec3d& p) {
          return openvdb::Vec3f(static_cast<float>(i), static_cast<float>(p.x() * (1 + i)), 1.0F);
        });
  });
  const auto of = sequenceOf(frames, 1.0);
  const auto field = std::get<1>(makeSequenceField(of));
  FieldCache cache;
  field->reset(cache);
  const Vec3 p = kVoxel * Vec3(4.5, 4.5, 4.5);
  VectorSample at;
  for (int i = 0; i < 60; ++i) {
    field->attend({p, p, kTick, 0.5, 0.0}, cache);
    at = field->sample(p, cache);
    field->leave(cache);
  }
  CHECK((at.value - Vec3(0.5, 4.5 * 1.5, 1.0)).norm() < 1e-5);
  CHECK(at.jacobian(1, 0) == Approx(1.5));
}

TEST_CASE("a ball that grows frame by frame carries the proxy on its surface",
          "[sequence][moving]") {
  const TemporaryFolder folder;
  // The ball's radius grows by one voxel per frame, at 200 frames per second: 0.2 m/s.
  constexpr double kFirst = 20.0;
  const auto frames = framesIn(folder, 12, [](int i) { return ball(kFirst + i); });
  const double friction = GENERATE(0.0, 0.3);
  const auto scene = sceneOf(makeSequenceField(sequenceOf(frames, 200.0)), 50.0, friction);
  Reader reader;
  ProxyState state({1e3, 1e12});
  const Vec3 out = Vec3(0.6, 0.48, 0.64);
  double off = 0.0;
  double carried = 0.0;
  double injected = 0.0;
  double given = 0.0;
  for (int i = 0; i < 160; ++i) {
    // The hand moves onto the surface and rests, while the ball grows by eleven voxels.
    const double depth = std::min(1.0, 0.02 * i);
    const double play = i < 100 ? 0.0 : kTick * (i - 100);
    state.playAt(play, i < 101 ? 0.0 : 1.0);
    const Vec3 hand = kVoxel * (kFirst + 1.0 - 2.0 * depth) * out;
    const Vec3 before = state.proxy();
    const StepReport r = hapticStep(*scene, reader, {hand}, state, kTick);
    REQUIRE(r.status == StepStatus::kConverged);
    if (i < 60) continue;
    const double radius = kFirst + std::min(11.0, 200.0 * play);
    off = std::max(off, std::abs(r.proxy.norm() / kVoxel - radius));
    carried = std::max(carried, r.proxy.norm() / kVoxel - kFirst);
    if (i < 100) continue;
    injected += r.injected;
    given += std::max(0.0, 500.0 * (r.proxy - hand).dot(r.proxy - before));
  }
  std::cout << "off a ball that grows at 0.2 m/s, friction " << friction << ": " << off
            << " voxel; work of the surface " << given << " J, counted " << injected << " J\n";
  CHECK(carried > 10.9);
  CHECK(off < 0.05);
  CHECK(injected >= 0.98 * given);
  CHECK(given > 0.01);
}

TEST_CASE("the proxy follows the surface of a ball that shrinks during play, in each tick",
          "[sequence][moving]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 12, [](int i) { return ball(20.0 - 0.25 * i); });
  const double rate = GENERATE(16.0, 64.0);  // 4 and 16 voxels per second
  const double friction = GENERATE(0.0, 0.2);
  const auto scene = sceneOf(makeSequenceField(sequenceOf(frames, rate)), 50.0, friction);
  Reader reader;
  ProxyState state({1e3, 1e12});
  const Vec3 down = Vec3(0.02, -0.3, 0.95).normalized();
  const double last = 11.0 / rate;
  int bad = 0;
  double off = 0.0;
  for (int i = 0; i < 200 + static_cast<int>(1e3 * last); ++i) {
    const double play = std::max(0.0, kTick * (i - 200));
    state.playAt(play, i > 200 ? 1.0 : 0.0);
    const Vec3 hand = kVoxel * ((21.0 - 0.025 * std::min(i, 200)) * down + Vec3(0.4, 0.0, 0.0));
    const StepReport r = hapticStep(*scene, reader, {hand}, state, kTick);
    bad += r.status != StepStatus::kConverged ? 1 : 0;
    if (i > 150)
      off = std::max(off, std::abs(r.proxy.norm() / kVoxel - (20.0 - 0.25 * rate * play)));
  }
  CHECK(bad == 0);
  CHECK(off < 0.05);
}

TEST_CASE("after a jump in play the value of a sequence changes over at least 50 ms",
          "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 8, ramp);
  const bool all = GENERATE(true, false);
  const auto of = sequenceOf(frames, 10.0, false, all ? SequenceParams{} : budgetOf(frames, 5.5));
  CHECK(of->state().slots == (all ? 8 : 5));
  const Player player(of);
  const Vec3 p = kVoxel * Vec3(6.3, 5.2, 4.7);
  Random random(7);
  double play = 0.0;
  double last = player.at(0.0, p).value;
  double largest = 0.0;
  int arrived = 0;
  for (int i = 0; i < 2250; ++i) {
    // Play jumps, and jumps again before the first fade has ended.
    if (i % 150 == 0 || i % 150 == 20) play = 0.7 * random.uniform();
    const ScalarSample at = player.at(play, p);
    largest = std::max(largest, std::abs(at.value - last));
    last = at.value;
    if (i % 150 == 149) {
      const double i_play = 10.0 * play;
      const double asked = 100.0 * i_play + 6.3 + 2.0 * 5.2 - (3.0 + i_play) * 4.7;
      if (all) CHECK(at.value == Approx(asked).margin(0.01));
      if (std::abs(at.value - asked) < 0.01) ++arrived;
    }
    if (!all) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  // A change of the value by up to 700 takes at least 50 ms.
  CHECK(largest < 700.0 * kTick / 0.05 + 1e-6);
  CHECK(largest > 5.0);
  CHECK(arrived >= (all ? 15 : 1));
}

TEST_CASE("a jump in play changes the force on a hand at a ball by less than 0.03 N per tick",
          "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 8, [](int i) { return ball(20.0 + 0.25 * i); });
  const auto scene = sceneOf(makeSequenceField(sequenceOf(frames, 10.0)));
  Reader reader;
  ProxyState state({1e3, 1e12});
  Random random(11);
  Vec3 last = Vec3::Zero();
  double largest = 0.0;
  double play = 0.0;
  for (int i = 0; i < 3000; ++i) {
    const double height = std::max(19.0, 22.0 - 0.01 * i);
    if (i > 500 && i % 150 == 0) play = 0.7 * random.uniform();
    state.playAt(play, 0.0);
    const StepReport r =
        hapticStep(*scene, reader, {kVoxel * height * Vec3::UnitX()}, state, kTick);
    if (i > 400) largest = std::max(largest, (r.wanted - last).norm());
    last = r.wanted;
  }
  CHECK(last.norm() > 0.4);
  // The surface moves by up to 1.75 mm in 50 ms, which changes the force by up to 0.0175 N per
  // tick. Without a fade, the force would change by up to 0.9 N in one tick.
  CHECK(largest < 0.03);
}

TEST_CASE("a surface that disappears during play changes the force at most at 2000 N/s",
          "[sequence]") {
  const TemporaryFolder folder;
  const double apart = GENERATE(5.0, 10.0, 20.0);  // [voxels]; the bands have a half-width of three
  const auto frames = framesIn(folder, 2, [&](int i) { return ball(20.0 + apart * i); });
  const auto scene = sceneOf(makeSequenceField(sequenceOf(frames, 10.0, true)));
  Reader reader;
  ProxyState state({1e3, 2000.0});
  StepReport last;
  double largest = 0.0;
  double felt = 0.0;
  int pressed = 0;
  double play = 0.0;
  for (int i = 0; i < 4000; ++i) {
    // The hand is ten voxels deep in the smaller ball, which vanishes at once or gradually. Then
    // the hand moves out and in again.
    const int at = i % 500;
    const bool plays = i % 1000 >= 500 && at >= 250 && at < 350;
    if (at == 0) play = 0.0;
    if (at == 250 && !plays) play = 0.1;
    if (plays) play += kTick;
    state.playAt(play, plays ? 1.0 : 0.0);
    const double height = std::max(10.0, at < 400 ? 28.0 - 0.08 * at : 28.0);
    const StepReport r =
        hapticStep(*scene, reader, {kVoxel * height * Vec3::UnitX()}, state, kTick);
    if (i > 0) largest = std::max(largest, (r.force - last.force).norm());
    if (at == 249) pressed += r.force.norm() > 4.9 ? 1 : 0;
    felt = std::max(felt, r.force.norm());
    last = r;
  }
  std::cout << "surfaces " << apart << " voxels apart: a tick changes the force by " << largest
            << " N of " << felt << " N\n";
  CHECK(pressed >= 4);
  CHECK(largest < 2000.0 * kTick * (1.0 + 1e-9));
}

TEST_CASE(
    "a hand that touches and leaves a ball feels the same force to within 0.02 N with or without "
    "play",
    "[sequence]") {
  const TemporaryFolder folder;
  // All frames have the same ball, so play has no effect on the field.
  const auto frames = framesIn(folder, 4, [](int) { return ball(20.0); });
  const auto scene = sceneOf(makeSequenceField(sequenceOf(frames, 10.0, true)));
  const int every = GENERATE(1, 8);  // number of ticks of 1/4 ms per position of the arm
  const double speed = GENERATE(0.2, 2.0);
  Reader readers[2];
  ProxyState still({8.0, 2000.0});
  ProxyState played({8.0, 2000.0});
  constexpr double kQuarter = 2.5e-4;
  Vec3 hand = Vec3::Zero();
  double off = 0.0;
  double felt = 0.0;
  for (int i = 0; i < 8000; ++i) {
    if (i % every == 0) {
      // The hand moves into the ball by 8 voxels, and out again.
      const double way = std::fmod(speed * kQuarter * i / kVoxel, 20.0);
      hand = kVoxel * Vec3(24.0 - (way < 10.0 ? 1.2 * way : 24.0 - 1.2 * way), 0.0, 0.0);
    }
    still.playAt(0.0, 0.0);
    played.playAt(kQuarter * i, 1.0);
    const StepReport a = hapticStep(*scene, readers[0], {hand}, still, kQuarter);
    const StepReport b = hapticStep(*scene, readers[1], {hand}, played, kQuarter);
    off = std::max(off, (a.force - b.force).norm());
    felt = std::max(felt, a.force.norm());
  }
  CHECK(felt > 2.0);
  CHECK(off < 0.02);
}

TEST_CASE("an edit of the scene does not interrupt the fade after a jump in play", "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 4, ramp);
  const auto field = makeSequenceField(sequenceOf(frames, 10.0));
  const auto scene = sceneOf(field);
  const auto edited = sceneOf(field, 40.0);
  Reader reader;
  const Vec3 p = kVoxel * Vec3(6.3, 5.2, 4.7);
  const auto read = [&](const Scene& of, double play) {
    const BoundGraph bound = reader.bind(of);
    const bool changed = bound.attend({p, p, kTick, play, 0.0}, {});
    Properties out;
    bound.sample(p, out);
    bound.leave();
    const int value = of.graph.scalar_reads[0].value;
    return std::pair(changed, out.scalars[static_cast<std::size_t>(value)].value);
  };
  double last = read(*scene, 0.0).second;
  CHECK_FALSE(read(*scene, 0.0).first);
  for (int i = 0; i < 60; ++i) {
    const auto [changed, value] = read(i < 10 ? *scene : *edited, 0.3);
    CHECK(std::abs(value - last) < 300.0 * kTick / 0.05 + 1e-3);
    CHECK(changed == (i <= 50));
    last = value;
  }
}

TEST_CASE(
    "readers of a sequence neither allocate nor lock, and never read a frame that is partly "
    "replaced",
    "[sequence][realtime]") {
  const TemporaryFolder folder;
  // All voxels of a frame have the frame's number as value, so a sample shows a torn or wrong
  // frame.
  const auto frames = framesIn(folder, 24, [](int i) {
    return makeGrid<openvdb::FloatGrid>(
        12, openvdb::math::Transform::createLinearTransform(1.0),
        [i](const openvdb::Vec3d&) { return static_cast<float>(i); });
  });
  const auto of = sequenceOf(frames, 25.0, true, budgetOf(frames, 6.5));
  std::atomic<bool> stop{false};
  std::atomic<long> wrong{0};
  std::atomic<long> reads{0};
  std::atomic<long> whole{0};
  const auto read = [&](std::uint64_t seed) {
    const Player player(of);
    Random random(seed);
    const auto begin = std::chrono::steady_clock::now();
    double shift = 0.0;
    double last = 0.0;
    const CountScope scope;
    while (!stop) {
      const std::chrono::duration<double> since = std::chrono::steady_clock::now() - begin;
      const double dt = since.count() - last;
      last = since.count();
      if (random.uniform() < 1e-5) shift = 0.96 * random.uniform();
      const Vec3 p = kVoxel * (Vec3::Constant(5.0) + random.inCube(4.0));
      player.field->attend({p, p, dt, last + shift, 1.0}, *player.cache);
      const ScalarSample a = player.field->sample(p, *player.cache);
      const ScalarSample b = player.field->sample(p + Vec3::Constant(kVoxel), *player.cache);
      player.field->leave(*player.cache);
      const bool good = a.inside && a.value >= -1e-6 && a.value <= 23.0 + 1e-6 &&
                        std::abs(a.value - b.value) < 1e-6;
      if (!good) ++wrong;
      if (!a.coarse) ++whole;
      ++reads;
    }
    const Counts counts = CountScope::counts();
    if (counts.allocations != 0 || counts.locks != 0) ++wrong;
  };
  std::thread one(read, 1);
  std::thread two(read, 2);
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while ((reads < 200000 || of->state().fetched < 40) && std::chrono::steady_clock::now() < until) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  stop = true;
  one.join();
  two.join();
  CHECK(wrong == 0);
  CHECK(reads >= 1000);
  CHECK(whole > 0);
  CHECK(of->state().resident <= 6);
  CHECK(of->state().fetched > 24);
}

TEST_CASE("a frame that a reader uses stays in memory with the smallest budget", "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 16, ramp);
  const auto of = sequenceOf(frames, 10.0, false, budgetOf(frames, 5.5));
  const PlayMoment early = of->at(0.15);
  of->tell(early, 1.0);
  REQUIRE(arrives(*of, 0.15));
  const FrameSequence::Hold held = of->hold(1);
  REQUIRE(held);
  const std::uint64_t stay = held.stay();
  const std::uint64_t fetched = of->state().fetched;
  // Play stays at other times for longer than the sequence keeps unused frames.
  std::this_thread::sleep_for(std::chrono::milliseconds(60));
  for (const double play : {0.75, 1.05, 1.35}) {
    of->tell(of->at(play), 1.0);
    REQUIRE(arrives(*of, play));
    std::this_thread::sleep_for(std::chrono::milliseconds(60));
  }
  CHECK(of->state().fetched > fetched + 4);
  CHECK(held.field().index() == 0);
  CHECK(std::get<0>(held.field()) != nullptr);
  CHECK(held.stay() == stay);
  CHECK(of->hold(1));
}

TEST_CASE("readers that wait read the same values with a small budget as with all frames in memory",
          "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 12, ramp);
  SequenceParams little = budgetOf(frames, 5.5);
  little.waits = true;
  const Player some(sequenceOf(frames, 10.0, true, little));
  const Player all(sequenceOf(frames, 10.0, true));
  Random random(5);
  double play = 0.0;
  for (int i = 0; i < 800; ++i) {
    play += 0.004;
    if (i % 90 == 0) play = 3.0 * random.uniform();
    const Vec3 p = kVoxel * (Vec3::Constant(6.0) + random.inCube(5.0));
    const ScalarSample a = some.at(play, p, 4.0);
    const ScalarSample b = all.at(play, p, 4.0);
    REQUIRE(std::memcmp(&a.value, &b.value, sizeof a.value) == 0);
    REQUIRE(a.gradient == b.gradient);
    REQUIRE_FALSE(a.coarse);
  }
  CHECK(some.sequence->state().slots == 5);
}

TEST_CASE(
    "values stay while frames load, and are interpolated across a frame whose file is missing",
    "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 12, ramp);
  const auto of = sequenceOf(frames, 10.0, false, budgetOf(frames, 5.5));
  const Player player(of);
  const Vec3 p = kVoxel * Vec3(6.3, 5.2, 4.7);
  const auto V = [](double i) { return 100.0 * i + 6.3 + 2.0 * 5.2 - (3.0 + i) * 4.7; };
  const fs::path file = frames[9].file;
  fs::rename(file, folder / "aside");
  // Play jumps to a time whose frames are not in memory. The field must keep the old frames'
  // values.
  const double before = player.at(0.1, p).value;
  const ScalarSample at = player.at(0.95, p);
  CHECK(at.coarse);
  CHECK(at.value == before);
  // The field must interpolate between frames 8 and 10, because frame 9 is missing.
  REQUIRE(arrives(*of, 0.95));
  CHECK(player.settled(0.95, p).value == Approx(V(9.5)).margin(1e-3));
  const PlayMoment gap = of->at(0.95);
  CHECK(gap.low == 8);
  CHECK(gap.high == 10);
  CHECK(gap.share == Approx(0.75));
  CHECK(of->state().failed == 1);
  const auto troubles = of->takeTroubles();
  REQUIRE(troubles.size() == 1);
  CHECK_THAT(troubles[0], Contains("frame_9.vdb") && Contains("without the frame"));
  CHECK(of->takeTroubles().empty());
  // The missing frame returns, and the sequence must load it.
  fs::rename(folder / "aside", file);
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (of->state().failed > 0 && std::chrono::steady_clock::now() < until) {
    (void)player.at(0.95, p);
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  CHECK(of->at(0.95).low == 9);
  CHECK(player.settled(0.95, p).value == Approx(V(9.5)).margin(1e-3));
}

TEST_CASE("a jump in play to a time next to a missing frame completes without further action",
          "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 12, ramp);
  const auto of = sequenceOf(frames, 10.0, false, budgetOf(frames, 5.5));
  const Player player(of);
  const Vec3 p = kVoxel * Vec3(6.3, 5.2, 4.7);
  (void)player.at(0.1, p);
  fs::remove(frames[9].file);
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  ScalarSample at;
  do {
    at = player.at(0.95, p);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  } while ((of->at(0.95).low != 8 || at.coarse) && std::chrono::steady_clock::now() < until);
  CHECK_FALSE(at.coarse);
  CHECK(player.settled(0.95, p).value ==
        Approx(950.0 + 6.3 + 2.0 * 5.2 - (3.0 + 9.5) * 4.7).margin(1e-3));
}

TEST_CASE("two hands whose play times differ by milliseconds share the same frames", "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 30, ramp);
  const auto of = sequenceOf(frames, 20.0, false, budgetOf(frames, 10.5));
  const Player one(of);
  const Player two(of);
  const Vec3 p = kVoxel * Vec3(6.3, 5.2, 4.7);
  const auto begin = std::chrono::steady_clock::now();
  for (double play = 0.0; play < 1.4;) {
    const std::chrono::duration<double> since = std::chrono::steady_clock::now() - begin;
    play = since.count();
    (void)one.at(play, p, 1.0);
    (void)two.at(play - 0.005, p, 1.0);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  // The load of the sequence fetches each frame once. Play must fetch each frame about once more.
  CHECK(of->state().fetched > 40);
  CHECK(of->state().fetched < 70);
}

TEST_CASE("the memory of a sequence stays within its budget for frames of different sizes",
          "[sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 10, [](int i) {
    return makeGrid<openvdb::FloatGrid>(
        i == 0 ? 6 : 40, openvdb::math::Transform::createLinearTransform(1.0),
        [](const openvdb::Vec3d& p) { return static_cast<float>(p.x()); });
  });
  SequenceParams params;
  params.budget = 6 * bytesOf(frames[1]);
  const auto of = sequenceOf(frames, 10.0, false, params);
  const Player player(of);
  for (int i = 0; i < 10; ++i) {
    REQUIRE(arrives(*of, 0.1 * i));
    CHECK(of->state().bytes <= params.budget);
  }
  CHECK(of->state().slots == 6);
}

TEST_CASE("a reader that waits reads the same values in every run, despite gaps and other readers",
          "[sequence][release]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 16, ramp);
  SequenceParams little = budgetOf(frames, 5.5);
  little.waits = true;
  const auto of = sequenceOf(frames, 10.0, true, little);
  const auto whole = sequenceOf(frames, 10.0, true);
  for (const int gone : {3, 8, 9, 10}) fs::remove(frames[static_cast<std::size_t>(gone)].file);
  const auto run = [&](std::uint64_t seed) {
    const Player player(of);
    Random random(seed);
    std::vector<double> read;
    double play = 0.0;
    for (int i = 0; i < 400; ++i) {
      play += 0.004;
      if (i % 80 == 40) play = 3.0 * random.uniform();
      read.push_back(player.at(play, kVoxel * Vec3(6.3, 5.2, 4.7), 4.0).value);
      if (read.back() != read.back() || i % 7 == 0) std::this_thread::yield();
    }
    return read;
  };
  (void)run(1);  // the sequence finds the missing frames
  const std::vector<double> alone = run(2);
  CHECK(run(2) == alone);
  std::vector<double> beside;
  std::thread other([&] { (void)run(3); });
  beside = run(2);
  other.join();
  CHECK(beside == alone);
}

TEST_CASE("an invalid sequence is refused with the reason", "[sequence]") {
  const TemporaryFolder folder;
  auto frames = framesIn(folder, 6, ramp);
  const auto refused = [&](const FrameTimes& when, const SequenceParams& params = {},
                           const Sampling& sampling = {}) -> std::string {
    try {
      const FrameSequence made(frames, when, placed(), sampling, params);
    } catch (const VolumeError& e) {
      return e.what();
    }
    return "taken";
  };
  CHECK(refused(evenTimes(6, 10.0, false)) == "taken");
  CHECK_THAT(refused({{0.0, 1.0}, false}), Contains("6 frames and 2 times"));
  CHECK_THAT(refused({{0.0, 1.0, 2.0, 3.0, 4.0, 5.0}, true}), Contains("6 frames and 6 times"));
  CHECK_THAT(refused({{0.0, 1.0, 1.0, 3.0, 4.0, 5.0}, false}), Contains("time 2"));
  CHECK_THAT(refused(evenTimes(6, 10.0, false), budgetOf(frames, 3.0)), Contains("holds 3 of"));
  CHECK_THAT(refused(evenTimes(6, 10.0, false), {}, {Interpolation::kTrilinear, true}),
             Contains("axial"));
  writeVdb(frames[4].file, {ball(4.0)});
  CHECK_THAT(refused(evenTimes(6, 10.0, false)),
             Contains("frame_4.vdb") && Contains("another kind"));
  fs::remove(frames[4].file);
  CHECK_THAT(refused(evenTimes(6, 10.0, false)), Contains("frame_4.vdb"));
  frames.clear();
  CHECK_THAT(refused({}), Contains("it does not have a frame"));
}

TEST_CASE("a frame without active voxels or without the grid plays as background",
          "[samplers][sequence]") {
  const TemporaryFolder folder;
  auto frames = framesIn(folder, 4, [](int i) {
    if (i == 0) {
      auto none = openvdb::FloatGrid::create();  // exporters write an empty grid without a class
      none->setName("ball");
      return none;
    }
    auto full = ball(4.0 + 0.2 * i);
    if (i == 2) full->setName("other");
    return full;
  });
  for (VolumeRequest& frame : frames) frame.grid = "ball";
  const auto sequence = sequenceOf(frames, 1.0);
  CHECK(sequence->state().empty == 2);
  REQUIRE(sequence->firstEmpty().size() == 2);
  CHECK_THAT(sequence->firstEmpty()[0], Contains("frame_0.vdb") && Contains("no active voxel"));
  CHECK_THAT(sequence->firstEmpty()[1], Contains("frame_2.vdb: there is no grid \"ball\""));
  CHECK(sequence->first()->info().active_voxels > 0);
  const Player player(sequence);
  for (const double empty : {0.0, 2.0}) {
    const ScalarSample s = player.settled(empty, Vec3::Zero());
    CHECK_FALSE(s.inside);
    CHECK(s.value == Approx(3.0));
  }
  const ScalarSample at = player.settled(1.0, Vec3(0.0042, 0.0, 0.0));
  CHECK(at.inside);
  CHECK(at.value == Approx(0.0).margin(0.05));
  // Halfway between an empty frame and a ball, the value is the mean.
  CHECK(player.settled(0.5, Vec3(0.0042, 0.0, 0.0)).value == Approx(1.5).margin(0.05));
  CHECK_THROWS_WITH(sequenceOf({frames[0], frames[2]}, 1.0),
                    Contains("frame_0.vdb") && Contains("no active voxel"));
}

TEST_CASE("a frame whose file has no grid plays as background", "[samplers][sequence]") {
  const TemporaryFolder folder;
  auto frames = framesIn(folder, 3, [](int i) { return ball(4.0 + 0.2 * i); });
  writeVdb(frames[1].file, {});
  const auto sequence = sequenceOf(frames, 1.0);
  CHECK(sequence->state().empty == 1);
  REQUIRE(sequence->firstEmpty().size() == 1);
  CHECK_THAT(sequence->firstEmpty()[0], Contains("frame_1.vdb: it does not have a grid"));
  CHECK_FALSE(Player(sequence).settled(1.0, Vec3(0.0042, 0.0, 0.0)).inside);
  CHECK_THROWS_WITH(sequenceOf({frames[1]}, 1.0),
                    Contains("frame_1.vdb") && Contains("does not have a grid"));
}

TEST_CASE("a frame without a class counts as fog, and a frame of another class is refused by name",
          "[samplers][sequence]") {
  const TemporaryFolder folder;
  const auto frames = framesIn(folder, 3, [](int i) {
    auto grid = i < 2 ? ramp(i) : ball(4.0);
    if (i == 1) grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    return grid;
  });
  CHECK_NOTHROW(sequenceOf({frames[0], frames[1]}, 1.0));
  CHECK_THROWS_WITH(sequenceOf(frames, 1.0), Contains("frame_2.vdb") && Contains("level set") &&
                                                 Contains("set the grid class of all"));
}

}  // namespace palpate::sequence_test
