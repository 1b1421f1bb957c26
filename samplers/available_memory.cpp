#include "palpate/samplers/available_memory.h"

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <limits>
#include <numeric>
#include <sys/resource.h>
#include <unistd.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::infinity();

/// Returns the sum of the system's available memory and free swap space [bytes]; kUnknown if the
/// system does not state it.
double ofSystem() {
  std::ifstream info("/proc/meminfo");
  double sum = 0.0;
  bool known = false;
  std::string key;
  std::string unit;
  for (double kib = 0.0; info >> key >> kib && std::getline(info, unit);) {
    const bool available = key == "MemAvailable:";
    if (available || key == "SwapFree:") sum += 1024.0 * kib;
    known = known || available;
  }
  return known ? sum : kUnknown;
}

/// Returns the rest of the process's address space [bytes]; kUnknown if it has no limit.
double ofAddressSpace() {
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return kUnknown;
  std::ifstream memory("/proc/self/statm");
  double pages = 0.0;
  memory >> pages;
  const double used = pages * static_cast<double>(sysconf(_SC_PAGESIZE));
  return std::max(0.0, static_cast<double>(limit.rlim_cur) - used);
}

std::string megabytes(double bytes) {
  char text[32];
  std::snprintf(text, sizeof text, "%.0f MB", 1e-6 * bytes);
  return text;
}

}  // namespace

double availableMemory() {
  return std::min(ofSystem(), ofAddressSpace());
}

void checkMemory(const std::vector<MemoryNeed>& volumes) {
  if (volumes.empty()) return;
  const double sum = std::accumulate(
      volumes.begin(), volumes.end(), 0.0,
      [](double all, const MemoryNeed& one) { return all + static_cast<double>(one.bytes); });
  const double available = availableMemory();
  if (sum <= available) return;
  const MemoryNeed& largest =
      *std::max_element(volumes.begin(), volumes.end(),
                        [](const auto& a, const auto& b) { return a.bytes < b.bytes; });
  const std::string largest_size = megabytes(static_cast<double>(largest.bytes));
  throw VolumeError(
      "memory",
      std::to_string(volumes.size()) + (volumes.size() == 1 ? " volume needs" : " volumes need") +
          " at least " + megabytes(sum) + ", but " + megabytes(available) +
          " are available (the largest volume: " + largest.volume + ", " + largest_size + ")",
      "use smaller volumes, or volumes in bricks (palpate brick), or end other programs, or raise "
      "the limit of memory (ulimit -v) if there is one");
}

}  // namespace palpate
