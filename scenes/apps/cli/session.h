/// Runs the hands of `palpate feel`, each with its device and results, in real time or virtual
/// time.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <readerwriterqueue.h>
#include <span>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/recording/recorder.h"
#include "palpate/devices/recording/replay_device.h"
#include "palpate/engine/loop/telemetry.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/scenes/apps/cli/felt.h"
#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/cli/trace.h"
#include "palpate/scenes/apps/cli/window.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/network/sites/site.h"
#include "palpate/scenes/network/slicer/igtl_server.h"

namespace palpate::cli {

class Watcher;

inline constexpr double kReengage = 2.0;  ///< LoopParams::reengage of `feel` and `view` [s].

/// Options of the command line.
struct FeelOptions {
  std::string scene;
  std::vector<std::string> devices{"simulated"};
  std::optional<double> seconds;
  double rate = 1000.0;
  bool realtime = false;
  std::optional<double> reengage;  ///< The user's choice, else kReengage.
  bool watch = false;
  bool passive = false;
  double refill = 0.0;
  std::string site;               ///< In the format of siteFrom; empty: no site.
  std::vector<std::string> with;  ///< Machines of other sites.
  std::string site_keys;          ///< SiteParams::keys
  bool own_scene = false;         ///< Sites neither edit the scene nor receive its edits.
  bool window = false;
  std::optional<double> speed;  ///< Speed of recorded hands; 1: original; unset: unlimited.
  std::string still;            ///< A picture drawn by the window's program.
  std::string igtl;             ///< Address for 3D Slicer's connections; empty: not used.
  double igtl_rate = kIgtlRate;
  std::string record;
  std::string trace;
  std::string summary;
  std::string picture;
  bool verbose = false;
  bool json = false;
};

/// Takes every tick: counts it at once, and queues it for the thread that writes, if requested.
class Log final : public TickSink {
 public:
  Log(const Scene& scene, double rate, bool rows) : felt(scene, rate) {
    if (rows) ring_.emplace(kRows);
  }
  void take(const Telemetry& tick, const ProxyState& state) noexcept override {
    felt.add(tick, state);
    if (live != nullptr) live->take(tick, state);
    if (recorder != nullptr) recorder->take(tick);
    if (ring_ && !ring_->try_emplace(tick, felt.loads())) ++lost_;
  }
  /// Passes queued rows to `take`, on the thread that writes.
  template <class Take>
  void drain(const Take& take) {
    if (!ring_) return;
    while (const Row* row = ring_->peek()) {
      take(row->tick, std::span(row->loads).first(felt.carriers().size()));
      ring_->pop();
    }
  }
  /// Returns the number of rows that did not fit in the queue.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }

  /// Announces the scene of the next ticks, before it is published; `dials`: gains of its modes.
  void expect(const Scene& scene, const std::vector<LiveDial>& dials) {
    felt.expect(scene);
    if (live != nullptr) live->expect(scene, dials);
  }

  Felt felt;
  LiveWriter* live = nullptr;    ///< Writer of a window.
  Recorder* recorder = nullptr;  ///< Null: not recording.

 private:
  struct Row {
    Row(const Telemetry& t, std::span<const double> l) noexcept : tick(t) {
      std::copy(l.begin(), l.end(), loads.begin());
    }
    Telemetry tick;
    Loads loads;  ///< One for each carrier.
  };
  static constexpr std::size_t kRows = 32768;  // 3 s at 10 kHz
  // Never grows: try_emplace does not allocate.
  std::optional<moodycamel::ReaderWriterQueue<Row>> ring_;
  std::int64_t lost_ = 0;
};

/// One hand: its device, its results and their outputs.
struct Hand {
  Log log;  // first: its ring has cache lines of its own
  std::unique_ptr<Device> device;
  std::unique_ptr<Recorder> recorder;
  bool told_unwritten = false;
  Trace trace;
  Picture* picture = nullptr;  ///< Only the first hand has one.
  OrderedJson granted;

  Hand(std::unique_ptr<Device> d, const Scene& scene, const FeelOptions& options,
       const std::string& trace_place, Picture* drawn)
      : log(scene, options.rate, !trace_place.empty() || drawn != nullptr),
        device(std::move(d)),
        trace(trace_place, log.felt.carriers()),
        picture(drawn) {}
  /// Reports once why recording has stopped.
  void tellUnwritten(const std::string& name) {
    if (!recorder || told_unwritten) return;
    const std::string why = recorder->trouble();
    if (why.empty()) return;
    told_unwritten = true;
    complain(name + ": --record: " + why +
             ": the run continues; the ticks written so far are complete");
  }
  void drain() {
    log.drain([this](const Telemetry& tick, std::span<const double> loads) {
      trace.add(tick, loads);
      if (picture != nullptr) picture->add(tick);
    });
  }
};
using Hands = std::vector<std::unique_ptr<Hand>>;

/// Data that are loaded during a run: bricks near hands, frames ahead of playback.
class Fetched {
 public:
  /// Takes the windows and sequences of this scene.
  void now(const BuiltScene& built) {
    windows_ = built.windows;
    sequences_ = built.sequences;
  }
  /// Reports errors since the last call.
  void tellTroubles() const;
  /// Adds "bricks" and "sequences", by names of volumes, if there are any.
  void addTo(OrderedJson& summary) const;
  void sayThem() const;
  /// Returns the sequences by name.
  [[nodiscard]] const std::map<std::string, std::shared_ptr<const FrameSequence>>& sequences()
      const {
    return sequences_;
  }

 private:
  Windows windows_;
  std::map<std::string, std::shared_ptr<const FrameSequence>> sequences_;
};

/// Connects the first hand with hands at other sites, in one scene.
class WithSites {
 public:
  /// Makes no links if the options name no site. `from`: the scene. Throws Error.
  WithSites(const FeelOptions& options, const DeviceInfo& device, const SceneInput& from);
  /// Returns the links for the first hand's loop; null: not connected.
  [[nodiscard]] HandLinks* links() noexcept { return links_ ? &*links_ : nullptr; }
  /// Prints the news since the last call.
  void tellNews();
  /// Returns whether other sites edit the scene.
  [[nodiscard]] bool share() const noexcept { return shares_; }
  /// Makes the scene a shared one.
  void begin(Watcher& watcher, const SceneInput& from) const;
  /// Receives the other sites' edits.
  void hear(Watcher& watcher);
  /// Sends new edits to the other sites.
  void tell(Watcher& watcher);
  /// Adds "sites", by their names.
  void addTo(OrderedJson& summary) const;
  void sayThem() const;

 private:
  std::optional<HandLinks> links_;
  std::optional<Site> site_;
  std::string name_;
  bool shares_ = false;
};

/// The checked input of a run.
struct Run {
  const FeelOptions& options;
  Hands& hands;
  std::shared_ptr<const Scene> scene;
  const SceneSpec& spec;                                   ///< Description of the scene.
  std::optional<std::filesystem::file_time_type> written;  ///< Write time of the scene's file.
  SceneCache& cache;
  const SceneInput& from;  ///< Source of the scene.
  std::int64_t ticks = 0;  ///< Largest number of ticks.
  bool whole_path = false;
  Window* window = nullptr;
  WithSites* sites = nullptr;
  IgtlServer* igtl = nullptr;
  Fetched fetched{};
  PlayParams play{};  ///< Playback of `scene`.

  /// Returns the prefix of messages, with the hand's number if there are several.
  [[nodiscard]] std::string nameOf(std::size_t hand) const {
    return hands.size() == 1 ? "feel" : fmt::format("feel: hand {}", hand + 1);
  }
};

/// Runs as fast as possible; results are the same every time.
void runInVirtualTime(const Run& run);
/// Replays recorded hands with identical results; every device must be a ReplayDevice. Runs at
/// `run.options.speed` and until its window is closed. `scenes`: the ticks' scenes by their
/// recorded ids; missing ones are `run.scene`.
void runAgain(const Run& run, const ScenesById& scenes);
/// Runs in real time, one thread for each hand.
void runOnTime(Run& run, Guardian& guardian);

}  // namespace palpate::cli
