#include "palpate/scenes/apps/cli/feel.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/open_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/cli/explain.h"
#include "palpate/scenes/apps/cli/feel_options.h"
#include "palpate/scenes/apps/cli/feel_results.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/cli/session.h"
#include "palpate/scenes/apps/cli/watcher.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/finder.h"
#include "palpate/scenes/apps/common/front.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {
namespace {

DeviceOptions deviceOptions(const FeelOptions& options, const BuiltScene& built,
                            const HandTarget& target, Window* window, IgtlServer* igtl) {
  DeviceOptions asked;
  asked.rate = options.rate;
  asked.target = target;
  // The hand starts in front of all volumes, as seen from the camera of the window.
  const Box& bounds = built.bounds;
  const Vec3 front = frontOf(built);
  const double half = 0.5 * front.cwiseAbs().dot(bounds.size());
  const Vec3 start = bounds.centre() + (half + 0.1 * bounds.size().maxCoeff()) * front;
  if (window != nullptr) asked.mouse = window->mouse(start);
  const auto& names = options.devices;
  // A hand of the device igtl follows the client of the OpenIGTLink server.
  if (igtl != nullptr && std::count(names.begin(), names.end(), "igtl") > 0) {
    asked.client = igtl->hand(start);
  }
  asked.realtime = options.realtime;
  asked.passive = options.passive;
  asked.refill = options.refill;
  asked.say = [](const std::string& words) { complain("feel: " + words); };
  asked.stop = [] { return interrupted != 0; };
  asked.stuck = [] { endWithoutFiles(kEndedEarly); };
  return asked;
}

/// Returns the path of the simulated hands, and writes the cost of finding it to `search`.
HandTarget targetOf(const FeelOptions& options, const BuiltScene& built, OrderedJson& search) {
  const auto& names = options.devices;
  if (std::none_of(names.begin(), names.end(), isSimulated)) return {};
  // With a window or clients the run has no fixed end, so the path covers the longest run.
  const bool endless = (options.window && options.still.empty()) || !options.igtl.empty();
  const double seconds = options.seconds.value_or(endless ? kMostFeelSeconds : kFeelSeconds);
  Search did;
  HandTarget target =
      findingHand(*built.scene, built.bounds, DeviceInfo{}.workspace_radius, seconds, &did);
  search = {{"rays", did.rays},
            {"met", did.met},
            {"reads", did.reads},
            {"visits", did.visits},
            {"ms", did.ms}};
  return target;
}

ForceLimits limitsOf(const Device& device, double rate) {
  // A replayed hand keeps the force limits of the recorded run.
  const bool again = dynamic_cast<const ReplayDevice*>(&device) != nullptr;
  return again ? device.info().limits : limitsInLoop(device.info(), rate);
}

void record(Hand& hand, const FeelOptions& options, std::size_t h, RecordedScene first) {
  const std::string place = placeOf(options.record, h);
  checkReplaceable(place);
  RecordedSetting setting{hand.device->info(), options.rate, {}};
  setting.device.name = deviceName(options.devices[h], hand.device->info());
  setting.device.limits = limitsOf(*hand.device, options.rate);
  setting.about = dump({{"version", kVersion}, {"commit", commit()}, {"machine", machineJson()}});
  hand.recorder = std::make_unique<Recorder>(place, setting);
  hand.log.recorder = hand.recorder.get();
  hand.recorder->expect(std::move(first));
}

std::vector<std::unique_ptr<Device>> openDevices(const FeelOptions& options,
                                                 const BuiltScene& built, const HandTarget& target,
                                                 Window* window, IgtlServer* igtl) {
  std::vector<std::unique_ptr<Device>> devices;
  for (const std::string& name : options.devices) {
    devices.push_back(openDevice(name, deviceOptions(options, built, target, window, igtl)));
  }
  return devices;
}

/// Throws Error if the picture is to show slices, but no volume is scalar.
void checkSlice(const FeelOptions& options, const BuiltScene& built) {
  const auto scalar = [](const auto& field) { return field.second.index() == 0; };
  if (options.slice.empty() || std::any_of(built.fields.begin(), built.fields.end(), scalar))
    return;
  throw Error("--slice", "the scene has no scalar volume", "leave out --slice");
}

/// Connects the first hand to the window. Opens the window, except for a still picture.
void showIn(Window& window, Hands& hands, const BuiltScene& built, const FeelOptions& options,
            const std::string& file) {
  checkSlice(options, built);
  hands[0]->log.live = &window.writer();
  window.writer().expect(*built.scene);
  if (!options.still.empty()) return;
  const bool only = std::all_of(options.devices.begin(), options.devices.end(),
                                [](const std::string& device) { return device == "mouse"; });
  window.open(file, options.watch, only, options.reengage.value_or(kReengage));
}

void prepareRecordings(Hands& hands, const FeelOptions& options, const SceneInput& from,
                       const BuiltScene& built) {
  if (options.record.empty()) return;
  const std::string scene = recordedScene(from.file, from.text, from.spec, {}, built.windows);
  for (std::size_t h = 0; h < hands.size(); ++h) {
    record(*hands[h], options, h, {built.scene->id, scene});
  }
}

/// Returns the scenes of the replayed recording if SCENE is that recording; otherwise an empty map.
ScenesById scenesOfReplay(const Hands& hands, const FeelOptions& options, const BuiltScene& built,
                          SceneCache& cache) {
  if (!isReplay(options.devices[0]) || !isRecording(options.scene)) return {};
  if (!isSamePlace(options.scene, fileOfReplay(options.devices[0].substr(7)))) return {};
  const auto& device = dynamic_cast<const ReplayDevice&>(*hands[0]->device);
  return scenesOf(device.recording(), built.scene, cache);
}

/// Returns the number of ticks of a run that ends at `until` [s].
std::int64_t ticksUntil(const Device& device, double until, double rate) {
  const auto* const again = dynamic_cast<const ReplayDevice*>(&device);
  if (again == nullptr) {
    return 1 + std::max<std::int64_t>(0, std::llround(std::ceil((until - kTimeGrid) * rate)));
  }
  const Recording& recording = again->recording();
  std::int64_t i = again->begin();
  while (i < recording.size() && recording.tick(i).time < until - kTimeGrid) ++i;
  return 1 + i - again->begin();
}

/// Sets the largest number of ticks of the run. Without --seconds there is no limit if all hands
/// follow paths or recordings, or if a real-time run has a window or a server.
void limitTicks(Run& run) {
  const FeelOptions& options = run.options;
  run.whole_path = !options.seconds &&
                   std::all_of(options.devices.begin(), options.devices.end(),
                               [](const std::string& d) { return isPath(d) || isReplay(d); });
  const bool watched = run.window != nullptr || run.igtl != nullptr;
  const bool endless = run.whole_path || (options.realtime && watched && !options.seconds);
  run.ticks = endless ? std::numeric_limits<std::int64_t>::max()
                      : static_cast<std::int64_t>(
                            std::llround(options.seconds.value_or(kFeelSeconds) * options.rate));
  if (!options.until) return;
  run.ticks = std::min(run.ticks, ticksUntil(*run.hands[0]->device, *options.until, options.rate));
  // The explanation keeps all ticks in memory.
  constexpr std::int64_t kMostTicks = 2'000'000;
  if (run.ticks > kMostTicks) {
    throw Error("--until", fmt::format("{} ticks are more than {}", run.ticks, kMostTicks),
                "give an earlier time, or a replay that begins later (replay:FILE@SECONDS)");
  }
  run.hands[0]->log.kept.emplace();
}

/// Explains the last tick of the first hand.
int explainLast(const Run& run, const BuiltScene& built) {
  if (interrupted != 0) return kInterrupted;
  const Hand& hand = *run.hands[0];
  const RunSoFar& kept = *hand.log.kept;
  if (!(kept.time >= *run.options.until - kTimeGrid)) {
    throw Error("--until", fmt::format("the run ends after {} s", rounded(kept.time)),
                "give at most this time, or a larger --seconds");
  }
  if (kept.time > *run.options.until + 1.0 / run.options.rate + kTimeGrid) {
    throw Error("--until",
                fmt::format("no tick is at this time; the next is at {} s", rounded(kept.time)),
                "give this time");
  }
  const auto* const again = dynamic_cast<const ReplayDevice*>(hand.device.get());
  const bool another = again != nullptr && isRecording(run.options.scene) && kept.scene != 0 &&
                       kept.scene != firstScene(again->recording());
  const bool edited = kept.edited || another;
  if (kept.scene == 0 || edited) {
    throw Error(
        "--until",
        edited ? "the scene was edited before this time" : "no scene had arrived by this time",
        edited ? "give an earlier time" : "give a later time");
  }
  Opened opened{run.spec, run.spec, built};
  if (!built.scene->parts.empty()) narrow(opened, kept.near, run.cache, complainOf);
  const ForceLimits limits = limitsOf(*hand.device, run.options.rate);
  return sayExplained(explainRun(opened, kept.ticks, limits, kept.time), run.options.json);
}

void beginRecordings(const Hands& hands) {
  for (const auto& hand : hands) {
    if (hand->recorder) hand->recorder->begin();
  }
}

/// Closes the arms at the end of a scope. Arms of plug-ins in this process are last, because the
/// program ends if such a plug-in does not return.
class ClosesArms {
 public:
  ClosesArms(Hands& hands, const std::vector<std::string>& names) : hands_(hands), names_(names) {}
  ClosesArms(const ClosesArms&) = delete;
  ClosesArms& operator=(const ClosesArms&) = delete;
  ~ClosesArms() {
    for (std::size_t h = 0; h < std::min(hands_.size(), names_.size()); ++h) {
      if (!names_[h].starts_with("plugin-inside:")) hands_[h].reset();
    }
  }

 private:
  Hands& hands_;
  const std::vector<std::string>& names_;
};

}  // namespace

int feel(FeelOptions options) {
  checkFeelOptions(options);
  // Forks the guardian early, while the process has little memory and only one thread.
  std::optional<Guardian> guardian;
  if (options.realtime) guardian.emplace();
  std::optional<Window> window;
  // A still picture shows the last tick, so the window must receive every tick.
  constexpr double kEveryTick = 1.0;
  if (options.window) window.emplace(options.still.empty() ? options.rate : kEveryTick);

  const auto written = writtenAt(options.scene);
  SceneInput input = openSceneInput(options.scene);
  SceneSpec& spec = input.spec;
  checkFeelOutputs(options, input);
  for (const std::string& note : spec.notes) complain(note);
  std::optional<IgtlServer> igtl;
  if (!options.igtl.empty()) {
    igtl.emplace(igtlPlace(options.igtl), options.igtl_rate, options.record.empty());
  }
  spec.waits = !options.realtime;
  SceneCache cache;
  BuiltScene built = buildScene(spec, showProgress("loading"), &cache);
  for (const std::string& note : built.notes) complain(note);
  const bool plays = !(built.windows.empty() && built.sequences.empty());
  OrderedJson search;
  const HandTarget target =
      targetOf(options, plays ? buildScene(coarsely(spec, built), {}) : built, search);
  // After this call, an interrupt ends the run early, and the run still writes its results.
  noteInterrupts();
  std::vector<std::unique_ptr<Device>> devices =
      openDevices(options, built, target, window ? &*window : nullptr, igtl ? &*igtl : nullptr);
  std::vector<const Device*> rendered;
  rendered.reserve(devices.size());
  for (const auto& device : devices) rendered.push_back(device.get());
  const bool replayed = isReplay(options.devices[0]);
  if (replayed && plays) {
    complain(
        "feel: the scene has sequences or bricks: the replay also uses data that came too late "
        "during the recording, so its forces may differ");
  }
  if (replayed) options.rate = rateOfReplays(devices, options);
  if (fitToAll(spec, rendered)) built = buildScene(spec, {}, &cache);

  Outputs outputs(options);
  Hands hands;
  const ClosesArms closes(hands, options.devices);
  for (std::size_t h = 0; h < devices.size(); ++h) {
    hands.push_back(std::make_unique<Hand>(
        std::move(devices[h]), *built.scene, options, placeOf(options.trace, h),
        outputs.picture && h == 0 ? &*outputs.picture : nullptr));
  }
  if (window) showIn(*window, hands, built, options, input.file);
  prepareRecordings(hands, options, input, built);
  const ScenesById scenes = scenesOfReplay(hands, options, built, cache);
  beginRecordings(hands);
  WithSites sites(options, hands[0]->device->info(), input);
  Run run{options, hands, built.scene, spec, written, cache, input};
  run.sites = &sites;
  run.fetched.now(built);
  run.play = built.play;
  run.stiffest = stiffestCoupling(spec);
  if (window) run.window = &*window;
  if (igtl) {
    run.igtl = &*igtl;
    igtl->expect(built);
    igtl->begin();
    sayAside("feel: waiting for 3D Slicer at {}\n", igtl->place());
  }
  limitTicks(run);
  if (options.realtime) {
    guardian->catchSignals(&interrupted);
    runOnTime(run, *guardian);
  } else if (replayed) {
    runAgain(run, scenes);
  } else {
    runInVirtualTime(run);
  }
  return options.until ? explainLast(run, built) : conclude(run, built, search, outputs);
}

void addRate(CLI::App& verb, FeelOptions& options) {
  verb.add_option("--rate", options.rate, "Ticks a second (default 1000)")
      ->each([&options](const std::string& /*rate*/) { options.rate_given = true; });
}

namespace {

void addSite(CLI::App& verb, FeelOptions& options) {
  verb.add_option(
      "--site", options.site,
      "NAME[@DOMAIN]: link this hand with hands at other sites, and share edits of the scene; "
      "other machines need --with, and shared edits also --site-keys (docs/sites.md)");
  verb.add_option("--with", options.with,
                  "With --site: address of another machine with sites; may be repeated. Sites of "
                  "machines that are not named can connect too: only --site-keys restricts them");
  verb.add_option("--site-keys", options.site_keys,
                  "With --site: folder of keys from site_keys.sh; links only to sites with such "
                  "keys, encrypted");
  verb.add_flag("--own-scene", options.own_scene,
                "With --site: neither receive nor send edits of the scene");
}

void addReengage(CLI::App& verb, FeelOptions& options) {
  verb.add_option("--reengage", options.reengage,
                  "After a cut due to late ticks: the force returns after this many seconds "
                  "without a late tick, at most three times a minute; 0: never (default 2)")
      ->check(CLI::Range(0.0, 60.0));
}

void addIgtl(CLI::App& verb, FeelOptions& options) {
  verb.add_option("--igtl", options.igtl,
                  "[ADDRESS:]PORT: send the hand to 3D Slicer by OpenIGTLink (usually port 18944); "
                  "receive commands to cut the force, images and the position of --device igtl "
                  "(docs/slicer.md)");
  verb.add_option("--igtl-rate", options.igtl_rate,
                  "Messages a second to 3D Slicer, 1 to 100 (default 30)");
}

}  // namespace

void addFeel(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("feel", "Runs a scene under a hand; prints contacts, forces and timing");
  auto options = std::make_shared<FeelOptions>();
  verb->add_option("SCENE", options->scene,
                   "A scene file, a .vdb, a folder of .vdb or bricks, or a recording")
      ->required();
  verb->add_option("--device", options->devices,
                   "simulated[:TROUBLE[@SECONDS]] (arm and hand with dynamics; TROUBLE: "
                   "docs/loop.md), path:FILE.csv (header t,x,y,z), replay:FILE[@SECONDS] (a file "
                   "from --record), hid[:PROFILE[@SERIAL]], plugin:NAME[@SERIAL] (listed by "
                   "`palpate devices`) or "
                   "igtl (moved by 3D Slicer); repeat for several hands")
      ->take_all()
      ->type_name("D");
  verb->add_option("--seconds", options->seconds,
                   "Length of the run [s] (default: 10; with --igtl: until Ctrl-C; with only paths "
                   "or recordings as hands: to the end of each)");
  addRate(*verb, *options);
  verb->add_option(
      "--speed", options->speed,
      "Speed of recorded hands; 1 is the original speed (default: as fast as possible)");
  verb->add_flag("--realtime", options->realtime,
                 "Run in real time, in a thread with real-time priority (rate 500 to 20000)");
  addReengage(*verb, *options);
  addSite(*verb, *options);
  verb->add_flag("--passive", options->passive,
                 "Never give the hand more energy than it has put in (docs/passivity.md)");
  verb->add_option("--refill", options->refill,
                   "With --passive: largest power that active primitives, such as a moving volume, "
                   "may add [W] (default 0)");
  verb->add_flag("--watch", options->watch, "Reload the scene file when it changes");
  verb->add_option("--record", options->record,
                   "Records inputs and outputs of each tick; --device replay:FILE runs them again");
  verb->add_option("--trace", options->trace, "Writes a CSV, one row a tick");
  verb->add_option("--summary", options->summary, "Writes the summary as JSON");
  addPictureOptions(*verb, options->picture,
                    "Draws the path over slices and the force over time: .png, .pdf or .svg");
  addIgtl(*verb, *options);
  verb->add_flag("-v,--verbose", options->verbose,
                 "Also print the numbers behind the stability margin");
  verb->add_flag("--json", options->json, "Print the summary as JSON");
  verb->footer(
      "Exit status: 4 if the hand felt no force, 1 if the force was cut at the end or a recording "
      "is incomplete\n\nExample:\n  "
      "palpate feel head.json --seconds 10 --trace trace.csv --summary summary.json --picture "
      "felt.png");
  verb->callback([=, &body] { body = [=] { return feel(*options); }; });
}

void addView(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "view", "Runs a scene in a window; the mouse is the hand if no arm is given");
  auto options = std::make_shared<FeelOptions>();
  options->devices.clear();
  verb->add_option("SCENE", options->scene,
                   "A scene file, a .vdb, a folder of .vdb or bricks, or a recording")
      ->required();
  verb->add_option("--device", options->devices,
                   "mouse (default; with --picture: simulated), or a device of palpate feel; "
                   "repeat for several hands: the window draws the first")
      ->take_all()
      ->type_name("D");
  verb->add_option(
      "--speed", options->speed,
      "Speed of a recorded hand; 1 is the original speed (default 1; with --picture: as fast as "
      "possible)");
  verb->add_option(
      "--seconds", options->seconds,
      "Length of the run [s] (default: until the window is closed, at most to the end of paths and "
      "recordings; with --picture: 10, or to the end if all hands are paths or recordings)");
  addRate(*verb, *options);
  addReengage(*verb, *options);
  addSite(*verb, *options);
  verb->add_flag("--passive", options->passive,
                 "Never give the hand more energy than it has put in (docs/passivity.md)");
  verb->add_flag("--watch", options->watch, "Reload and redraw the scene file when it changes");
  verb->add_option("--record", options->record,
                   "Records inputs and outputs of each tick; --device replay:FILE runs them again");
  verb->add_option("--trace", options->trace, "Writes a CSV, one row a tick");
  verb->add_option("--summary", options->summary, "Writes the summary as JSON");
  addIgtl(*verb, *options);
  verb->add_option(
      "--picture", options->still,
      "Run in virtual time without a window, and draw the last tick as a PNG (1920 x 1280)");
  verb->add_option("--camera", options->camera,
                   "With --picture: side of the camera: front, back, left, right, top or bottom "
                   "(default: the front, seen from the right and from above); of the patient, if a "
                   "volume has the space of one");
  verb->add_option("--slice", options->slice,
                   "With --picture: draw slices of the first scalar volume through the proxy "
                   "instead of surfaces and clouds, perpendicular to an axis: x, y, z or all");
  verb->footer(
      "Example:\n  palpate view head.json\n  palpate view head.json --seconds 4 --picture "
      "head.png");
  verb->callback([=, &body] {
    body = [=] {
      options->window = true;
      const auto& names = options->devices;
      const bool again = std::any_of(names.begin(), names.end(), isReplay);
      options->realtime = options->still.empty() && !again;
      if (again && options->still.empty() && !options->speed) options->speed = 1.0;
      if (options->devices.empty()) {
        options->devices.emplace_back(options->realtime ? "mouse" : "simulated");
      }
      return feel(*options);
    };
  });
}

}  // namespace palpate::cli
