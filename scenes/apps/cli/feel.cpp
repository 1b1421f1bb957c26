/// palpate feel: runs a scene under a hand, in virtual time or in real time.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "palpate/devices/arm/guardian.h"
#include "palpate/devices/open_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/cli/again.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/cli/room.h"
#include "palpate/scenes/apps/cli/session.h"
#include "palpate/scenes/apps/cli/watcher.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/finder.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {
namespace {

constexpr double kDefaultSeconds = 10.0;
constexpr double kMostSeconds = 1e6;

bool isPath(const std::string& device) {
  return device.rfind("path:", 0) == 0;
}
bool isReplay(const std::string& device) {
  return device.rfind("replay:", 0) == 0;
}
/// Accepts names with or without a trouble.
bool isSimulated(const std::string& device) {
  return device == "simulated" || device.rfind("simulated:", 0) == 0;
}

DeviceOptions deviceOptions(const FeelOptions& options, const Box& bounds, const HandTarget& target,
                            Window* window, IgtlServer* igtl) {
  DeviceOptions asked;
  asked.rate = options.rate;
  asked.target = target;
  // In front of all volumes, as seen from the window.
  Vec3 start = bounds.centre();
  start.y() = bounds.lower.y() - 0.1 * bounds.size().maxCoeff();
  if (window != nullptr) asked.mouse = window->mouse(start);
  const auto& names = options.devices;
  // Only one hand may come from a client.
  if (igtl != nullptr && std::count(names.begin(), names.end(), "igtl") > 0) {
    asked.client = igtl->hand(start);
  }
  asked.realtime = options.realtime;
  asked.passive = options.passive;
  asked.refill = options.refill;
  asked.say = [](const std::string& words) { complain("feel: " + words); };
  asked.stop = [] { return interrupted != 0; };
  return asked;
}

/// Returns the path of simulated hands and the cost of the search; empty if there are no simulated
/// hands.
HandTarget targetOf(const FeelOptions& options, const BuiltScene& built, OrderedJson& search) {
  const auto& names = options.devices;
  if (std::none_of(names.begin(), names.end(), isSimulated)) return {};
  // With a window or clients the path lasts as long as a run may.
  const bool endless = (options.window && options.still.empty()) || !options.igtl.empty();
  const double seconds = options.seconds.value_or(endless ? kMostSeconds : kDefaultSeconds);
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

/// Returns the moment with the strongest force; null if no force was felt.
OrderedJson mostOf(const Hand& hand, const Scene& scene) {
  const Most most = hand.log.felt.most();
  if (!(most.force > 0.0)) return nullptr;
  const std::optional<Again> again = againOf(most, scene);
  return {{"force", most.force},
          {"mode", most.mode},
          {"time", most.time},
          {"probe", toJson(most.probe)},
          {"proxy", toJson(most.proxy)},
          {"at", again ? toJson(again->at) : OrderedJson()},
          {"push", again ? toJson(again->push) : OrderedJson()}};
}

OrderedJson machine() {
  OrderedJson json;
  std::ifstream cpuinfo("/proc/cpuinfo");
  std::string line;
  std::string model = "unknown";
  while (std::getline(cpuinfo, line)) {
    if (line.rfind("model name", 0) == 0) {
      model = line.substr(std::min(line.size(), line.find(':') + 2));
      break;
    }
  }
  json["processor"] = model;
  json["cores"] = std::thread::hardware_concurrency();
  json["compiler"] = kCompiler;
  json["build"] = kBuildType;
  return json;
}

/// Returns the timing results as text.
Legible timeWords(const OrderedJson& summary) {
  const auto us = [&](const char* key) {
    return rounded(1e-3 * summary["wake_ns"][key].get<double>());
  };
  const OrderedJson& got = summary["realtime"];
  const auto early = got["early_us"].get<double>();
  return cli::words(
      "clock     {} Hz kept; {} late ticks; begun {} us after time (median), {} p99, {} p99.9, {} "
      "worst; {} page faults; {}, {}, {}\n",
      rounded(summary["rate_kept"].is_null() ? 0.0 : summary["rate_kept"].get<double>()),
      summary["late_ticks"].get<std::int64_t>(), us("p50"), us("p99"), us("p99.9"), us("max"),
      got["page_faults"].get<std::int64_t>(),
      got["priority"].get<bool>() ? "real-time priority" : "no real-time priority",
      got["memory_locked"].get<bool>() ? "memory locked" : "memory not locked",
      early > 0.0
          ? sentence("woken " + rounded(early) + " us early, caches warmed before each tick")
          : sentence("asleep until each tick"));
}

/// Returns the file of one hand among several: T.csv, T.2.csv, ...
std::string placeOf(const std::string& asked, std::size_t hand) {
  if (asked.empty() || hand == 0) return asked;
  std::filesystem::path place(asked);
  const std::string end = place.extension().string();
  place.replace_extension();
  return place.string() + "." + std::to_string(hand + 1) + end;
}

/// Rejects two outputs at one place, and an output that is also an input.
void checkOutputs(const FeelOptions& options, const SceneInput& scene) {
  std::vector<std::string> places{options.summary, options.picture, options.still};
  for (std::size_t i = 0; i < options.devices.size(); ++i) {
    places.push_back(placeOf(options.trace, i));
    places.push_back(placeOf(options.record, i));
  }
  if (options.json) places.emplace_back("-");
  std::vector<std::filesystem::path> inputs = inputsOf(options.scene, scene.spec);
  inputs.insert(inputs.end(), scene.files.begin(), scene.files.end());
  for (const std::string& device : options.devices) {
    if (isPath(device)) inputs.emplace_back(device.substr(5));
    if (isReplay(device)) inputs.emplace_back(fileOfReplay(device.substr(7)));
  }
  checkOutputsApart(places, inputs);
}

void checkTimes(const FeelOptions& options) {
  const double slowest = options.realtime ? 500.0 : 10.0;
  const double fastest = options.realtime ? 20000.0 : 100000.0;
  if (!(options.rate >= slowest && options.rate <= fastest)) {
    throw Error("--rate", fmt::format("{} Hz is not {} to {}", options.rate, slowest, fastest),
                "use 1000");
  }
  if (options.seconds && !(*options.seconds > 0.0 && *options.seconds <= kMostSeconds)) {
    throw Error("--seconds",
                fmt::format("{} is not more than 0 and at most 1000000", *options.seconds),
                "use 10");
  }
}

void checkHands(const FeelOptions& options) {
  constexpr std::size_t kMostHands = 4;
  if (options.devices.empty() || options.devices.size() > kMostHands) {
    throw Error("--device", fmt::format("{} hands", options.devices.size()), "give one to four");
  }
  if (options.devices.size() > 1 && options.trace == "-") {
    throw Error("--trace", "the rows of several hands would be mixed", "give a file");
  }
}

/// Rejects an energy tank that has no effect, or a wrong refill.
void checkTank(const FeelOptions& options) {
  const bool paths = std::any_of(options.devices.begin(), options.devices.end(), isPath);
  if (options.passive && paths) {
    throw Error("--passive", "a recorded path is no hand that could be given energy",
                "leave it out");
  }
  constexpr double kMostRefill = 10.0;  // [W]: more than a hand gives
  if (!(options.refill >= 0.0 && options.refill <= kMostRefill)) {
    throw Error("--refill", fmt::format("{} W is not 0 to {}", options.refill, kMostRefill),
                "use 0.1");
  }
  if (options.refill > 0.0 && !options.passive) {
    throw Error("--refill", "nothing is held back that it would let through", "add --passive");
  }
}

/// Rejects options that a recording, or a hand from one, cannot have.
void checkRecordings(const FeelOptions& options) {
  if (options.record == "-") {
    throw Error("--record", "a recording is no text", "give a file");
  }
  const auto replayed = static_cast<std::size_t>(
      std::count_if(options.devices.begin(), options.devices.end(), isReplay));
  if (replayed > 0 && (options.realtime || replayed < options.devices.size())) {
    throw Error("--device", "recorded hands feel in their own time, and nobody beside them",
                options.realtime ? "leave out --realtime" : "give replay:FILE alone");
  }
  if (options.passive && replayed > 0) {
    throw Error("--passive", "a recorded hand has what its tank gave", "leave it out");
  }
  constexpr double kFastest = 1000.0;
  if (options.speed && replayed == 0) {
    throw Error("--speed", "only a recorded hand has a time of its own",
                "give --device replay:FILE, or leave it out");
  }
  if (options.speed && !(*options.speed >= 1.0 / kFastest && *options.speed <= kFastest)) {
    throw Error("--speed", fmt::format("{} is not 0.001 to {}", *options.speed, kFastest),
                "1 is as it was");
  }
}

void checkSite(const FeelOptions& options) {
  if (!options.site.empty()) {
    (void)siteFrom(options.site, options.with);
    if (!options.realtime) {
      throw Error("--site", "hands elsewhere feel on time", "add --realtime");
    }
    if (!options.devices.empty() && options.devices[0] == "igtl") {
      throw Error("--site", "a hand that Slicer leads would lead the arms of other sites",
                  "give another --device first");
    }
  } else if (!options.with.empty()) {
    throw Error("--with", "it says where other sites are, and this is none", "add --site NAME");
  } else if (!options.site_keys.empty()) {
    throw Error("--site-keys", "there are no other sites", "leave it out, or add --site NAME");
  } else if (options.own_scene) {
    throw Error("--own-scene", "there are no other sites", "leave it out, or add --site NAME");
  }
}

void checkIgtl(const FeelOptions& options) {
  if (options.igtl.empty() && options.igtl_rate != kIgtlRate) {
    throw Error("--igtl-rate", "nobody is listened for", "add --igtl 18944");
  }
  if (options.igtl.empty()) return;
  if (!options.realtime) {
    throw Error("--igtl", "virtual time is over before anybody connects",
                options.window ? "leave it out" : "add --realtime");
  }
  if (!(options.igtl_rate >= 1.0 && options.igtl_rate <= kIgtlMostRate)) {
    throw Error("--igtl-rate",
                fmt::format("{} Hz is not 1 to {}", options.igtl_rate, kIgtlMostRate), "use 30");
  }
}

/// Throws Error for the first option that is wrong.
void checkOptions(const FeelOptions& options) {
  if (!options.picture.empty()) static_cast<void>(formatOf(options.picture));
  if (!options.still.empty()) static_cast<void>(pngName(options.still));
  checkTimes(options);
  checkHands(options);
  checkTank(options);
  checkRecordings(options);
  checkSite(options);
  if (options.watch && !options.realtime) {
    throw Error("--watch", "virtual time is over before a file changes", "add --realtime");
  }
  if (options.reengage && !options.realtime) {
    throw Error("--reengage", "in virtual time no tick is late",
                options.window ? "leave it out" : "add --realtime");
  }
  checkIgtl(options);
}

/// Returns the rate of recorded hands; throws Error if rates differ, or if another rate is
/// requested.
double rateOfReplays(const std::vector<std::unique_ptr<Device>>& devices,
                     const FeelOptions& options) {
  const auto rate_of = [](const std::unique_ptr<Device>& device) {
    return dynamic_cast<const ReplayDevice&>(*device).recording().setting().rate;
  };
  const double rate = rate_of(devices[0]);
  const auto other = [&](const auto& device) { return rate_of(device) != rate; };
  if (std::any_of(devices.begin(), devices.end(), other)) {
    throw Error("--device", "the recordings are of several rates", "replay them one by one");
  }
  if (options.rate != FeelOptions{}.rate && options.rate != rate) {
    throw Error("--rate", fmt::format("the hand was recorded at {} Hz", rate), "leave it out");
  }
  return rate;
}

/// Prepares the recording of a hand, beginning with this scene.
void record(Hand& hand, const std::string& place, double rate, RecordedScene first) {
  checkReplaceable(place);
  RecordedSetting setting{hand.device->info(), rate, {}};
  // A replayed hand keeps the limits of its original loop.
  const bool again = dynamic_cast<const ReplayDevice*>(hand.device.get()) != nullptr;
  if (!again) setting.device.limits = limitsInLoop(hand.device->info(), rate);
  setting.about = dump({{"version", kVersion}, {"commit", commit()}, {"machine", machine()}});
  hand.recorder = std::make_unique<Recorder>(place, setting);
  hand.log.recorder = hand.recorder.get();
  hand.recorder->expect(std::move(first));
}

/// Ends the recording and reports missing data; returns false if data are missing.
bool endRecording(const Run& run, std::size_t h) {
  Hand& hand = *run.hands[h];
  if (!hand.recorder) return true;
  hand.recorder->end();
  const std::int64_t lost = hand.recorder->lost();
  if (lost > 0) {
    complain(
        fmt::format("{}: --record: {} ticks came too fast to be written: use a lower rate or a "
                    "faster place",
                    run.nameOf(h), lost));
  }
  hand.tellUnwritten(run.nameOf(h));
  return lost == 0 && hand.recorder->trouble().empty();
}

OrderedJson summaryOf(const FeelOptions& options, const Hand& hand, const SceneSpec& spec,
                      const Scene& scene) {
  OrderedJson summary;
  summary["version"] = kVersion;
  summary["commit"] = commit();
  summary["scene"] = spec.source;
  summary["device"] = hand.device->info().name;
  summary["clock"] = options.realtime ? "real" : "virtual";
  const OrderedJson counted = hand.log.felt.summary();
  for (const auto& [key, value] : counted.items()) summary[key] = value;
  summary["most"] = mostOf(hand, scene);
  summary["room"] = roomFor(hand.device->info(), options.rate, stiffestCoupling(spec));
  if (options.realtime) {
    summary["realtime"] = hand.granted;
  } else {
    // In virtual time no tick is late, and the rate is exact by definition: there is no clock.
    for (const char* key : {"rate_kept", "late_ticks", "wake_ns"}) summary[key] = nullptr;
  }
  return summary;
}

/// `scene`: the scene's file, for explain.
void tell(const FeelOptions& options, const Hand& hand, const OrderedJson& summary,
          const std::string& scene) {
  say("run       {} s at {} Hz {}, device {}, {} ticks\n{}",
      rounded(summary["seconds"].get<double>()), rounded(options.rate),
      options.realtime ? "on time" : "in virtual time", hand.device->info().name,
      summary["ticks"].get<std::int64_t>(), hand.log.felt.words());
  sayRoom(summary["room"], 10, options.verbose);
  if (options.realtime) say("{}", timeWords(summary));
  const OrderedJson& most = summary["most"];
  if (most.is_null()) return;
  const auto place = [&](const char* key) {
    return Vec3(most[key][0].get<double>(), most[key][1].get<double>(), most[key][2].get<double>());
  };
  const bool again = !most["at"].is_null();
  say("most      {} N after {} s, most of it by {}{}\n", rounded(most["force"].get<double>()),
      rounded(most["time"].get<double>()), most["mode"].get<std::string>(), again ? ": why:" : "");
  if (again) say("{}\n", sentence(explainLine(scene, {place("at"), place("push")})));
}

/// The files of a run. They are opened before it, so that a bad path ends it at once; a file is
/// whole or absent.
struct Outputs {
  explicit Outputs(const FeelOptions& options) {
    if (!options.picture.empty()) picture.emplace(options.picture);
    if (!options.still.empty()) still.emplace(pngName(options.still));
    if (!options.summary.empty()) summary.emplace(options.summary);
  }
  std::optional<Picture> picture;
  std::optional<WholeFile> still;
  std::optional<WholeFile> summary;
};

std::vector<std::unique_ptr<Device>> openDevices(const FeelOptions& options, const Box& bounds,
                                                 const HandTarget& target, Window* window,
                                                 IgtlServer* igtl) {
  std::vector<std::unique_ptr<Device>> devices;
  for (const std::string& name : options.devices) {
    devices.push_back(openDevice(name, deviceOptions(options, bounds, target, window, igtl)));
  }
  return devices;
}

/// Opens the window, if no still is drawn instead, and connects the first hand to it.
void showIn(Window& window, Hands& hands, const Scene& scene, const FeelOptions& options,
            const std::string& file) {
  hands[0]->log.live = &window.writer();
  window.writer().expect(scene);
  if (!options.still.empty()) return;
  const bool only = std::all_of(options.devices.begin(), options.devices.end(),
                                [](const std::string& device) { return device == "mouse"; });
  window.open(file, options.watch, only, options.reengage.value_or(kReengage));
}

/// Prepares the recordings of all hands.
void prepareRecordings(Hands& hands, const FeelOptions& options, const SceneInput& from,
                       const BuiltScene& built) {
  if (options.record.empty()) return;
  const std::string scene = recordedScene(from.file, from.text, from.spec, {}, built.windows);
  for (std::size_t h = 0; h < hands.size(); ++h) {
    record(*hands[h], placeOf(options.record, h), options.rate, {built.scene->id, scene});
  }
}

/// Returns the scenes of a recording if SCENE is that recording; its ticks use its own scenes.
ScenesById scenesOfReplay(const Hands& hands, const FeelOptions& options, const BuiltScene& built,
                          SceneCache& cache) {
  if (!isReplay(options.devices[0]) || !isRecording(options.scene)) return {};
  if (!isSamePlace(options.scene, fileOfReplay(options.devices[0].substr(7)))) return {};
  const auto& device = dynamic_cast<const ReplayDevice&>(*hands[0]->device);
  return scenesOf(device.recording(), built.scene, cache);
}

/// Sets how long a run lasts. With a window it ends when the window is closed, with a server on an
/// interrupt.
void limitTicks(Run& run) {
  const FeelOptions& options = run.options;
  run.whole_path = !options.seconds &&
                   std::all_of(options.devices.begin(), options.devices.end(),
                               [](const std::string& d) { return isPath(d) || isReplay(d); });
  const bool watched = run.window != nullptr || run.igtl != nullptr;
  const bool endless = run.whole_path || (options.realtime && watched && !options.seconds);
  run.ticks = endless ? std::numeric_limits<std::int64_t>::max()
                      : static_cast<std::int64_t>(
                            std::llround(options.seconds.value_or(kDefaultSeconds) * options.rate));
}

/// Writes traces and the summary, and prints the results. `search`: cost of the simulated hand's
/// search; null if there was none.
void report(const Run& run, const OrderedJson& search, Outputs& outputs) {
  const FeelOptions& options = run.options;
  std::vector<OrderedJson> felt;
  for (const auto& hand : run.hands) {
    felt.push_back(summaryOf(options, *hand, run.spec, *run.scene));
  }
  OrderedJson summary = felt[0];
  if (!search.is_null()) summary["search"] = search;
  if (felt.size() > 1) summary["hands"] = felt;
  run.fetched.addTo(summary);
  run.sites->addTo(summary);
  if (run.igtl != nullptr) summary["igtl"] = run.igtl->summary();
  summary["machine"] = machine();
  for (const auto& hand : run.hands) hand->trace.commit();
  if (outputs.summary) {
    outputs.summary->write(dump(summary, 2) + "\n");
    outputs.summary->commit();
  }
  if (options.json) return sayJson(summary);
  if (options.trace == "-" || options.summary == "-") return;
  if (!search.is_null()) {
    say("search    {} rays, of which {} met something, and a path past {} places: {} ms\n",
        search["rays"].get<int>(), search["met"].get<int>(), search["visits"].get<int>(),
        rounded(search["ms"].get<double>()));
  }
  for (std::size_t h = 0; h < run.hands.size(); ++h) {
    tell(options, *run.hands[h], felt[h], run.from.file);
  }
  run.fetched.sayThem();
  run.sites->sayThem();
}

/// Returns the exit status of a run that was not interrupted, and reports its faults. `kept`: the
/// recordings are complete.
int statusOf(const Run& run, bool nothing, bool lost, bool kept) {
  int status = nothing && !run.options.window ? kNothingFelt : kDone;
  if (lost || !kept) status = kEndedEarly;
  for (std::size_t h = 0; h < run.hands.size(); ++h) {
    const Fault fault = run.hands[h]->log.felt.fault();
    if (fault == Fault::kNone) continue;
    complain(fmt::format("{}: the force was cut: {}: {}", run.nameOf(h), wordsFor(fault),
                         remedyFor(fault)));
    status = kEndedEarly;
  }
  return status;
}

/// Ends a run: recordings, results, pictures, status. `run.scene` and `built` are as at its end.
int conclude(const Run& run, const BuiltScene& built, const OrderedJson& search, Outputs& outputs) {
  const Hands& hands = run.hands;
  run.fetched.tellTroubles();
  bool kept = true;
  for (std::size_t h = 0; h < hands.size(); ++h) kept = endRecording(run, h) && kept;
  // Results are written now; another interrupt ends the drawing.
  const bool cut_short = interrupted != 0;
  interrupted = 0;
  report(run, search, outputs);
  try {
    if (outputs.picture) outputs.picture->draw(run.spec, built, hands[0]->log.felt);
    if (outputs.still) {
      run.window->draw(run.from.file, outputs.still->place());
      outputs.still->commit();
    }
  } catch (const Interrupted&) {
    complain("feel: interrupted: the picture is not drawn");
  }
  const bool nothing = std::none_of(hands.begin(), hands.end(),
                                    [](const auto& hand) { return hand->log.felt.anything(); });
  const bool cut = std::any_of(hands.begin(), hands.end(), [](const auto& hand) {
    return hand->log.felt.fault() != Fault::kNone;
  });
  const bool lost = run.window != nullptr && run.window->lost();
  if (nothing && !lost && !cut) {
    complain(
        "feel: nothing was felt: the hand met no mode that acts: palpate check shows where the "
        "volumes are");
  }
  if (cut_short || interrupted != 0) return kInterrupted;
  return statusOf(run, nothing, lost, kept);
}

int feel(FeelOptions options) {
  checkOptions(options);
  // Fork early, while there is little memory and only one thread.
  std::optional<Guardian> guardian;
  if (options.realtime) guardian.emplace();
  std::optional<Window> window;
  // A still shows the last tick, whichever that is: every tick is kept.
  constexpr double kEveryTick = 1.0;
  if (options.window) window.emplace(options.still.empty() ? options.rate : kEveryTick);

  // Check all input before anything runs.
  const auto written = writtenAt(options.scene);
  SceneInput input = openSceneInput(options.scene);
  SceneSpec& spec = input.spec;
  checkOutputs(options, input);
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
  // On an interrupt, arms are put down and results are written before the program ends.
  noteInterrupts();
  std::vector<std::unique_ptr<Device>> devices = openDevices(
      options, built.bounds, target, window ? &*window : nullptr, igtl ? &*igtl : nullptr);
  std::vector<const Device*> rendered;
  rendered.reserve(devices.size());
  for (const auto& device : devices) rendered.push_back(device.get());
  const bool replayed = isReplay(options.devices[0]);
  if (replayed && plays) {
    complain(
        "feel: sequences and volumes in bricks are felt as they are now: what was not there in "
        "time when it was recorded is not told apart");
  }
  if (replayed) options.rate = rateOfReplays(devices, options);
  if (fitToAll(spec, rendered)) built = buildScene(spec, {}, &cache);

  Outputs outputs(options);
  Hands hands;
  for (std::size_t h = 0; h < devices.size(); ++h) {
    hands.push_back(std::make_unique<Hand>(
        std::move(devices[h]), *built.scene, options, placeOf(options.trace, h),
        outputs.picture && h == 0 ? &*outputs.picture : nullptr));
  }
  if (window) showIn(*window, hands, *built.scene, options, input.file);
  prepareRecordings(hands, options, input, built);
  const ScenesById scenes = scenesOfReplay(hands, options, built, cache);
  for (const auto& hand : hands) {
    if (hand->recorder) hand->recorder->begin();
  }
  WithSites sites(options, hands[0]->device->info(), input);
  Run run{options, hands, built.scene, spec, written, cache, input};
  run.sites = &sites;
  run.fetched.now(built);
  run.play = built.play;
  if (window) run.window = &*window;
  if (igtl) {
    run.igtl = &*igtl;
    igtl->expect(built);
    igtl->begin();
    sayAside("feel: 3D Slicer is listened for at {}\n", igtl->place());
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
  return conclude(run, built, search, outputs);
}

void addSite(CLI::App& verb, FeelOptions& options) {
  verb.add_option(
      "--site", options.site,
      "NAME[@DOMAIN]: feel the hands of other sites, be felt by them, and share edits of "
      "the scene; with other machines by --with, and edits by --site-keys as well "
      "(docs/cluster.md)");
  verb.add_option("--with", options.with,
                  "With --site: the address of another machine with sites; again for more");
  verb.add_option("--site-keys", options.site_keys,
                  "With --site: a folder of keys that site_keys.sh made: meet who has such keys, "
                  "and nobody else, encrypted");
  verb.add_flag("--own-scene", options.own_scene,
                "With --site: take no edits of the scene from others, and tell them of none");
}

void addReengage(CLI::App& verb, FeelOptions& options) {
  verb.add_option("--reengage", options.reengage,
                  "After a cut because ticks came late: the force returns after so many seconds "
                  "without a late one, at most three times a minute; 0: never (default 2)")
      ->check(CLI::Range(0.0, 60.0));
}

void addIgtl(CLI::App& verb, FeelOptions& options) {
  verb.add_option("--igtl", options.igtl,
                  "[ADDRESS:]PORT: show the hand to 3D Slicer by OpenIGTLink (usually 18944), and "
                  "take from it cuts, images and where --device igtl goes (docs/cluster.md)");
  verb.add_option("--igtl-rate", options.igtl_rate,
                  "How often it is shown, 1 to 100 a second (default 30)");
}

}  // namespace

void addFeel(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand("feel", "Feels a scene and says what was felt, and how well");
  auto options = std::make_shared<FeelOptions>();
  verb->add_option("SCENE", options->scene,
                   "A scene file, a .vdb, a folder of .vdb or bricks, or a recording")
      ->required();
  verb->add_option("--device", options->devices,
                   "simulated[:TROUBLE[@SECONDS]] (arm and hand with dynamics), path:FILE.csv "
                   "(header t,x,y,z), "
                   "replay:FILE[@SECONDS] (of --record), hid[:PROFILE[@SERIAL]], "
                   "plugin:NAME[@SERIAL] (palpate devices) or igtl (led by 3D Slicer); again for "
                   "another hand")
      ->take_all()
      ->type_name("D");
  verb->add_option("--seconds", options->seconds,
                   "How long (default: 10, or to the end of the path)");
  verb->add_option("--rate", options->rate, "Ticks a second (default 1000)");
  verb->add_option("--speed", options->speed,
                   "Of recorded hands: so many times as fast as they were (default: as fast as it "
                   "goes)");
  verb->add_flag("--realtime", options->realtime,
                 "On time, in a thread of its own with real-time priority (rate 500 to 20000)");
  addReengage(*verb, *options);
  addSite(*verb, *options);
  verb->add_flag("--passive", options->passive,
                 "Let no energy out that the hand has not put in (docs/passivity.md)");
  verb->add_option("--refill", options->refill,
                   "But what primitives that do work add (a moving volume pushes), at most [W]; "
                   "with --passive (default 0)");
  verb->add_flag("--watch", options->watch, "Take the scene file anew when it changes");
  verb->add_option("--record", options->record,
                   "All that each tick was given and came to: replay:FILE feels it again");
  verb->add_option("--trace", options->trace, "CSV, one row a tick");
  verb->add_option("--summary", options->summary, "JSON");
  verb->add_option("--picture", options->picture,
                   ".png, .pdf or .svg: path over the slices, force over time");
  addIgtl(*verb, *options);
  verb->add_flag("-v,--verbose", options->verbose, "Say as well how the coupling's room is known");
  verb->add_flag("--json", options->json, "Print the summary as JSON");
  verb->footer(
      "Exit status: 4 where nothing was felt, 1 where the force was cut at its end\n\n"
      "Example:\n  palpate feel head.json --seconds 10 --trace trace.csv --summary "
      "summary.json --picture felt.png");
  verb->callback([=, &body] { body = [=] { return feel(*options); }; });
}

void addView(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "view", "Feels a scene in a window: the mouse is a hand where there is no arm");
  auto options = std::make_shared<FeelOptions>();
  options->devices.clear();
  verb->add_option("SCENE", options->scene,
                   "A scene file, a .vdb, a folder of .vdb or bricks, or a recording")
      ->required();
  verb->add_option("--device", options->devices,
                   "mouse (the default; with --picture simulated), or as palpate feel has it; "
                   "again for another hand, of which the first is drawn")
      ->take_all()
      ->type_name("D");
  verb->add_option("--speed", options->speed,
                   "Of a recorded hand: so many times as fast as it was (default 1)");
  verb->add_option("--seconds", options->seconds,
                   "How long (default: until the window is closed; with --picture 10)");
  verb->add_option("--rate", options->rate, "Ticks a second (default 1000)");
  addReengage(*verb, *options);
  addSite(*verb, *options);
  verb->add_flag("--passive", options->passive,
                 "Let no energy out that the hand has not put in (docs/passivity.md)");
  verb->add_flag("--watch", options->watch,
                 "Take the scene file anew when it changes, and draw it anew");
  verb->add_option("--trace", options->trace, "CSV, one row a tick");
  verb->add_option("--summary", options->summary, "JSON");
  addIgtl(*verb, *options);
  verb->add_option("--picture", options->still,
                   "No window: feel in virtual time, and draw its last tick: PNG, 1920 x 1280");
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
