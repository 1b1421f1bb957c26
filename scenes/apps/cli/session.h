/// Runs the hands of `palpate feel` in real time or in virtual time.
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
#include "palpate/scenes/apps/common/explain_tick.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/network/sites/site.h"
#include "palpate/scenes/network/slicer/igtl_server.h"

namespace palpate::cli {

class Watcher;

/// Default of LoopParams::reengage in `palpate feel` and `palpate view` [s].
inline constexpr double kReengage = 2.0;

struct FeelOptions {
  std::string scene;
  std::vector<std::string> devices{"simulated"};
  std::optional<double> seconds;
  double rate = 1000.0;
  bool rate_given = false;  ///< True if the user has set the rate.
  bool realtime = false;
  std::optional<double> reengage;  ///< Value of --reengage; unset: kReengage.
  bool watch = false;
  bool passive = false;
  double refill = 0.0;
  /// Time of the tick that `palpate explain --until` explains [s]: the run ends there.
  std::optional<double> until;
  /// This site, in the form for siteFrom(); empty: no connection to other sites.
  std::string site;
  std::vector<std::string> with;  ///< Addresses of the machines of other sites.
  std::string site_keys;          ///< SiteParams::keys.
  bool own_scene = false;         ///< If true, exchanges no edits of the scene with other sites.
  bool window = false;
  std::optional<double> speed;  ///< Speed of a replay; 1: as recorded; unset: as fast as possible.
  std::string still;            ///< File for a picture of the last tick.
  std::string camera;           ///< Side from which this picture shows the scene; empty: default.
  std::string slice;            ///< Planes of its slices: x, y, z or all; empty: no slices.
  std::string igtl;             ///< Address at which 3D Slicer connects; empty: no server.
  double igtl_rate = kIgtlRate;
  std::string record;
  std::string trace;
  std::string summary;
  PictureOptions picture;
  bool verbose = false;
  bool json = false;
};

/// Resolution of FeelOptions::until [s], below the duration of a tick.
inline constexpr double kTimeGrid = 1e-6;

/// The ticks of a run in virtual time so far, for explainRun().
struct RunSoFar {
  std::vector<RunTick> ticks;
  double time = 0.0;        ///< Time of the last tick [s].
  std::uint64_t scene = 0;  ///< Telemetry::scene of the last tick.
  bool edited = false;      ///< True if the scene was replaced.
  Near near;                ///< Parts near the hand since the force was last zero.

  void add(const Telemetry& tick, const ProxyState& state);
};

/// Receives every tick of a hand: adds it to the results, passes it to the window and the recorder,
/// and queues a row for trace and picture.
class Log final : public TickSink {
 public:
  Log(const Scene& scene, double rate, bool rows) : felt(scene, rate) {
    if (rows) ring_.emplace(kRows);
  }
  void take(const Telemetry& tick, const ProxyState& state) noexcept override {
    felt.add(tick, state);
    if (live != nullptr) live->take(tick, state);
    if (recorder != nullptr) recorder->take(tick);
    if (kept) kept->add(tick, state);
    if (ring_ && !ring_->try_emplace(tick, felt.loads())) ++lost_;
  }
  /// Calls `take` for each queued row. Call drain() on the thread that writes the trace.
  template <class Take>
  void drain(const Take& take) {
    if (!ring_) return;
    while (const Row* row = ring_->peek()) {
      take(row->tick, std::span(row->loads).first(felt.carriers().size()));
      ring_->pop();
    }
  }
  /// Returns the number of rows that were lost because the queue was full.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }

  /// Announces the scene of the next ticks, with its gains. Call expect() before you publish the
  /// scene.
  void expect(const Scene& scene, const std::vector<LiveDial>& dials) {
    felt.expect(scene);
    if (live != nullptr) live->expect(scene, dials);
  }

  Felt felt;
  LiveWriter* live = nullptr;    ///< Writer for the window; null: no window.
  Recorder* recorder = nullptr;  ///< Null if the run is not recorded.
  std::optional<RunSoFar> kept;  ///< Unset: no tick of the run is explained.

 private:
  struct Row {
    Row(const Telemetry& t, std::span<const double> l) noexcept : tick(t) {
      std::copy(l.begin(), l.end(), loads.begin());
    }
    Telemetry tick;
    Loads loads;  ///< Loads of the carriers, in the order of Felt::carriers().
  };
  static constexpr std::size_t kRows = 32768;  // 3 s at 10 kHz
  // try_emplace never grows the queue, and so does not allocate.
  std::optional<moodycamel::ReaderWriterQueue<Row>> ring_;
  std::int64_t lost_ = 0;
};

struct Hand {
  Log log;  // first member, because its queue is aligned to cache lines
  std::unique_ptr<Device> device;
  std::unique_ptr<Recorder> recorder;
  bool told_unwritten = false;
  Trace trace;
  Picture* picture = nullptr;  ///< Picture of the first hand; null for other hands.
  OrderedJson granted;

  Hand(std::unique_ptr<Device> d, const Scene& scene, const FeelOptions& options,
       const std::string& trace_place, Picture* drawn)
      : log(scene, options.rate, !trace_place.empty() || drawn != nullptr),
        device(std::move(d)),
        trace(trace_place, log.felt.carriers()),
        picture(drawn) {}
  /// Prints once why the recording has stopped.
  void tellUnwritten(const std::string& name) {
    if (!recorder || told_unwritten) return;
    const std::string why = recorder->trouble();
    if (why.empty()) return;
    told_unwritten = true;
    complain(name + ": --record " + recorder->file().string() + ": " + why +
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

/// Data that are loaded during a run: bricks near the hands, and frames before they are played.
class Fetched {
 public:
  void now(const BuiltScene& built) {
    windows_ = built.windows;
    sequences_ = built.sequences;
  }
  void tellTroubles() const;
  /// Adds the keys "bricks" and "sequences" to the summary, with an entry for each volume of this
  /// kind. Without such a volume, the key is missing.
  void addTo(OrderedJson& summary) const;
  void sayThem() const;
  [[nodiscard]] const std::map<std::string, std::shared_ptr<const FrameSequence>>& sequences()
      const {
    return sequences_;
  }

 private:
  Windows windows_;
  std::map<std::string, std::shared_ptr<const FrameSequence>> sequences_;
};

/// Connects the first hand with the hands at other sites in the same scene.
class WithSites {
 public:
  /// Makes no connection if the options name no site. Throws Error.
  WithSites(const FeelOptions& options, const DeviceInfo& device, const SceneInput& from);
  /// Returns the links for the first hand's loop; null: not connected.
  [[nodiscard]] HandLinks* links() noexcept { return links_ ? &*links_ : nullptr; }
  void tellNews();
  /// Returns true if this site exchanges edits of the scene with other sites.
  [[nodiscard]] bool share() const noexcept { return shares_; }
  void begin(Watcher& watcher, const SceneInput& from) const;
  void hear(Watcher& watcher);
  void tell(Watcher& watcher);
  void addTo(OrderedJson& summary) const;
  void sayThem() const;

 private:
  std::optional<HandLinks> links_;
  std::unique_ptr<Site> site_;
  std::string name_;
  bool shares_ = false;
};

/// The latest scene of a run after an edit.
struct EditedScene {
  SceneSpec spec;    ///< Before gains are applied.
  BuiltScene built;  ///< With gains and images.
};

/// The checked input of a run, and objects that its hands share.
struct Run {
  const FeelOptions& options;
  Hands& hands;
  std::shared_ptr<const Scene> scene;
  const SceneSpec& spec;
  std::optional<std::filesystem::file_time_type> written;  ///< Last write of the scene file.
  SceneCache& cache;
  const SceneInput& from;
  std::int64_t ticks = 0;  ///< Largest number of ticks of the run.
  bool whole_path = false;
  Window* window = nullptr;
  WithSites* sites = nullptr;
  IgtlServer* igtl = nullptr;
  Fetched fetched{};
  PlayParams play{};
  std::optional<EditedScene> edited{};  ///< Unset: `scene` and `spec` are the only scene.
  CouplingParams stiffest{};            ///< Stiffest coupling of all scenes so far.

  /// Returns the prefix of messages about a hand, with its number if there are several.
  [[nodiscard]] std::string nameOf(std::size_t hand) const {
    return hands.size() == 1 ? "feel" : fmt::format("feel: hand {}", hand + 1);
  }
};

/// Runs the ticks in virtual time, as fast as possible. Repeated runs give equal results.
void runInVirtualTime(const Run& run);
/// Replays recorded hands one after the other, at `run.options.speed`; each device must be a
/// ReplayDevice. `scenes` contains scenes by recorded id; ticks of other ids, except 0 (no scene),
/// use `run.scene`. Ends early after an interrupt, or if the window closes or fails.
void runAgain(const Run& run, const ScenesById& scenes);
/// Runs the hands in real time, each in its own thread. If a loop stands still, ends the program.
void runOnTime(Run& run, Guardian& guardian);

}  // namespace palpate::cli
