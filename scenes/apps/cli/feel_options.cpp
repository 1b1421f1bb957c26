#include "palpate/scenes/apps/cli/feel_options.h"

#include <algorithm>
#include <filesystem>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/devices/recording/replay_device.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/slow_rate.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/network/sites/site.h"

namespace palpate::cli {
namespace {

void checkTimes(const FeelOptions& options) {
  const double slowest = options.realtime ? kSlowRate : 10.0;
  const double fastest = options.realtime ? 20000.0 : 100000.0;
  if (!(options.rate >= slowest && options.rate <= fastest)) {
    throw Error("--rate",
                fmt::format("{} Hz is not in {} to {} Hz", options.rate, slowest, fastest),
                "use 1000");
  }
  if (options.seconds && !(*options.seconds > 0.0 && *options.seconds <= kMostFeelSeconds)) {
    throw Error("--seconds",
                fmt::format("{} s is not above 0 and at most 1000000 s", *options.seconds),
                "use 10");
  }
}

void checkHands(const FeelOptions& options) {
  constexpr std::size_t kMostHands = 4;
  if (options.devices.empty() || options.devices.size() > kMostHands) {
    throw Error("--device", fmt::format("{} hands are given", options.devices.size()),
                "give one to four");
  }
  if (options.devices.size() > 1 && options.trace == "-") {
    throw Error("--trace", "the rows of several hands would be mixed on standard output",
                "give a file name");
  }
}

void checkTank(const FeelOptions& options) {
  const bool paths = std::any_of(options.devices.begin(), options.devices.end(), isPath);
  if (options.passive && paths) {
    throw Error("--passive", "a recorded path cannot receive energy", "leave out --passive");
  }
  constexpr double kMostRefill = 10.0;  // [W]: more power than a human hand gives
  if (!(options.refill >= 0.0 && options.refill <= kMostRefill)) {
    throw Error("--refill", fmt::format("{} W is not in 0 to {} W", options.refill, kMostRefill),
                "use 0.1");
  }
  if (options.refill > 0.0 && !options.passive) {
    const bool replays = std::any_of(options.devices.begin(), options.devices.end(), isReplay);
    throw Error("--refill", "it has no effect without --passive",
                paths || replays ? "leave out --refill" : "add --passive, or leave out --refill");
  }
}

void checkRecordings(const FeelOptions& options) {
  if (options.record == "-") {
    throw Error("--record", "a recording is binary and cannot go to standard output",
                "give a file name");
  }
  const auto replayed = static_cast<std::size_t>(
      std::count_if(options.devices.begin(), options.devices.end(), isReplay));
  if (replayed > 0 && (options.realtime || replayed < options.devices.size())) {
    throw Error("--device",
                "recorded hands run in virtual time, and only with other recorded hands",
                !options.realtime                   ? "give only devices replay:FILE"
                : replayed < options.devices.size() ? "leave out --realtime, and give only devices "
                                                      "replay:FILE"
                                                    : "leave out --realtime");
  }
  if (options.passive && replayed > 0) {
    throw Error("--passive", "a replay uses the energy tank of the recorded run",
                "leave out --passive");
  }
  constexpr double kFastest = 1000.0;
  if (options.speed && replayed == 0) {
    throw Error("--speed", "it applies only to recorded hands",
                "give --device replay:FILE, or leave out --speed");
  }
  if (options.speed && !(*options.speed >= 1.0 / kFastest && *options.speed <= kFastest)) {
    throw Error("--speed", fmt::format("{} is not in 0.001 to {}", *options.speed, kFastest),
                "use 1 for the original speed");
  }
}

/// Returns the remedy for an option that needs real time. `palpate view` has no --realtime, but
/// --picture makes its time virtual. Recorded hands cannot run in real time.
std::string remedyWithoutRealtime(const FeelOptions& options, const std::string& option) {
  const bool replayed = std::any_of(options.devices.begin(), options.devices.end(), isReplay);
  if (replayed) return "leave out " + option;
  return options.window ? "leave out --picture or " + option : "add --realtime";
}

void checkSite(const FeelOptions& options) {
  if (!options.site.empty()) {
    (void)siteFrom(options.site, options.with);
    if (!options.realtime) {
      throw Error("--site", "hands at other sites are linked only in real time",
                  remedyWithoutRealtime(options, "--site"));
    }
    if (!options.devices.empty() && options.devices[0] == "igtl") {
      throw Error("--site", "a site shares its first hand, and 3D Slicer must not move that hand",
                  "put another --device before --device igtl");
    }
  } else if (!options.with.empty()) {
    throw Error("--with", "it has no effect without --site",
                "add --site NAME, or leave out --with");
  } else if (!options.site_keys.empty()) {
    throw Error("--site-keys", "it has no effect without --site",
                "add --site NAME, or leave out --site-keys");
  } else if (options.own_scene) {
    throw Error("--own-scene", "it has no effect without --site",
                "add --site NAME, or leave out --own-scene");
  }
}

/// Checks the options of the picture of `palpate view`.
void checkStill(const FeelOptions& options) {
  const auto check = [&options](const char* option, const std::string& value, const char* kind,
                                std::initializer_list<const char*> known, const char* key) {
    if (value.empty()) return;
    if (std::find(known.begin(), known.end(), value) == known.end()) {
      throw Error(option, fmt::format("\"{}\" is not {}", Legible(value).text(), kind),
                  fmt::format("use {}", fmt::join(known, ", ")));
    }
    if (options.still.empty()) {
      throw Error(option, "it applies only to a picture",
                  fmt::format("add --picture FILE.png, or press {} in the window", key));
    }
  };
  check("--camera", options.camera, "a side of the scene",
        {"front", "back", "left", "right", "top", "bottom"}, "v");
  check("--slice", options.slice, "an axis", {"x", "y", "z", "all"}, "s");
}

void checkIgtl(const FeelOptions& options) {
  if (options.igtl.empty() && options.igtl_rate != kIgtlRate) {
    throw Error("--igtl-rate", "it has no effect without --igtl",
                "add --igtl 18944, or leave out --igtl-rate");
  }
  if (options.igtl.empty()) return;
  if (!options.realtime) {
    throw Error("--igtl", "only a run in real time serves OpenIGTLink clients",
                remedyWithoutRealtime(options, "--igtl"));
  }
  if (!(options.igtl_rate >= 1.0 && options.igtl_rate <= kIgtlMostRate)) {
    throw Error("--igtl-rate",
                fmt::format("{} Hz is not in 1 to {} Hz", options.igtl_rate, kIgtlMostRate),
                "use 30");
  }
}

}  // namespace

bool isPath(const std::string& device) {
  return device.rfind("path:", 0) == 0;
}
bool isReplay(const std::string& device) {
  return device.rfind("replay:", 0) == 0;
}
bool isSimulated(const std::string& device) {
  return device == "simulated" || device.rfind("simulated:", 0) == 0;
}

std::string deviceName(const std::string& option, const DeviceInfo& device) {
  return option == "mouse" || option == "igtl" ? option : device.name;
}

std::string placeOf(const std::string& asked, std::size_t hand) {
  if (asked.empty() || hand == 0) return asked;
  std::filesystem::path place(asked);
  const std::string end = place.extension().string();
  place.replace_extension();
  return place.string() + "." + std::to_string(hand + 1) + end;
}

void checkFeelOutputs(const FeelOptions& options, const SceneInput& scene) {
  std::vector<std::string> places{options.summary, options.picture.file, options.still};
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

void checkFeelOptions(const FeelOptions& options) {
  checkPicture(options.picture);
  if (!options.still.empty()) static_cast<void>(pngName(options.still));
  checkTimes(options);
  checkHands(options);
  checkTank(options);
  checkRecordings(options);
  checkSite(options);
  if (options.watch && !options.realtime) {
    throw Error("--watch", "only a run in real time reloads the scene file",
                remedyWithoutRealtime(options, "--watch"));
  }
  if (options.reengage && !options.realtime) {
    throw Error("--reengage", "in virtual time no tick is late",
                remedyWithoutRealtime(options, "--reengage"));
  }
  checkIgtl(options);
  checkStill(options);
  // A replay uses the recorded rate, which the user cannot change.
  const bool replayed = std::any_of(options.devices.begin(), options.devices.end(), isReplay);
  const char* const command = options.until ? "explain" : options.window ? "view" : "feel";
  if (!replayed) noteSlowRate(command, options.rate);
}

double rateOfReplays(const std::vector<std::unique_ptr<Device>>& devices,
                     const FeelOptions& options) {
  const auto rate_of = [](const std::unique_ptr<Device>& device) {
    return dynamic_cast<const ReplayDevice&>(*device).recording().setting().rate;
  };
  const double rate = rate_of(devices[0]);
  for (std::size_t h = 1; h < devices.size(); ++h) {
    if (rate_of(devices[h]) == rate) continue;
    throw Error("--device",
                fmt::format("the recordings have different rates: {} Hz in {}, {} Hz in {}", rate,
                            fileOfReplay(options.devices[0].substr(7)), rate_of(devices[h]),
                            fileOfReplay(options.devices[h].substr(7))),
                "replay them one by one");
  }
  if (options.rate_given && options.rate != rate) {
    throw Error("--rate", fmt::format("the hand was recorded at {} Hz", rate), "leave out --rate");
  }
  return rate;
}

}  // namespace palpate::cli
