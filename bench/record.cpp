/// Measures how much time a recording adds to a tick. Runs the haptic thread with and without a
/// Recorder, in turns. Times each tick from the reading of the hand until the tick is stored.
///
///     palpate_bench_record SCENE [--rate HZ] [--seconds S] [--turns N]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/machine.h"
#include "palpate/devices/recording/recorder.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;
using Clock = std::chrono::steady_clock;

struct Options {
  std::string scene;
  double rate = 10000.0;
  double seconds = 4.0;
  int turns = 10;
};

/// A device that records when its hand is read.
class Noting final : public Device {
 public:
  Noting(const HandTarget& hand, double rate) : inner_({}, {}, hand, rate) {}
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return inner_.info(); }
  [[nodiscard]] HandState read() noexcept override {
    begun = Clock::now();
    return inner_.read();
  }
  void write(const Vec3& force) noexcept override { inner_.write(force); }
  [[nodiscard]] bool ended() const noexcept override { return inner_.ended(); }

  Clock::time_point begun;

 private:
  SimulatedDevice inner_;
};

/// Passes each tick to the recorder, if there is one. Stores the time since the hand's reading.
class Kept final : public TickSink {
 public:
  Kept(const Noting& device, Recorder* recorder, std::size_t ticks)
      : device_(device), recorder_(recorder) {
    us.reserve(ticks + 1);
  }
  void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
    if (recorder_ != nullptr) recorder_->take(tick);
    const std::chrono::duration<double, std::micro> took = Clock::now() - device_.begun;
    if (us.size() < us.capacity()) us.push_back(took.count());
  }

  std::vector<double> us;

 private:
  const Noting& device_;
  Recorder* recorder_;
};

struct Times {
  std::vector<double> us;
  std::int64_t lost = 0;
};

void feel(const BuiltScene& built, const Options& options, bool recorded, Times& times) {
  const std::filesystem::path file = std::filesystem::temp_directory_path() / "palpate_bench.rec";
  Noting device(explore(built.bounds, options.seconds), options.rate);
  std::optional<Recorder> recorder;
  if (recorded) {
    recorder.emplace(file, RecordedSetting{device.info(), options.rate, {}});
    recorder->begin();
  }
  Kept kept(device, recorder ? &*recorder : nullptr,
            static_cast<std::size_t>(options.seconds * options.rate));
  LoopParams params;
  params.rate = options.rate;
  {
    HapticThread thread(device, params, &kept);
    thread.publish(built.scene);
    std::this_thread::sleep_for(std::chrono::duration<double>(options.seconds));
    thread.stop();
  }
  if (recorder) times.lost += recorder->lost();
  recorder.reset();
  std::filesystem::remove(file);
  times.us.insert(times.us.end(), kept.us.begin(), kept.us.end());
}

int run(const Options& options) {
  const BuiltScene built = buildScene(openScene(options.scene));
  std::printf("%s\n", bench::describe(bench::takeMachine(false)).c_str());
  std::printf("%s, %g Hz, %d turns of %g s each\n", options.scene.c_str(), options.rate,
              options.turns, options.seconds);
  Times plain;
  Times recorded;
  std::vector<double> shares;
  for (int turn = 0; turn < options.turns; ++turn) {
    Times a;
    Times b;
    feel(built, options, turn % 2 == 0, turn % 2 == 0 ? b : a);
    feel(built, options, turn % 2 != 0, turn % 2 != 0 ? b : a);
    shares.push_back(bench::percentile(b.us, 0.5) / bench::percentile(a.us, 0.5));
    plain.us.insert(plain.us.end(), a.us.begin(), a.us.end());
    recorded.us.insert(recorded.us.end(), b.us.begin(), b.us.end());
    recorded.lost += b.lost;
  }
  const auto row = [](const char* what, std::vector<double> us) {
    std::sort(us.begin(), us.end());
    const auto at = [&](double share) { return bench::percentileOfSorted(us, share); };
    std::printf("%-10s %9zu ticks  p50 %.3f  p99 %.3f  p99.9 %.3f  max %.1f us\n", what, us.size(),
                at(0.5), at(0.99), at(0.999), us.back());
  };
  row("plain", plain.us);
  row("recorded", recorded.us);
  std::sort(shares.begin(), shares.end());
  std::printf("medians, recorded/plain: %.3f (%.3f to %.3f); %lld ticks lost\n",
              shares[shares.size() / 2], shares.front(), shares.back(),
              static_cast<long long>(recorded.lost));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"What a recording costs a tick."};
    app.add_option("scene", options.scene, "a scene or a .vdb")->required();
    app.add_option("--rate", options.rate, "ticks a second, default 10000");
    app.add_option("--seconds", options.seconds, "of a turn, default 4");
    app.add_option("--turns", options.turns, "with and without, default 10");
    CLI11_PARSE(app, argc, argv);
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_record: %s\n", e.what());
    return 2;
  }
}
