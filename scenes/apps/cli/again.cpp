#include "palpate/scenes/apps/cli/again.h"

#include <cmath>
#include <limits>

#include <fmt/format.h>

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

/// Formats a position for an option, rounded to kOptionGrid.
std::string optionWords(const Vec3& p) {
  return listOf(roundedTo(kOptionGrid, p), 9);
}

}  // namespace

std::string placeWords(const Vec3& p) {
  return listOf(roundedTo(kWordsGrid, p), 5);
}

std::optional<Again> againOf(const Most& most, const Scene& scene) {
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
  Again best;
  double least = std::numeric_limits<double>::infinity();
  for (const double before : {1e-3, 5e-4, 2e-3, 1e-4, 1e-5, 0.0, 4e-3, 6e-3, 8e-3, 12e-3}) {
    Again again;
    again.at = roundedTo(kOptionGrid, proxy - before * into);
    again.push = roundedTo(kOptionGrid, probe - again.at);
    constexpr double kTick = 1e-3;  // [s]: default tick of `palpate explain`
    Reader reader;
    ProxyState state(pathLimits());
    static_cast<void>(restAt(scene, reader, state, again.at, kTick));
    const Vec3 hand = again.at + again.push;
    const StepReport r = hapticStep(scene, reader, {hand}, state, kTick);
    // Compares only the spring's forces, because the damper's force depends on the hand's speed.
    const double off =
        std::abs(r.stiffness * (r.proxy - hand).norm() - most.stiffness * pressed.norm());
    if (off >= least) continue;
    least = off;
    best = again;
  }
  constexpr double kAlike = 0.1;
  const double spring = most.stiffness * pressed.norm();
  if (least > kAlike * spring) return std::nullopt;
  if (spring > 0.0) best.off = least / spring;
  return best;
}

std::string explainLine(const std::string& scene, const Again& again) {
  return fmt::format("palpate explain {} --at {} --push {}", shellWord(scene),
                     optionWords(again.at), optionWords(again.push));
}

}  // namespace palpate::cli
