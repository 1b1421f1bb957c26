#include "bench/machine.h"

#include <algorithm>
#include <cstdio>
#include <fstream>

#include "palpate/engine/version.h"

namespace palpate::bench {

namespace {

bool stayHere() {
  cpu_set_t core;
  CPU_ZERO(&core);
  const int here = sched_getcpu();
  if (here < 0) return false;
  CPU_SET(static_cast<std::size_t>(here), &core);
  return sched_setaffinity(0, sizeof core, &core) == 0;
}

}  // namespace

Pinned::Pinned() : good_(sched_getaffinity(0, sizeof before_, &before_) == 0 && stayHere()) {}

Pinned::~Pinned() {
  if (good_) (void)sched_setaffinity(0, sizeof before_, &before_);
}

Machine takeMachine(bool pin) {
  Machine machine;
  machine.processor = "unknown processor";
  std::ifstream cpuinfo("/proc/cpuinfo");
  for (std::string line; std::getline(cpuinfo, line);) {
    if (line.rfind("model name", 0) == 0) machine.processor = line.substr(line.find(':') + 2);
  }
#if defined(__clang__)
  machine.compiler = std::string("clang ") + __clang_version__;
#else
  machine.compiler = std::string("g++ ") + __VERSION__;
#endif
  machine.flags = PALPATE_FLAGS;
  machine.commit = commit();
  if (machine.commit.empty()) machine.commit = "unknown";

  machine.pinned = pin && stayHere();

  machine.clock_step = 1e9;
  for (int i = 0; i < 1000; ++i) {
    const auto a = Clock::now();
    auto b = a;
    while (b == a) b = Clock::now();
    machine.clock_step =
        std::min(machine.clock_step, std::chrono::duration<double, std::nano>(b - a).count());
  }
  return machine;
}

std::string describe(const Machine& machine) {
  char step[32];
  std::snprintf(step, sizeof step, "%.0f", machine.clock_step);
  return machine.processor + ", " + machine.compiler + ", " + machine.flags + ", commit " +
         machine.commit + ", " + (machine.pinned ? "pinned" : "not pinned") + ", clock step " +
         step + " ns";
}

}  // namespace palpate::bench
