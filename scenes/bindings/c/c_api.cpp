#include "palpate/scenes/bindings/c/c_api.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>

#include "palpate/devices/arm/servo.h"
#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/common/explain_tick.h"
#include "palpate/scenes/library/brick_places.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/library/scene_file.h"

// NOLINTBEGIN(readability-identifier-naming): C's names
struct palpate_hand {
  palpate_hand(palpate::DeviceInfo of, double at, bool real)
      : arm(of), rate(at), servo(std::move(of), at, real) {}

  palpate::DeviceInfo arm;
  double rate;
  std::filesystem::path path;  // absolute, because the host may change its working directory
  palpate::SceneCache cache;   // lets the force stay on after some edits (palpate_reload)
  palpate::Servo servo;
};

namespace {

using palpate::Vec3;

void copyTo(char* text, std::size_t size, const std::string& from) {
  if (text == nullptr || size == 0) return;
  const std::size_t count = std::min(from.size(), size - 1);
  std::memcpy(text, from.data(), count);
  text[count] = '\0';
}

/// Returns the message of f's exception; empty if f returns. No exception may reach C code.
template <class F>
std::string failureOf(F&& f) {
  try {
    f();
    return "";
  } catch (const std::exception& e) {
    // names of files in the message may contain any characters
    return palpate::cli::sentence(e.what()).text();
  } catch (...) {
    return "palpate: an exception of unknown type: report it to palpate's developers";
  }
}

void require(const void* given, const char* what) {
  if (given == nullptr) throw palpate::Error(what, "it is null", "give a valid pointer");
}

palpate::SceneSpec specFor(const palpate_hand& hand, const std::filesystem::path& path) {
  palpate::SceneSpec spec = palpate::openScene(path);
  (void)palpate::fitCoupling(spec, hand.arm);
  palpate::checkDevice(spec, hand.arm);
  return spec;
}

/// Builds a scene. Publishes only a complete scene.
void load(palpate_hand& hand, const std::filesystem::path& path) {
  auto scene = palpate::buildScene(specFor(hand, path), nullptr, &hand.cache).scene;
  hand.path = palpate::absolutePlace(path);
  hand.servo.publish(std::move(scene));
}

/// Checks only the limits of the coupling; the servo checks the limits of the force.
palpate::DeviceInfo infoOf(const palpate_arm& arm) {
  if (!(arm.max_stiffness > 0.0)) {
    throw palpate::DeviceError("arm", "max_stiffness is not above 0 N/m",
                               "set it in N/m, or begin with palpate_weakest_arm()");
  }
  if (!(arm.max_damping >= 0.0)) {
    throw palpate::DeviceError("arm", "max_damping is negative or not a number",
                               "set it in N s/m, or begin with palpate_weakest_arm()");
  }
  palpate::DeviceInfo info;
  info.name = "arm";
  info.limits.peak = arm.peak;
  info.limits.slew = arm.slew;
  info.max_stiffness = arm.max_stiffness;
  info.max_damping = arm.max_damping;
  info.hand = arm.hand != 0;
  info.source = "the host";
  return info;
}

/// Creates a hand and loads its scene. Returns null, and writes the error line, if this fails.
/// `real` is true if the host ticks in real time.
palpate_hand* loadHand(const char* path, const palpate_arm* arm, double rate, bool real,
                       char* error, size_t size) {
  std::unique_ptr<palpate_hand> hand;
  const std::string failure = failureOf([&] {
    require(path, "path");
    require(arm, "arm");
    palpate::cli::checkRate("rate", rate);
    hand = std::make_unique<palpate_hand>(infoOf(*arm), rate, real);
    load(*hand, path);
  });
  if (failure.empty()) return hand.release();
  copyTo(error, size, failure);
  return nullptr;
}

Vec3 vectorOf(const double p[3]) {
  return {p[0], p[1], p[2]};
}

}  // namespace

const char* palpate_version(void) {
  return palpate::kVersion;
}

palpate_arm palpate_weakest_arm(void) {
  const palpate::ForceLimits weakest;
  return {weakest.peak, weakest.slew, 500.0, 0.5, 1};
}

palpate_hand* palpate_load(const char* path, const palpate_arm* arm, double rate, char* error,
                           size_t size) {
  return loadHand(path, arm, rate, true, error, size);
}

palpate_hand* palpate_load_virtual(const char* path, const palpate_arm* arm, double rate,
                                   char* error, size_t size) {
  return loadHand(path, arm, rate, false, error, size);
}

int palpate_reload(palpate_hand* hand, const char* path, char* error, size_t size) {
  const std::string failure = failureOf([&] {
    require(hand, "hand");
    require(path, "path");
    load(*hand, path);
  });
  copyTo(error, size, failure);
  return failure.empty() ? 0 : -1;
}

void palpate_unload(palpate_hand* hand) {
  delete hand;  // NOLINT(cppcoreguidelines-owning-memory): C code has no smart pointers
}

int palpate_tick(palpate_hand* hand, const double position[3], double age, double dt,
                 palpate_felt* felt) {
  palpate::HandState state;
  state.position = vectorOf(position);
  state.age = age;
  const Vec3 force = hand->servo.tick(state, dt);
  const palpate::Telemetry& tick = hand->servo.latest();
  for (int axis = 0; axis < 3; ++axis) {
    felt->force[axis] = force[axis];
    felt->proxy[axis] = tick.report.proxy[axis];
  }
  felt->stiffness = tick.report.stiffness;
  felt->fault = static_cast<int>(tick.fault);
  return felt->fault;
}

void palpate_cut(palpate_hand* hand) {
  hand->servo.cut();
}

void palpate_clear(palpate_hand* hand) {
  hand->servo.clear();
}

const char* palpate_fault_words(int fault) {
  static const auto all_words = [] {
    std::array<std::string, palpate::kFaults> all;
    for (std::size_t i = 1; i < palpate::kFaults; ++i) {
      const auto one = static_cast<palpate::Fault>(i);
      all[i] = std::string(palpate::wordsFor(one)) + ": " + palpate::remedyFor(one);
    }
    return all;
  }();
  const auto known = static_cast<std::size_t>(std::max(fault, 0));
  return known < all_words.size() ? all_words[known].c_str() : "";
}

long palpate_explain(palpate_hand* hand, const double at[3], const double push[3], char* text,
                     size_t size) {
  std::string out;
  const std::string failure = failureOf([&] {
    require(hand, "hand");
    require(at, "at");
    require(push, "push");
    const auto silent = [](const std::string&) {};
    out = palpate::cli::dump(palpate::cli::explainTick(specFor(*hand, hand->path), vectorOf(at),
                                                       vectorOf(push), hand->rate, nullptr, silent)
                                 .json);
  });
  copyTo(text, size, failure.empty() ? out : failure);
  const auto length = static_cast<long>((failure.empty() ? out : failure).size());
  return failure.empty() ? length : -length;
}
// NOLINTEND(readability-identifier-naming)
