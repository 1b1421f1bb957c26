/// A plug-in with faults. The part of the arm's serial number before a # selects the fault. The
/// part after the # separates tests that run at the same time.
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <limits>
#include <string>
#include <unistd.h>

#include "palpate/devices/plugins/plugin.h"
#include "tests/devices/plugins/odd_arm.h"

namespace {

using palpate::test::OddArm;

const palpate_plugin_host* host = nullptr;

struct Odd {
  palpate_plugin_device device;
  OddArm* arm;
  std::string kind;
  std::int64_t taken = 0;
  bool stopped = false;
  std::uint32_t begun = 0;

  [[nodiscard]] bool is(const char* word) const { return kind == word && arm->trouble != 0; }
};

Odd& oddOf(palpate_plugin_device* device) {
  return *static_cast<Odd*>(device->data);
}

/// Stores the time at which the trouble began, unless it is already stored.
void begins(Odd& odd) {
  std::int64_t none = 0;
  odd.arm->trouble_at.compare_exchange_strong(none, host->now());
}

/// Recurses until the stack overflows.
int deeper(int depth) {
  volatile char some[4096];
  some[0] = static_cast<char>(depth);
  return depth == 0 ? 0 : deeper(depth + 1) + some[0];
}

[[noreturn]] void hang() {
  for (;;) usleep(100000);
}

void crash() {
  volatile int* nothing = nullptr;
  *nothing = 1;  // NOLINT(clang-analyzer-core.NullDereference): the crash is intended
}

int facts(palpate_plugin_device* device, palpate_plugin_facts* out) {
  const Odd& odd = oddOf(device);
  out->has = PALPATE_PLUGIN_FORCE | PALPATE_PLUGIN_ORIENTATION | PALPATE_PLUGIN_GRIPPER;
  if (odd.kind == "held") out->has |= PALPATE_PLUGIN_DEADMAN;
  if (odd.kind == "fast") out->has |= PALPATE_PLUGIN_VELOCITY;
  out->force = odd.kind == "limitless" ? std::numeric_limits<double>::quiet_NaN() : 5.0;
  out->stiffness = 1000.0;
  out->damping = 5.0;
  out->workspace_radius = 0.1;
  out->rate = 1000.0;
  out->watchdog = odd.kind == "inside" || odd.kind == "unclosed" ? 0.05 : 0.0;
  out->resolution = 1e-5;
  out->joints = 3;
  out->buttons = 2;
  std::strcpy(out->button[0], "trigger");
  std::strcpy(out->source, "made up for a test");
  return odd.kind == "mute" ? PALPATE_PLUGIN_FAILED : PALPATE_PLUGIN_OK;
}

int prepare(palpate_plugin_device* device, char* error, size_t room) {
  const Odd& odd = oddOf(device);
  if (odd.kind == "unhomed") {
    (void)std::snprintf(error, room, "it finds no stop: turn it by hand");
    return PALPATE_PLUGIN_FAILED;
  }
  if (odd.kind == "slow") {
    host->say("press its button");
    while (host->ends() == 0) usleep(1000);
    return PALPATE_PLUGIN_FAILED;
  }
  if (odd.kind == "stillborn") crash();
  return PALPATE_PLUGIN_OK;
}

int read(palpate_plugin_device* device, palpate_plugin_reading* reading) {
  Odd& odd = oddOf(device);
  OddArm& arm = *odd.arm;
  ++arm.reads;
  // Acts like a plug-in that accepts only hosts with the full reading struct.
  if (reading->size < sizeof(palpate_plugin_reading)) return PALPATE_PLUGIN_NOTHING;
  if (arm.trouble != 0) begins(odd);
  if (odd.is("crash")) crash();
  if (odd.is("abort")) std::abort();
  if (odd.is("exit")) _exit(0);
  if (odd.is("stack")) return deeper(1);
  if (odd.is("hang") || odd.is("deadlock")) hang();
  if (odd.is("gone")) return PALPATE_PLUGIN_GONE;
  if (odd.is("nothing")) return PALPATE_PLUGIN_NOTHING;
  if (!odd.is("dead")) odd.taken = host->now();
  const double away = odd.is("jump") ? 0.03 : 0.0;
  for (int i = 0; i < 3; ++i) reading->position[i] = arm.position[i] + away;
  if (odd.is("nan")) reading->position[1] = std::numeric_limits<double>::quiet_NaN();
  if (odd.is("vast")) reading->position[1] = 1e300;
  reading->taken = odd.taken;
  if (odd.is("future")) reading->taken = std::numeric_limits<std::int64_t>::max();
  reading->state = PALPATE_PLUGIN_READY;
  if (odd.is("hot")) reading->state |= PALPATE_PLUGIN_HOT;
  if (odd.is("unpowered")) reading->state |= PALPATE_PLUGIN_UNPOWERED;
  if (odd.is("open")) reading->state |= PALPATE_PLUGIN_OPEN;
  if (odd.kind == "held" && !odd.is("held")) reading->state |= PALPATE_PLUGIN_HELD;
  reading->buttons = 0xFFFFFFFDU;
  reading->orientation[0] = 0.6;
  reading->orientation[3] = 0.8;
  reading->gripper = 0.25;
  reading->joints[0] = 0.5;
  // Writes beyond the given memory, which corrupts the process.
  if (odd.is("long")) std::memset(reading, 0xFF, 1U << 20U);
  return PALPATE_PLUGIN_OK;
}

int write(palpate_plugin_device* device, const palpate_plugin_force* force) {
  Odd& odd = oddOf(device);
  OddArm& arm = *odd.arm;
  ++arm.writes;
  const double* f = force->force;
  const bool zero = f[0] == 0.0 && f[1] == 0.0 && f[2] == 0.0;
  if (odd.is("stuck") || odd.is("inside")) {
    begins(odd);
    hang();
  }
  if (odd.is("refuse")) {
    begins(odd);
    if (!zero) return PALPATE_PLUGIN_FAILED;
  }
  if (zero) odd.stopped = false;
  if (odd.stopped) return PALPATE_PLUGIN_OK;
  arm.give(f[0], f[1], f[2], host->now());
  return PALPATE_PLUGIN_OK;
}

void stop(palpate_plugin_device* device) {
  Odd& odd = oddOf(device);
  ++odd.arm->stops;
  // Acts as if stop() waited for a lock that read() holds.
  if (odd.is("deadlock")) hang();
  odd.stopped = true;
  odd.arm->give(0.0, 0.0, 0.0, host->now());
  odd.arm->carried = 0.0;
}

void closeOdd(palpate_plugin_device* device) {
  Odd* odd = &oddOf(device);
  ++odd->arm->closes;
  if (odd->is("unclosed")) hang();
  delete odd;
}

void carry(palpate_plugin_device* device, double share) {
  oddOf(device).arm->carried = share;
}
double given(palpate_plugin_device* device) {
  return oddOf(device).is("warm") ? 0.25 : 1.0;
}

const void* deviceExtension(palpate_plugin_device* /*device*/, const char* name) {
  static const palpate_plugin_weight weight{sizeof(weight), 0, carry, 5.0};
  static const palpate_plugin_heat heat{sizeof(heat), 0, given};
  if (std::strcmp(name, PALPATE_PLUGIN_WEIGHT) == 0) return &weight;
  if (std::strcmp(name, PALPATE_PLUGIN_HEAT) == 0) return &heat;
  return nullptr;
}

int find(palpate_plugin_found* found, int room) {
  constexpr const char* kSerials[] = {
      "good",      "mute",  "held",   "fast",   "limitless", "inside",  "unhomed",   "slow",
      "stillborn", "crash", "abort",  "exit",   "hang",      "gone",    "nothing",   "dead",
      "jump",      "nan",   "vast",   "future", "hot",       "open",    "unpowered", "long",
      "stuck",     "warm",  "refuse", "stack",  "deadlock",  "unclosed"};
  int count = 0;
  for (const char* serial : kSerials) {
    if (count < room) {
      std::strcpy(found[count].serial, serial);
      std::strcpy(found[count].model, "an odd arm");
    }
    ++count;
  }
  return count;
}

palpate_plugin_device* open(const char* serial, char* error, size_t room) {
  const char* file = std::getenv(OddArm::kFile);
  if (std::strncmp(serial, "nobody", 6) == 0 || file == nullptr) {
    (void)std::snprintf(error, room, "no arm of that number is plugged in");
    return nullptr;
  }
  const std::string kind = std::string(serial).substr(0, std::string(serial).find('#'));
  static Odd tiny;  // static, because palpate cannot close these two
  static Odd closeless;
  Odd* odd = kind == "tiny" ? &tiny : kind == "closeless" ? &closeless : new Odd{};
  odd->kind = kind;
  odd->arm = OddArm::at(file);
  ++odd->arm->opens;
  // Opening sets the force to zero, because a real arm keeps its last force.
  odd->arm->give(0.0, 0.0, 0.0, host->now());
  // Waits until the test ends the trouble: otherwise the new process would exit, too.
  while (odd->is("exit") && host->ends() == 0) usleep(1000);
  odd->device = {sizeof(palpate_plugin_device),
                 0,
                 odd,
                 facts,
                 prepare,
                 read,
                 write,
                 stop,
                 closeOdd,
                 deviceExtension};
  if (odd->kind == "small") odd->device.size = offsetof(palpate_plugin_device, extension);
  if (odd->kind == "tiny") odd->device.size = offsetof(palpate_plugin_device, close);
  if (odd->kind == "readless") odd->device.read = nullptr;
  if (odd->kind == "closeless") odd->device.close = nullptr;
  return &odd->device;
}

constexpr palpate_plugin_factory kFactory{sizeof(palpate_plugin_factory), 0, find, open};

int init(const palpate_plugin_host* given_host) {
  host = given_host;
  return 0;
}
void end() {}
const void* factory(const char* name) {
  return std::strcmp(name, PALPATE_PLUGIN_ARMS) == 0 ? &kFactory : nullptr;
}

}  // namespace

#ifndef PALPATE_ODD_MAJOR
#define PALPATE_ODD_MAJOR PALPATE_PLUGIN_MAJOR
#endif

extern "C" const palpate_plugin_entry palpate_plugin{sizeof(palpate_plugin_entry),
                                                     PALPATE_ODD_MAJOR,
                                                     PALPATE_PLUGIN_MINOR,
                                                     0,
                                                     "arms with troubles",
                                                     "1.2",
                                                     "Apache-2.0",
                                                     init,
                                                     end,
                                                     factory};
