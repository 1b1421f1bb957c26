#include "palpate/devices/open_device.h"

#include <fstream>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/plugins/plugin_process.h"
#include "palpate/devices/recording/csv.h"
#include "palpate/devices/recording/replay_device.h"
#include "palpate/devices/simulated/faulty_device.h"
#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/error.h"

namespace palpate {
namespace {

std::unique_ptr<Device> makeSimulated(ArmParams arm, const HandTarget& target,
                                      const DeviceOptions& options) {
  if (options.passive) arm.tank = TankUse::kAct;
  arm.refill = options.refill;
  return std::make_unique<SimulatedDevice>(arm, GripParams{}, target, options.rate);
}

std::unique_ptr<Device> openSimulated(const DeviceOptions& options) {
  // In real time, the loop treats the simulated arm like a real one.
  ArmParams arm;
  arm.hand = options.realtime;
  return makeSimulated(arm, options.target, options);
}

std::unique_ptr<Device> openTroubled(const std::string& words, const DeviceOptions& options) {
  const NameAt of = nameAt(words);
  const std::optional<Trouble> trouble = troubleOf(of.name);
  if (!trouble) {
    std::vector<std::string> all;
    for (std::size_t i = 0; i < kTroubles; ++i) all.emplace_back(wordFor(static_cast<Trouble>(i)));
    throw DeviceError("--device",
                      fmt::format("\"{}\" is not a failure that palpate can simulate", of.name),
                      fmt::format("give one of {}", fmt::join(all, ", ")));
  }
  if (needsClock(*trouble) && !options.realtime) {
    throw DeviceError("--device", fmt::format("\"{}\" needs real time", of.name),
                      options.mouse.at ? "leave out --picture" : "add --realtime");
  }
  ArmParams arm;
  arm.hand = true;
  return std::make_unique<FaultyDevice>(makeSimulated(arm, options.target, options), *trouble,
                                        options.rate, of.seconds.value_or(1.0));
}

/// Opens a simulated hand that follows a mouse or a client.
std::unique_ptr<Device> openLed(const HandTarget& target, const DeviceOptions& options) {
  // This device has no motor, so a late tick cannot hurt a hand.
  ArmParams arm;
  arm.late = 60.0;
  return makeSimulated(arm, target, options);
}

std::unique_ptr<Device> openMouse(const DeviceOptions& options) {
  if (!options.mouse.at) {
    throw DeviceError("--device", "the mouse needs a window, and this command has none",
                      "use palpate view SCENE");
  }
  return openLed(options.mouse, options);
}

std::unique_ptr<Device> openClient(const DeviceOptions& options) {
  if (!options.client.at) {
    throw DeviceError(
        "--device",
        "igtl is a hand that 3D Slicer leads, and this command does not listen for 3D Slicer",
        options.realtime   ? "add --igtl 18944"
        : options.mouse.at ? "leave out --picture, and add --igtl 18944"
                           : "add --realtime --igtl 18944");
  }
  return openLed(options.client, options);
}

std::unique_ptr<Device> openPath(const std::string& file, const DeviceOptions& options) {
  std::ifstream holder;
  std::istream& in = openInput(file, holder);
  return std::make_unique<PathDevice>(readPath(in, file == "-" ? "standard input" : file),
                                      options.rate);
}

std::unique_ptr<Device> openRecorded(const std::string& name, const DeviceOptions& options) {
  auto device = openReplay(name);
  const std::string words = device->recording().incomplete();
  if (options.say && !words.empty()) options.say(fileOfReplay(name) + ": " + words);
  return device;
}

}  // namespace

OpenedArm openAnyArm(const std::string& name, const ArmHost& host) {
  return parsePluginName(name) ? openPluginArm(name, host) : openArm(name, host);
}

namespace {

std::unique_ptr<Device> openRealArm(const std::string& name, const DeviceOptions& options) {
  if (!options.realtime) {
    // Only palpate view has a mouse. It has no --realtime; --picture makes its time virtual.
    throw DeviceError("--device", "a real arm runs only in real time",
                      options.mouse.at ? "leave out --picture" : "add --realtime");
  }
  ArmHost host;
  host.say = options.say;
  host.stop = options.stop;
  host.stuck = options.stuck;
  if (options.passive) host.tank = TankUse::kAct;
  host.refill = options.refill;
  OpenedArm opened = openAnyArm(name, host);
  auto arm = std::move(opened.device);
  if (options.passive && !arm->traits().drives) {
    throw Error("--passive", arm->info().name + " gives no force", "leave out --passive");
  }
  if (options.passive && arm->info().limits.tank.use != TankUse::kAct) {
    if (!isTested(opened.identity)) {
      throw Error("--passive", "the friction of " + arm->info().name + " is not known",
                  opened.identity.own.empty() ? "leave out --passive"
                                              : "run palpate devices --test " + name);
    }
    throw Error("--passive",
                "the friction of " + arm->info().name +
                    " is not known at every joint, or is smaller than the error of its measurement "
                    "or the force steps of its motors",
                "leave out --passive");
  }
  const double most = arm->info().output_rate;
  if (options.say && options.rate > most && most > 0.0) {
    constexpr double kSlowest = 500.0;  // [Hz]: lowest --rate in real time
    std::string remedy = "the arm gets the newest of them";
    if (most >= kSlowest) {
      remedy = fmt::format("use --rate {} to send all of them", most);
    } else if (options.rate > kSlowest) {
      remedy = fmt::format(
          "use --rate {}, the lowest rate: then the arm gets a larger share of them", kSlowest);
    }
    options.say(fmt::format("{} takes {} forces per second, and the loop computes {}: {}",
                            arm->info().name, most, options.rate, remedy));
  }
  return arm;
}

}  // namespace

std::unique_ptr<Device> openDevice(const std::string& name, const DeviceOptions& options) {
  if (name == "simulated") return openSimulated(options);
  if (name.rfind("simulated:", 0) == 0) return openTroubled(name.substr(10), options);
  if (name == "mouse") return openMouse(options);
  if (name == "igtl") return openClient(options);
  if (name.rfind("path:", 0) == 0) return openPath(name.substr(5), options);
  if (name.rfind("replay:", 0) == 0) return openRecorded(name.substr(7), options);
  if (parseArmName(name) || parsePluginName(name)) return openRealArm(name, options);
  throw DeviceError("--device", "\"" + name + "\" is not a device of this version",
                    "use simulated, simulated:TROUBLE, mouse, igtl, path:FILE.csv, replay:FILE, "
                    "hid:PROFILE or plugin:NAME");
}

}  // namespace palpate
