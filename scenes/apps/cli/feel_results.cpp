#include "palpate/scenes/apps/cli/feel_results.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/version.h"
#include "palpate/scenes/apps/cli/again.h"
#include "palpate/scenes/apps/cli/feel_options.h"
#include "palpate/scenes/apps/cli/room.h"

namespace palpate::cli {
namespace {

/// Returns the scene that `palpate explain` would now read from the run's scene file; null if that
/// file has no valid scene.
std::shared_ptr<const Scene> sceneOfFile(const Run& run) {
  if (!run.edited) return run.scene;
  try {
    SceneInput now = openSceneInput(run.from.file);
    now.spec.waits = true;
    return buildScene(now.spec, {}, &run.cache).scene;
  } catch (const std::exception&) {
    // The file may be removed, or edited again. Then the report has no command.
    return nullptr;
  }
}

/// `scene` is sceneOfFile().
OrderedJson mostOf(const Run& run, std::size_t h, const Scene* scene) {
  const Most most = run.hands[h]->log.felt.most();
  if (!(most.force > 0.0)) return nullptr;
  const double spring = most.stiffness * (most.proxy - most.probe).norm();
  OrderedJson line;
  OrderedJson explained;
  if (repeats(run, h)) {
    line = explainLine(run, h, most.time);
    explained = spring;
  } else if (scene != nullptr) {
    const Again again = againOf(most, *scene, run.options.rate);
    line = explainLine(run.from.file, again);
    explained = again.spring;
  }
  return {{"force", most.force},
          {"spring", spring},
          {"others", most.wanted - spring},
          {"limiter", most.force - most.wanted},
          {"mode", most.mode},
          {"time", most.time},
          {"probe", toJson(most.probe)},
          {"proxy", toJson(most.proxy)},
          {"explain", line},
          {"explained", explained}};
}

/// Lists the shares of a force, for example "spring 2.1 N, damper and others +0.3 N, limiter -0.4
/// N". Omits shares below 1 mN, except the spring's.
std::string shareWords(const OrderedJson& most) {
  constexpr double kLeast = 1e-3;  // [N]
  std::string text = fmt::format("spring {} N", rounded(most["spring"].get<double>()));
  const auto add = [&](const char* name, double share) {
    if (std::abs(share) >= kLeast) text += fmt::format(", {} {:+.4g} N", name, share);
  };
  add("damper and others", most["others"].get<double>());
  add("limiter", most["limiter"].get<double>());
  return text;
}

/// Returns the text before a `palpate explain` command. If the run cannot be repeated, the command
/// may explain another force, and the text gives this force.
std::string explains(const OrderedJson& most) {
  if (most["explain"].is_null()) return "";
  const auto spring = most["spring"].get<double>();
  const auto explained = most["explained"].get<double>();
  constexpr double kSame = 0.02;
  if (std::abs(explained - spring) <= kSame * spring) return ": to explain it, run:";
  return fmt::format("; a single push there gives {} N: to explain it, run:", rounded(explained));
}

Legible timeWords(const OrderedJson& summary) {
  const auto us = [&](const char* key) {
    return rounded(1e-3 * summary["wake_ns"][key].get<double>());
  };
  const OrderedJson& got = summary["realtime"];
  const auto early = got["early_us"].get<double>();
  return cli::words(
      "clock     {} Hz achieved; {} late ticks; start delay {} us median, {} p99, {} p99.9, {} "
      "worst; {} page faults; {}, {}, {}\n",
      rounded(summary["rate_kept"].is_null() ? 0.0 : summary["rate_kept"].get<double>()),
      summary["late_ticks"].get<std::int64_t>(), us("p50"), us("p99"), us("p99.9"), us("max"),
      got["page_faults"].get<std::int64_t>(),
      got["priority"].get<bool>() ? "real-time priority" : "no real-time priority",
      got["memory_locked"].get<bool>() ? "memory locked" : "memory not locked",
      early > 0.0
          ? sentence("woken " + rounded(early) + " us early, caches warmed before each tick")
          : sentence("woken at each tick"));
}

bool endRecording(const Run& run, std::size_t h) {
  Hand& hand = *run.hands[h];
  if (!hand.recorder) return true;
  hand.recorder->end();
  const std::int64_t lost = hand.recorder->lost();
  if (lost > 0) {
    complain(fmt::format(
        "{}: --record {}: {} ticks were lost, because writing was too slow: use a lower "
        "rate or a faster disk",
        run.nameOf(h), hand.recorder->file().string(), lost));
  }
  hand.tellUnwritten(run.nameOf(h));
  return lost == 0 && hand.recorder->trouble().empty();
}

/// `scene` is sceneOfFile().
OrderedJson summaryOf(const Run& run, std::size_t h, const Scene* scene) {
  const FeelOptions& options = run.options;
  const Hand& hand = *run.hands[h];
  OrderedJson summary;
  summary["version"] = kVersion;
  summary["commit"] = commit();
  summary["scene"] = run.spec.source;
  summary["device"] = deviceName(options.devices[h], hand.device->info());
  summary["clock"] = options.realtime ? "real" : "virtual";
  const OrderedJson counted = hand.log.felt.summary();
  for (const auto& [key, value] : counted.items()) summary[key] = value;
  summary["most"] = mostOf(run, h, scene);
  summary["room"] = roomFor(hand.device->info(), options.rate, run.stiffest);
  if (options.realtime) {
    summary["realtime"] = hand.granted;
  } else {
    // In virtual time, ticks cannot be late.
    for (const char* key : {"rate_kept", "late_ticks", "wake_ns"}) summary[key] = nullptr;
  }
  return summary;
}

/// Prints a hand's report.
void tell(const FeelOptions& options, const Hand& hand, const OrderedJson& summary) {
  say("run       {} s at {} Hz {}, device {}, {} ticks\n{}",
      rounded(summary["seconds"].get<double>()), rounded(options.rate),
      options.realtime ? "in real time" : "in virtual time", summary["device"].get<std::string>(),
      summary["ticks"].get<std::int64_t>(), hand.log.felt.words());
  sayRoom(summary["room"], 10, options.verbose);
  if (options.realtime) say("{}", timeWords(summary));
  const OrderedJson& most = summary["most"];
  if (most.is_null()) return;
  // Felt::add counts the force in a fast move half, so another tick may have a larger force.
  const bool larger = summary["force_max"].get<double>() > most["force"].get<double>();
  say("strongest {} N after {} s{}, mainly from {} ({}){}\n", rounded(most["force"].get<double>()),
      rounded(most["time"].get<double>()), larger ? " (a force in a fast move counts half)" : "",
      most["mode"].get<std::string>(), sentence(shareWords(most)), explains(most));
  const OrderedJson& line = most["explain"];
  if (!line.is_null()) say("{}\n", sentence(line.get<std::string>()));
}

void report(const Run& run, const OrderedJson& search, Outputs& outputs) {
  const FeelOptions& options = run.options;
  std::vector<OrderedJson> felt;
  const std::shared_ptr<const Scene> scene = sceneOfFile(run);
  for (std::size_t h = 0; h < run.hands.size(); ++h) {
    felt.push_back(summaryOf(run, h, scene.get()));
  }
  OrderedJson summary = felt[0];
  if (!search.is_null()) summary["search"] = search;
  if (felt.size() > 1) summary["hands"] = felt;
  run.fetched.addTo(summary);
  run.sites->addTo(summary);
  if (run.igtl != nullptr) summary["igtl"] = run.igtl->summary();
  summary["machine"] = machineJson();
  for (const auto& hand : run.hands) hand->trace.commit();
  if (outputs.summary) {
    outputs.summary->write(dump(summary, 2) + "\n");
    outputs.summary->commit();
  }
  if (options.json) return sayJson(summary);
  if (options.trace == "-" || options.summary == "-") return;
  if (!search.is_null()) {
    say("search    {} probe rays, {} with contact; the hand's path visits {}; {} ms\n",
        search["rays"].get<int>(), search["met"].get<int>(),
        counted(search["visits"].get<int>(), "place", "places"),
        rounded(search["ms"].get<double>()));
  }
  for (std::size_t h = 0; h < run.hands.size(); ++h) {
    tell(options, *run.hands[h], felt[h]);
  }
  run.fetched.sayThem();
  run.sites->sayThem();
}

/// Prints the faults and returns the exit status. `nothing`: true if no hand felt a force. `lost`:
/// true if the window has failed while its mouse led all hands. `kept`: true if all recordings are
/// complete.
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

/// Returns why no hand felt a force, with a remedy.
std::string whyNothing(const Hands& hands) {
  std::string solid;
  bool withheld = false;
  for (const auto& hand : hands) {
    if (solid.empty()) solid = hand->log.felt.inside();
    withheld = withheld || hand->log.felt.withheld();
  }
  if (withheld) {
    return "modes acted, but the arm was not ready: home it, and hold its dead-man switch";
  }
  if (solid.empty()) {
    return "it touched no active mode: run palpate check to see where the volumes are";
  }
  return fmt::format(
      "it was inside the solid of {} when the force began, and a surface holds only a hand that "
      "comes from outside: begin outside",
      Legible(solid).text());
}

}  // namespace

OrderedJson machineJson() {
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

int conclude(const Run& run, const BuiltScene& built, const OrderedJson& search, Outputs& outputs) {
  const Hands& hands = run.hands;
  run.fetched.tellTroubles();
  bool kept = true;
  for (std::size_t h = 0; h < hands.size(); ++h) kept = endRecording(run, h) && kept;
  // From here on, an interrupt ends only the drawing of pictures, after report() has written the
  // results.
  const bool cut_short = interrupted != 0;
  interrupted = 0;
  report(run, search, outputs);
  try {
    if (outputs.picture) {
      outputs.picture->draw(run.edited ? run.edited->spec : run.spec,
                            run.edited ? run.edited->built : built, hands[0]->log.felt);
    }
    if (outputs.still) {
      std::vector<std::string> view;
      if (!run.options.camera.empty()) view = {"--camera", run.options.camera};
      if (!run.options.slice.empty()) view.insert(view.end(), {"--slice", run.options.slice});
      run.window->draw(run.from.file, outputs.still->place(), view);
      outputs.still->commit();
    }
  } catch (const Interrupted&) {
    complain("feel: interrupted: the picture was not drawn");
  }
  const bool nothing = std::none_of(hands.begin(), hands.end(),
                                    [](const auto& hand) { return hand->log.felt.anything(); });
  const bool cut = std::any_of(hands.begin(), hands.end(), [](const auto& hand) {
    return hand->log.felt.fault() != Fault::kNone;
  });
  const bool lost = run.window != nullptr && run.window->lost();
  if (nothing && !lost && !cut) {
    const std::string verb = run.options.window ? "view" : "feel";
    complain(verb + ": the hand felt no force: " + whyNothing(hands));
  }
  if (cut_short || interrupted != 0) return kInterrupted;
  return statusOf(run, nothing, lost, kept);
}

}  // namespace palpate::cli
