/// What `palpate feel` runs: hands, each with its device and what it has felt, on time or not.
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

#include "palpate/devices/guardian.h"
#include "palpate/devices/recorder.h"
#include "palpate/devices/replay_device.h"
#include "palpate/engine/device.h"
#include "palpate/engine/scene.h"
#include "palpate/engine/telemetry.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/felt.h"
#include "palpate/scenes/cli/igtl_server.h"
#include "palpate/scenes/cli/picture.h"
#include "palpate/scenes/cli/recorded.h"
#include "palpate/scenes/cli/trace.h"
#include "palpate/scenes/cli/window.h"
#include "palpate/scenes/live.h"
#include "palpate/scenes/scene_cache.h"
#include "palpate/scenes/site/site.h"

namespace palpate::cli {

class Watcher;

/// As the command line has it.
struct FeelOptions {
  std::string scene;
  std::vector<std::string> devices{"simulated"};
  std::optional<double> seconds;
  double rate = 1000.0;
  bool realtime = false;
  std::optional<double> reengage;  ///< LoopParams::reengage; none: the program's own.
  bool watch = false;
  bool passive = false;
  double refill = 0.0;
  std::string site;               ///< As siteFrom has it; empty: none.
  std::vector<std::string> with;  ///< Machines of other sites.
  std::string site_keys;          ///< SiteParams::keys
  bool own_scene = false;         ///< Sites neither edit it nor hear of edits.
  bool window = false;
  std::optional<double> speed;  ///< Of recorded hands, 1: as they were; none: as fast as it goes.
  std::string still;            ///< A picture by the window's program.
  std::string igtl;             ///< Where 3D Slicer is listened for; empty: nowhere.
  double igtl_rate = kIgtlRate;
  std::string record;
  std::string trace;
  std::string summary;
  std::string picture;
  bool verbose = false;
  bool json = false;
};

/// Every tick as it comes: counted on the spot, handed to the thread that writes if it is asked
/// for.
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
  /// On the thread that writes.
  template <class Take>
  void drain(const Take& take) {
    if (!ring_) return;
    while (const Row* row = ring_->peek()) {
      take(row->tick, std::span(row->loads).first(felt.carriers().size()));
      ring_->pop();
    }
  }
  /// Rows for which there was no room.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }

  /// Told before the scene of the next ticks is published; `dials`: of its modes.
  void expect(const Scene& scene, const std::vector<LiveDial>& dials) {
    felt.expect(scene);
    if (live != nullptr) live->expect(scene, dials);
  }

  Felt felt;
  LiveWriter* live = nullptr;    ///< Of a window.
  Recorder* recorder = nullptr;  ///< Null: nothing is recorded.

 private:
  struct Row {
    Row(const Telemetry& t, std::span<const double> l) noexcept : tick(t) {
      std::copy(l.begin(), l.end(), loads.begin());
    }
    Telemetry tick;
    Loads loads;  ///< As many as there are carriers.
  };
  static constexpr std::size_t kRows = 32768;  // 3 s at 10 kHz
  // Never grows: try_emplace takes no memory.
  std::optional<moodycamel::ReaderWriterQueue<Row>> ring_;
  std::int64_t lost_ = 0;
};

/// One hand: where it is, what it has felt, and where that is written.
struct Hand {
  Log log;  // first: its ring has cache lines of its own
  std::unique_ptr<Device> device;
  std::unique_ptr<Recorder> recorder;
  bool told_unwritten = false;
  Trace trace;
  Picture* picture = nullptr;  ///< The first one's.
  OrderedJson granted;

  Hand(std::unique_ptr<Device> d, const Scene& scene, const FeelOptions& options,
       const std::string& trace_place, Picture* drawn)
      : log(scene, options.rate, !trace_place.empty() || drawn != nullptr),
        device(std::move(d)),
        trace(trace_place, log.felt.carriers()),
        picture(drawn) {}
  /// Says once why nothing is recorded any more.
  void tellUnwritten(const std::string& name) {
    if (!recorder || told_unwritten) return;
    const std::string why = recorder->trouble();
    if (why.empty()) return;
    told_unwritten = true;
    complain(name + ": --record: " + why + ": the hand feels on, and what was written is whole");
  }
  void drain() {
    log.drain([this](const Telemetry& tick, std::span<const double> loads) {
      trace.add(tick, loads);
      if (picture != nullptr) picture->add(tick);
    });
  }
};
using Hands = std::vector<std::unique_ptr<Hand>>;

/// What of the felt volumes is fetched meanwhile: bricks about hands, frames ahead of play.
class Fetched {
 public:
  /// They are those of this scene from now on.
  void now(const BuiltScene& built) {
    windows_ = built.windows;
    sequences_ = built.sequences;
  }
  /// Complains of what went wrong since the last call.
  void tellTroubles() const;
  /// Adds "bricks" and "sequences", by names of volumes, where there are any.
  void addTo(OrderedJson& summary) const;
  void sayThem() const;
  /// By name.
  [[nodiscard]] const std::map<std::string, std::shared_ptr<const FrameSequence>>& sequences()
      const {
    return sequences_;
  }

 private:
  Windows windows_;
  std::map<std::string, std::shared_ptr<const FrameSequence>> sequences_;
};

/// The first hand in one scene with hands elsewhere.
class WithSites {
 public:
  /// None where the options name no site. `from`: the scene. Throws Error.
  WithSites(const FeelOptions& options, const DeviceInfo& device, const ToFeel& from);
  /// For the first hand's loop; null: it is alone.
  [[nodiscard]] HandLinks* links() noexcept { return links_ ? &*links_ : nullptr; }
  /// Says what has happened since the last call.
  void tellNews();
  /// There are sites that edit the scene.
  [[nodiscard]] bool share() const noexcept { return shares_; }
  /// Makes it theirs.
  void begin(Watcher& watcher, const ToFeel& from) const;
  /// Takes what they say of it.
  void hear(Watcher& watcher);
  /// Tells them what is known of it here, where that is new.
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

/// What a run asks for, once it is known to be good.
struct Run {
  const FeelOptions& options;
  Hands& hands;
  std::shared_ptr<const Scene> scene;
  const SceneSpec& spec;                                   ///< What the scene was built of.
  std::optional<std::filesystem::file_time_type> written;  ///< The scene's file.
  SceneCache& cache;
  const ToFeel& from;      ///< What that is.
  std::int64_t ticks = 0;  ///< At most.
  bool whole_path = false;
  Window* window = nullptr;
  WithSites* sites = nullptr;
  IgtlServer* igtl = nullptr;
  Fetched fetched{};
  PlayParams play{};  ///< Of `scene`.

  /// Before a message about one of several.
  [[nodiscard]] std::string nameOf(std::size_t hand) const {
    return hands.size() == 1 ? "feel" : fmt::format("feel: hand {}", hand + 1);
  }
};

/// As fast as it goes; the same every time.
void runInVirtualTime(const Run& run);
/// Hands that were recorded, each bit of it: all of them ReplayDevices. At `run.options.speed`, and
/// until its window is closed. `scenes`: what their ticks
/// are felt in, by the ids that they were recorded with; where it has none, `run.scene`.
void runAgain(const Run& run, const ScenesById& scenes);
/// With a clock, in a thread each.
void runOnTime(Run& run, Guardian& guardian);

}  // namespace palpate::cli
