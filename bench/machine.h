/// Where numbers were measured, for the heads of tables and charts.
#pragma once

#include <chrono>
#include <sched.h>
#include <string>

namespace palpate::bench {

using Clock = std::chrono::steady_clock;

struct Machine {
  std::string processor;
  std::string compiler;
  std::string flags;
  std::string commit;       ///< Of the build; "+" where sources had been changed.
  double clock_step = 0.0;  ///< The clock's resolution: the smallest step seen [ns].
  bool pinned = false;      ///< The thread stays on one core.
};

/// Keeps the calling thread on the core that it is on, as long as this lives and where it is
/// allowed.
class Pinned {
 public:
  Pinned();
  Pinned(const Pinned&) = delete;
  Pinned& operator=(const Pinned&) = delete;
  ~Pinned();
  [[nodiscard]] bool good() const noexcept { return good_; }

 private:
  cpu_set_t before_;
  bool good_ = false;
};

/// Pins the calling thread to the core that it is on, where that is allowed and wanted, and looks
/// about.
[[nodiscard]] Machine takeMachine(bool pin = true);

/// One line of it, for the head of a table.
[[nodiscard]] std::string describe(const Machine& machine);

}  // namespace palpate::bench
