#include "palpate/scenes/apps/cli/again.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "palpate/scenes/apps/cli/feel_options.h"
#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {
namespace {

constexpr double kWordsGrid = 1e-5;   // [m]: resolution of coordinates in text
constexpr double kOptionGrid = 1e-7;  // [m]: resolution in options; 0.05 mN at 500 N/m

Vec3 roundedTo(double grid, const Vec3& p) {
  return (p / grid).array().round().matrix() * grid;
}

std::string listOf(const Vec3& p, int digits) {
  std::string text;
  for (int i = 0; i < 3; ++i) {
    text += fmt::format("{}{:.{}g}", i == 0 ? "" : ",", p[i] == 0.0 ? 0.0 : p[i], digits);
  }
  return text;
}

/// Returns " --rate RATE", or an empty text for the default.
std::string rateOption(double rate) {
  return rate == Again().rate ? "" : " --rate " + number(rate);
}

std::string untilOption(double time) {
  return " --until " + number(std::round(time / kTimeGrid) / std::round(1.0 / kTimeGrid));
}

/// Formats a position for an option, rounded to kOptionGrid.
std::string optionWords(const Vec3& p) {
  return listOf(roundedTo(kOptionGrid, p), 9);
}

}  // namespace

std::string placeWords(const Vec3& p) {
  return listOf(roundedTo(kWordsGrid, p), 5);
}

Again againOf(const Most& most, const Scene& scene, double rate) {
  Vec3 probe = most.probe;
  Vec3 proxy = most.proxy;
  if (most.motion) {
    // Moves hand and proxy with the volume to its pose at time 0, where `palpate explain` begins.
    const Vec3 rest = most.pose.toRest(proxy);
    const Pose first = most.motion->poseOf(rest, 0.0);
    probe = first(most.pose.toRest(probe));
    proxy = first(rest);
  }
  const Vec3 pressed = probe - proxy;
  const Vec3 into = pressed.norm() > 0.0 ? Vec3(pressed.normalized()) : Vec3::Zero();
  const double dt = 1.0 / rate;
  Again best;
  double least = std::numeric_limits<double>::infinity();
  for (const double before : {1e-3, 5e-4, 2e-3, 1e-4, 1e-5, 0.0, 4e-3, 6e-3, 8e-3, 12e-3}) {
    Again again;
    again.at = roundedTo(kOptionGrid, proxy - before * into);
    again.push = roundedTo(kOptionGrid, probe - again.at);
    again.rate = rate;
    Reader reader;
    ProxyState state(pathLimits());
    static_cast<void>(restAt(scene, reader, state, again.at, dt));
    const Vec3 hand = again.at + again.push;
    const StepReport r = hapticStep(scene, reader, {hand}, state, dt);
    // Compares only the spring's forces, because the damper's force depends on the hand's speed.
    again.spring = r.stiffness * (r.proxy - hand).norm();
    const double off = std::abs(again.spring - most.stiffness * pressed.norm());
    if (off >= least) continue;
    least = off;
    best = again;
  }
  return best;
}

std::string explainLine(const std::string& scene, const Again& again) {
  return fmt::format("palpate explain {} --at {} --push {}{}", shellWord(scene),
                     optionWords(again.at), optionWords(again.push), rateOption(again.rate));
}

std::string explainLine(const std::string& scene, const std::string& recording, double time) {
  return fmt::format("palpate explain {} --device {}{}", shellWord(scene),
                     shellWord("replay:" + recording), untilOption(time));
}

bool repeats(const Run& run, std::size_t h) {
  const FeelOptions& options = run.options;
  if (run.hands[h]->log.felt.scenes() > 1) return false;
  if (options.realtime) {
    const auto& recorder = run.hands[h]->recorder;
    return recorder != nullptr && recorder->lost() == 0;
  }
  return std::all_of(options.devices.begin(), options.devices.end(), [](const std::string& d) {
    return isSimulated(d) || isPath(d) || isReplay(d);
  });
}

std::string explainLine(const Run& run, std::size_t h, double time) {
  const FeelOptions& options = run.options;
  std::string line = "palpate explain " + shellWord(options.scene);
  const auto add = [&](const char* option, const std::string& value) {
    line += fmt::format(" {} {}", option, shellWord(value));
  };
  // The explained hand is the first; all hands limit the stiffness of the coupling.
  std::vector<std::string> devices = options.devices;
  for (std::size_t i = 0; i < devices.size() && options.realtime; ++i) {
    devices[i] = "replay:" + placeOf(options.record, i);
  }
  std::rotate(devices.begin(), devices.begin() + static_cast<std::ptrdiff_t>(h), devices.end());
  const bool simulated = std::any_of(devices.begin(), devices.end(), isSimulated);
  if (devices != FeelOptions().devices) {
    for (const std::string& device : devices) add("--device", device);
  }
  // Without --seconds, the repeated run of a simulated hand would end after kFeelSeconds.
  if (simulated && options.seconds) add("--seconds", number(*options.seconds));
  if (!isReplay(devices[0])) {
    line += rateOption(options.rate);
    if (options.passive) line += " --passive";
    if (options.refill > 0.0) add("--refill", number(options.refill));
  }
  return line + untilOption(time);
}

}  // namespace palpate::cli
