/// Describes the machine of a measurement, for the headings of tables and charts.
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
  /// Commit of the build; ends with "+" if tracked files other than documents differed from it.
  std::string commit;
  double clock_step = 0.0;  ///< Resolution of the clock: the smallest step that was seen [ns].
  bool pinned = false;
};

/// Keeps the calling thread on its present core while the object lives, if the system allows this.
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

/// Describes this machine. If `pin`, also pins the calling thread to its present core, if the
/// system permits this.
[[nodiscard]] Machine takeMachine(bool pin = true);

[[nodiscard]] std::string describe(const Machine& machine);

}  // namespace palpate::bench
