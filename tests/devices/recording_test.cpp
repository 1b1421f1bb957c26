/// Tests recordings: reading back, damaged and truncated files, and replays with bit-identical
/// forces.
#include "palpate/devices/recording/recording.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <sys/resource.h>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

#include <catch2/catch.hpp>

#include "palpate/devices/recording/crc32c.h"
#include "palpate/devices/recording/recorder.h"
#include "palpate/devices/recording/replay_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "tests/support/counters.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"

namespace palpate::recording_test {
using Catch::Contains;
using palpate::test::ballField;
using palpate::test::ballSpec;
using palpate::test::CountScope;
using palpate::test::Random;

namespace fs = std::filesystem;

namespace {

/// A temporary folder, removed by the destructor.
struct Folder {
  fs::path path = fs::temp_directory_path() / ("palpate-recording-" + std::to_string(::getpid()));
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
  [[nodiscard]] fs::path file(const char* name) const { return path / name; }
};

/// Returns tick `number` with random values in its other fields.
Telemetry anyTick(std::int64_t number, Random& random) {
  RecordedTick tick{};
  const auto bits = [&] { return static_cast<std::uint8_t>(random.integer(2)); };
  const auto fault = [&] { return static_cast<std::uint8_t>(random.integer(kFaults)); };
  for (const RecordedField& field : recordedFields()) {
    for (std::size_t i = 0; i < field.count; ++i) {
      auto* at = reinterpret_cast<char*>(&tick) + field.offset;
      const double real = random.uniform(-1.0, 1.0);
      const auto whole = static_cast<std::int64_t>(random.integer(1 << 30));
      const auto half = static_cast<std::int32_t>(whole);
      switch (field.type[2]) {
        case '8':
          if (field.type[1] == 'f') std::memcpy(at + 8 * i, &real, 8);
          if (field.type[1] != 'f') std::memcpy(at + 8 * i, &whole, 8);
          break;
        case '4':
          std::memcpy(at + 4 * i, &half, 4);
          break;
        default:
          break;
      }
    }
  }
  tick.tick = number;
  for (std::uint8_t* flag : {&tick.fresh, &tick.ready, &tick.too_fast, &tick.cleared, &tick.limited,
                             &tick.missed, &tick.coarse, &tick.solver}) {
    *flag = bits();
  }
  for (std::uint8_t* why : {&tick.reported, &tick.wrong, &tick.order, &tick.unsent, &tick.fault}) {
    *why = fault();
  }
  tick.status = static_cast<std::uint8_t>(random.integer(kStepStatuses));
  return telemetryOf(tick);
}

bool same(const RecordedTick& a, const RecordedTick& b) {
  return std::memcmp(&a, &b, sizeof(RecordedTick)) == 0;
}

void put(const fs::path& file, const std::string& content) {
  std::ofstream(file, std::ios::binary) << content;
}

RecordedSetting setting() {
  RecordedSetting s;
  s.device.name = "an arm";
  s.device.limits = {3.3, 2000.0, 0.8, 12.0, 0.1, 0.5, {}};
  s.device.limits.tank.use = TankUse::kObserve;
  s.device.limits.tank.arm = {0.1, 0.2, 3e-5, 1e-3, 5e-4, 1e-4, 2e-3, 1.2e-3};
  s.rate = 1234.5;
  s.about = R"({"version": "0"})";
  return s;
}

}  // namespace

TEST_CASE("the checksum of a recording is CRC-32C", "[record]") {
  const auto of = [](const std::string& text) {
    return crc32c(std::as_bytes(std::span(text.data(), text.size())));
  };
  CHECK(of("123456789") == 0xE3069283U);  // RFC 3720, B.4
  CHECK(of(std::string(32, '\0')) == 0x8A9136AAU);
  CHECK(of(std::string(32, '\xFF')) == 0x62A8AB43U);
  const std::string text = "the proxy follows the probe, and the probe the hand";
  for (std::size_t cut = 0; cut <= text.size(); ++cut) {
    const auto bytes = std::as_bytes(std::span(text.data(), text.size()));
    CHECK(crc32c(bytes.subspan(cut), crc32c(bytes.first(cut))) == of(text));
  }
}

TEST_CASE("one wrong bit in a recording loses at most one chunk of 1024 ticks", "[record]") {
  const Folder folder;
  Random random(90);
  std::vector<RecordedTick> ticks;
  for (std::int64_t i = 1; i <= 5000; ++i) ticks.push_back(recordedTick(anyTick(i, random)));
  std::string file = recordingHeader(setting()) + recordingChunk(ticks);
  file[file.size() / 2] ^= 4;
  put(folder.file("a.rec"), file);
  const Recording recording(folder.file("a.rec"));
  CHECK(recording.size() == 5000 - 1024);
  CHECK(recording.lost() == 1024);
}

TEST_CASE("ticks, scenes and settings are read back from a recording unchanged", "[record]") {
  const Folder folder;
  Random random(91);
  const fs::path file = folder.file("a.rec");
  std::vector<RecordedTick> ticks;
  {
    Recorder recorder(file, setting());
    recorder.expect({7, "{\"a scene\": 1}"});
    recorder.begin();
    for (std::int64_t i = 1; i <= 10000; ++i) {
      if (i == 5000) recorder.expect({8, std::string(5000, 'x')});
      const Telemetry tick = anyTick(i, random);
      ticks.push_back(recordedTick(tick));
      recorder.take(tick);
      if (i % 1000 == 0) recorder.wait();
    }
    recorder.end();
    CHECK(recorder.lost() == 0);
    CHECK(recorder.trouble().empty());
  }
  CHECK(isRecording(file));
  const Recording recording(file);
  REQUIRE(recording.size() == 10000);
  CHECK(recording.torn() == 0);
  CHECK(recording.lost() == 0);
  for (std::int64_t i = 0; i < recording.size(); ++i) {
    REQUIRE(same(recording.tick(i), ticks[static_cast<std::size_t>(i)]));
    REQUIRE(same(recordedTick(telemetryOf(recording.tick(i))), recording.tick(i)));
  }
  REQUIRE(recording.scenes().size() == 2);
  CHECK(recording.scenes()[0].id == 7);
  CHECK(recording.scenes()[0].text == "{\"a scene\": 1}");
  CHECK(recording.scenes()[1].text == std::string(5000, 'x'));
  CHECK(recording.setting().rate == 1234.5);
  CHECK(recordingHeader(recording.setting()) == recordingHeader(setting()));
}

TEST_CASE("the intact chunks of a truncated or damaged recording are read", "[record]") {
  const Folder folder;
  Random random(92);
  std::string whole = recordingHeader(setting());
  const std::size_t header = whole.size();
  const std::string scene = recordingChunk(RecordedScene{1, "a scene"});
  // Three chunks of three ticks.
  std::vector<std::size_t> ends{header + scene.size()};
  whole += scene;
  for (std::int64_t first = 1; first <= 7; first += 3) {
    std::vector<RecordedTick> ticks;
    for (std::int64_t i = 0; i < 3; ++i) ticks.push_back(recordedTick(anyTick(first + i, random)));
    whole += recordingChunk(ticks);
    ends.push_back(whole.size());
  }
  const fs::path file = folder.file("torn.rec");
  const auto ticksOf = [&](const std::string& content) {
    put(file, content);
    return Recording(file).size();
  };
  CHECK(ticksOf(whole) == 9);
  CHECK(Recording(file).incomplete().empty());
  // Cuts the file at every seventh byte after the header.
  for (std::size_t end = header; end <= whole.size(); end += 7) {
    const auto chunks = std::count_if(ends.begin(), ends.end(), [&](auto e) { return e <= end; });
    CAPTURE(end);
    REQUIRE(ticksOf(whole.substr(0, end)) == 3 * std::max<std::int64_t>(0, chunks - 1));
  }
  put(file, whole.substr(0, whole.size() - 1));
  CHECK(Recording(file).torn() == ends[3] - ends[2] - 1);
  CHECK(Recording(file).damaged() == 0);
  // One flipped bit after the header loses one chunk. The chunks after it are still read.
  for (long i = 0; i < test::cases(400); ++i) {
    std::string damaged = whole;
    const auto at =
        header + static_cast<std::size_t>(random.integer(static_cast<int>(whole.size() - header)));
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << random.integer(8)));
    const auto chunk =
        static_cast<std::size_t>(std::upper_bound(ends.begin(), ends.end(), at) - ends.begin());
    const std::size_t bytes = ends[chunk] - (chunk == 0 ? header : ends[chunk - 1]);
    CAPTURE(at, chunk);
    put(file, damaged);
    const Recording recording(file);
    REQUIRE(recording.size() == (chunk == 0 ? 9 : 6));
    REQUIRE(recording.scenes().size() == (chunk == 0 ? 0 : 1));
    REQUIRE(recording.damaged() + recording.torn() == bytes);
    // If the flipped bit is in the length of the last chunk, this chunk seems incomplete.
    if (chunk < 3) REQUIRE(recording.torn() == 0);
    REQUIRE(recording.lost() == (chunk == 2 ? 3 : 0));
    REQUIRE(recording.tick(0).tick == (chunk == 1 ? 4 : 1));
    if (chunk == 2) {
      CHECK_THAT(recording.incomplete(), Contains("are damaged and skipped; 3 ticks"));
    }
  }
  // Chunks whose ticks were already read, or are older than those, are ignored.
  const auto chunk = [&](std::size_t i) { return whole.substr(ends[i], ends[i + 1] - ends[i]); };
  CHECK(ticksOf(whole + chunk(1)) == 9);
  CHECK(Recording(file).damaged() == ends[2] - ends[1]);
  CHECK(ticksOf(whole.substr(0, ends[0]) + chunk(1) + chunk(0) + chunk(2)) == 6);
  CHECK(Recording(file).lost() == 0);
  // Any chunk mark can begin a chunk. The search must be fast even in a file full of marks.
  const std::size_t record = sizeof(RecordedTick);
  std::string marks;
  for (std::uint64_t left = 8000; left-- > 0;) {
    std::string mark = chunk(0).substr(0, record);
    std::memcpy(mark.data() + 24, &left, sizeof left);  // number of records that follow
    marks += mark;
  }
  CHECK(ticksOf(whole.substr(0, header) + marks) == 0);
  for (std::size_t end = 0; end < header; end += 41) {
    CAPTURE(end);
    REQUIRE_THROWS_AS(ticksOf(whole.substr(0, end)), Error);
  }
  // Truncates the file of an open recording, which must not read the file again.
  put(file, whole);
  const Recording before(file);
  std::filesystem::resize_file(file, 0);
  CHECK(before.tick(before.size() - 1).tick == 9);
  CHECK_THROWS_WITH(ticksOf("t,x,y,z\n"), Contains("it is not a recording"));
  CHECK_THROWS_WITH(Recording(folder.file("none.rec")), Contains("it cannot be read"));
  CHECK_THROWS_WITH(Recording(folder.path), Contains("it is not a file"));
  std::string other = whole;
  other.replace(other.find("[\"time\""), 7, "[\"tame\"");
  CHECK_THROWS_WITH(ticksOf(other), Contains("another version"));
  const auto header_with = [&](const std::string& from, const std::string& to) {
    std::string bad = whole;
    bad.replace(bad.find(from), from.size(), to);
    return ticksOf(bad);
  };
  CHECK_THROWS_AS(header_with("\"rate\":1234.5", "\"rate\":-234.5"), Error);
  CHECK_THROWS_AS(header_with("\"peak\":3.3", "\"peak\":-.3"), Error);
  CHECK_THROWS_AS(header_with("\"peak\":3.3", "\"peak\":-3 "), Error);
  CHECK_THROWS_AS(header_with("\"offset\":", "\"offset\":1"), Error);
  // Before version 5, the byte of `coarse` belonged to `zero`.
  std::string old = whole;
  const auto change = [&old](const std::string& from, const std::string& to) {
    REQUIRE(to.size() <= from.size());
    old.replace(old.find(from), from.size(), to + std::string(from.size() - to.size(), ' '));
  };
  change("\"palpate_recording\":5", "\"palpate_recording\":4");
  CHECK_THROWS_WITH(ticksOf(old), Contains("another version"));
  change(R"(["coarse","u1"],["zero","u1",6])", R"(["zero","u1",7])");
  CHECK(ticksOf(old) == 9);
  const std::string deep(200000, '[');
  CHECK_THROWS_AS(header_with("{\"version\"", deep + "{\"version\""), Error);
}

TEST_CASE("a full disk ends the recording and leaves its file readable", "[record][fault]") {
  const Folder folder;
  const fs::path file = folder.file("full.rec");
  CHECK_THROWS_WITH(Recorder(folder.path, setting()).begin(), Contains("it cannot be written"));
  CHECK_THROWS_WITH(Recorder(folder.path / "no" / "a.rec", setting()), Contains("No such file"));
  // Without a call of begin(), the recorder leaves an existing file unchanged.
  put(file, "what was there");
  { const Recorder never(file, setting()); }
  CHECK(fs::file_size(file) == 14);
  CHECK(std::distance(fs::directory_iterator(folder.path), {}) == 1);
  // Limits the file size, to simulate a full disk.
  struct rlimit before {};
  REQUIRE(::getrlimit(RLIMIT_FSIZE, &before) == 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  struct rlimit less = before;
  less.rlim_cur = 200000;
  REQUIRE(::setrlimit(RLIMIT_FSIZE, &less) == 0);
  Random random(93);
  std::string trouble;
  {
    Recorder recorder(file, setting());
    recorder.begin();
    const auto header = fs::file_size(file);
    for (std::int64_t i = 1; i <= 20000; ++i) {
      recorder.take(anyTick(i, random));
      // The recorder must have written some ticks before the simulated disk is full.
      while (i == 50 && fs::file_size(file) == header) std::this_thread::yield();
      if (!recorder.trouble().empty()) break;
    }
    recorder.end();
    trouble = recorder.trouble();
  }
  REQUIRE(::setrlimit(RLIMIT_FSIZE, &before) == 0);
  std::signal(SIGXFSZ, handler);
  CHECK_THAT(trouble, Contains("writing stopped (File too large)"));
  const Recording recording(file);
  CHECK(recording.torn() == 0);
  CHECK(recording.size() > 0);
  CHECK(fs::file_size(file) <= 200000);
}

TEST_CASE("recording a tick neither allocates nor locks", "[record][realtime]") {
  const Folder folder;
  Recorder recorder(folder.file("many.rec"), setting());
  recorder.begin();
  Random random(94);
  const Telemetry tick = anyTick(1, random);
  const CountScope scope;
  for (int i = 0; i < 1000; ++i) recorder.take(tick);
  const test::Counts counts = CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
}

namespace {

/// A device that reports several faults at random times.
class TroubledDevice final : public Device {
 public:
  explicit TroubledDevice(std::uint64_t seed) : random_(seed) {
    info_.name = "troubled";
    info_.limits = {3.0, 1500.0, 1.0, 3.0, 0.1, 0.05, {}};
    info_.limits.tank.use = TankUse::kAct;
    info_.limits.tank.arm = {0.2, 0.1, 1e-5, 1e-3, 2e-4, 1e-4, 0.0, 0.0};
  }
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override {
    const double t = 1e-3 * static_cast<double>(++ticks_);
    HandState hand;
    hand.position = 0.034 * Vec3(std::sin(2.0 * t), std::cos(1.7 * t), std::sin(0.9 * t + 1.0));
    hand.drives = Mat3::Identity() - 0.1 * hand.position * hand.position.transpose();
    const auto now_and_then = [&](int each) { return random_.integer(each) == 0; };
    if (now_and_then(3)) {
      hand.position = last_;
      hand.age = 1e-3;
    }
    last_ = hand.position;
    if (now_and_then(3000)) hand.ready = false;
    using Limits = std::numeric_limits<double>;
    if (now_and_then(4000)) {
      hand.position.x() = ticks_ % 2 == 0 ? -Limits::infinity() : Limits::quiet_NaN();
    }
    if (now_and_then(4000)) hand.position.y() += 0.1;
    if (now_and_then(4000)) hand.age = 1.0;
    if (now_and_then(4000)) hand.fault = Fault::kTemperature;
    hand.still = now_and_then(50) ? 2.0 : 0.0;
    given_ = now_and_then(10) ? random_.uniform() : 1.0;
    return hand;
  }
  void write(const Vec3& /*force*/) noexcept override {}
  [[nodiscard]] double given() const noexcept override { return given_; }

 private:
  Random random_;
  DeviceInfo info_;
  std::int64_t ticks_ = 0;
  Vec3 last_ = Vec3::Zero();
  double given_ = 1.0;
};

struct Kept final : TickSink {
  std::vector<RecordedTick> ticks;
  explicit Kept(std::size_t room) { ticks.reserve(room); }
  void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
    ticks.push_back(recordedTick(tick));
  }
};

}  // namespace

namespace {

/// The recorded ticks of a hand with random faults in changing scenes, and the scenes.
struct Troubles {
  DeviceInfo device;
  std::vector<RecordedTick> ticks;
  std::vector<std::shared_ptr<const Scene>> scenes;

  /// @param around Called with true before each tick, with false after it. Changes and restores the
  /// thread's floating-point mode.
  explicit Troubles(std::size_t count, const std::function<void(bool)>& around = {}) {
    Random random(95);
    TroubledDevice hand(96);
    device = hand.info();
    Kept kept(count);
    HapticLoop loop(hand, 1000.0, &kept);
    // The first ticks have no scene. The scenes differ in numbers; the last three have one more
    // mode.
    for (int i = 0; i < 6; ++i) {
      GraphSpec spec = ballSpec(0.5 + i);
      spec.modes[0].friction = 0.1 * i;
      spec.modes[0].viscosity = i % 2 == 0 ? 0.2 : 0.0;
      if (i >= 3) spec.modes.push_back(spec.modes[0]);
      scenes.push_back(makeScene(spec, {{"ball", ballField()}}, {400.0 + 50.0 * i, 0.5}));
    }
    TickTime time;
    for (std::size_t i = 0; i < count; ++i) {
      time.dt = 1e-3;
      time.late = 0.0;
      if (random.integer(3000) == 0) time.late = random.uniform(0.0, 0.01);
      if (random.integer(100) == 0) time.dt = random.uniform(0.0, 3e-3);
      time.now += time.dt;
      if (random.integer(1500) == 0) {
        loop.publish(scenes[static_cast<std::size_t>(random.integer(6))]);
      }
      if (random.integer(4000) == 0) loop.cut();
      if (random.integer(60) == 0) loop.clear();
      if (around) around(true);
      loop.tick(time);
      if (around) around(false);
    }
    ticks = std::move(kept.ticks);
  }

  /// Replays the ticks. Returns the number of the first tick that differs; 0 if all are equal.
  [[nodiscard]] std::int64_t firstOther() const {
    std::map<std::uint64_t, const Scene*> by_id{{0, nullptr}};
    for (const auto& scene : scenes) by_id[scene->id] = scene.get();
    HandTick again(limitsInLoop(device, 1000.0));
    for (const RecordedTick& tick : ticks) {
      Telemetry told = telemetryOf(tick);
      told.report = again.step(by_id.at(told.scene), told.input);
      again.withhold(told.input, told.report);
      again.sent(told.input);
      told.fault = again.state().fault();
      if (!same(recordedTick(told), tick)) return tick.tick;
    }
    return 0;
  }
};

}  // namespace

TEST_CASE("a run with many faults replays bit for bit", "[record][replay]") {
  const auto count = static_cast<std::size_t>(test::cases(200000));
  const Troubles troubles(count);
  REQUIRE(troubles.ticks.size() == count);
  CHECK(troubles.firstOther() == 0);
  if (count < 200000) return;
  std::array<std::int64_t, kFaults> faults{};
  double felt = 0.0;
  for (const RecordedTick& tick : troubles.ticks) {
    ++faults[tick.fault];
    felt = std::max(felt, telemetryOf(tick).report.force.norm());
  }
  CHECK(felt > 1.0);
  for (const Fault fault : {Fault::kNone, Fault::kNotFinite, Fault::kLate, Fault::kStale,
                            Fault::kJump, Fault::kTemperature, Fault::kStopped}) {
    CAPTURE(wordFor(fault));
    CHECK(faults[static_cast<std::size_t>(fault)] > 0);
  }
}

#if defined(__x86_64__)
TEST_CASE(
    "a replay is bitwise equal if the host flushes denormals, rounds upwards or enables traps",
    "[record][replay]") {
  const Troubles troubles(20000);
  const unsigned before = _mm_getcsr();
  constexpr unsigned kFlush = 0x8040;    // treats denormals as zero
  constexpr unsigned kUpwards = 0x4000;  // rounds upwards
  constexpr unsigned kMasks = 0x0E80;    // masks of invalid, zero divide, overflow and underflow
  for (const unsigned host : {before | kFlush, before | kUpwards, before & ~kMasks}) {
    CAPTURE(host);
    _mm_setcsr(host);
    const std::int64_t other = troubles.firstOther();
    const unsigned after = _mm_getcsr();
    _mm_setcsr(before);
    CHECK(other == 0);
    // Each tick restores the caller's floating-point mode.
    CHECK((after & ~0x3FU) == (host & ~0x3FU));
    // A loop that is called in this mode gives the same ticks.
    const Troubles again(troubles.ticks.size(), [&](bool set) { _mm_setcsr(set ? host : before); });
    for (std::size_t i = 0; i < again.ticks.size(); ++i) {
      RecordedTick tick = again.ticks[i];
      tick.tick_ns = troubles.ticks[i].tick_ns;
      tick.scene = troubles.ticks[i].scene;  // ids of scenes differ from run to run
      REQUIRE(same(tick, troubles.ticks[i]));
    }
  }
}
#endif

TEST_CASE("a replay starts at a given time and gives the recorded positions and force shares",
          "[replay]") {
  const Folder folder;
  const fs::path file = folder.file("hand.rec");
  Random random(97);
  {
    Recorder recorder(file, setting());
    recorder.begin();
    for (std::int64_t i = 1; i <= 1000; ++i) {
      Telemetry tick = anyTick(i, random);
      tick.time = 1e-3 * static_cast<double>(i - 1);
      recorder.take(tick);
    }
  }
  const auto device = openReplay(file.string() + "@0.4995");
  CHECK(device->begin() == 500);
  CHECK(device->info().name == "an arm");
  const Recording recording(file);
  for (std::int64_t i = 500; i < 1000; ++i) {
    REQUIRE_FALSE(device->ended());
    const RecordedTick tick = recording.tick(i);
    REQUIRE(device->read().position == telemetryOf(tick).probe);
    device->write(Vec3::Zero());
    REQUIRE(device->given() == tick.given);
  }
  CHECK(device->ended());
  CHECK_THROWS_WITH(openReplay(file.string() + "@2"), Contains("it ends at 0.999 s"));
  CHECK_THROWS_WITH(openReplay(file.string() + "@soon"), Contains("hand.rec@soon: it cannot"));
  CHECK_FALSE(nameAt("nan@inf").seconds);
  CHECK_FALSE(nameAt("ke@ep.rec").seconds);
  CHECK(nameAt("a@b@1.5").name == "a@b");
  CHECK_THROWS_WITH(openReplay("none.rec"), Contains("it cannot be read"));
}

}  // namespace palpate::recording_test
