#include "palpate/scenes/apps/cli/bare_loop.h"

#include <chrono>
#include <csignal>
#include <optional>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/engine/safety/safety.h"

namespace palpate::bare_loop_test {
namespace {

using cli::BareLoop;
using Clock = std::chrono::steady_clock;

std::optional<BareLoop::Seen> resultOf(BareLoop& loop) {
  constexpr auto kPatience = std::chrono::seconds(20);
  const Clock::time_point end = Clock::now() + kPatience;
  while (Clock::now() < end) {
    if (const auto seen = loop.take()) return seen;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return std::nullopt;
}

/// The result of a loop in a process that was stopped for a time.
struct Stopped {
  BareLoop::Seen seen;
  double least = 0.0;  ///< Shortest possible duration of the stop [s].
};

/// Runs a loop in another process for `seconds` + 0.5 s, and stops this process for `seconds`.
Stopped stopFor(double seconds) {
  int ends[2] = {-1, -1};
  REQUIRE(pipe(ends) == 0);
  const pid_t child = fork();
  if (child == 0) {
    BareLoop loop(0.5 + seconds, 1);
    const char begun = 1;
    bool told = write(ends[1], &begun, 1) == 1;
    const auto seen = resultOf(loop);
    told = told && seen && write(ends[1], &*seen, sizeof *seen) == sizeof *seen;
    _exit(told ? 0 : 1);
  }
  REQUIRE(child > 0);
  close(ends[1]);
  Stopped out;
  char begun = 0;
  CHECK(read(ends[0], &begun, 1) == 1);
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  kill(child, SIGSTOP);
  int status = 0;
  waitpid(child, &status, WUNTRACED);
  const Clock::time_point stopped = Clock::now();
  std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
  out.least = std::chrono::duration<double>(Clock::now() - stopped).count();
  kill(child, SIGCONT);
  CHECK(read(ends[0], &out.seen, sizeof out.seen) == sizeof out.seen);
  close(ends[0]);
  waitpid(child, &status, 0);
  CHECK(WIFEXITED(status));
  return out;
}

}  // namespace

TEST_CASE("the machine's lateness is measured for the requested time and its result is given once",
          "[safety]") {
  const Clock::time_point begun = Clock::now();
  BareLoop loop(0.2, 1);
  CHECK(!loop.take());
  const auto seen = resultOf(loop);
  REQUIRE(seen);
  CHECK(Clock::now() - begun >= std::chrono::milliseconds(200));
  CHECK(seen->worst > 0.0);
  CHECK((seen->late > 0) == (seen->worst > WatchLimits{}.late));
  CHECK(!loop.take());
  // Destroying a loop early must end it at once.
  const Clock::time_point ends = Clock::now();
  { const BareLoop longer(3600.0, 1); }
  CHECK(Clock::now() - ends < std::chrono::minutes(1));
}

TEST_CASE("a pause of 100 ms counts as lateness, and a longer stop of the whole program does not",
          "[safety]") {
  constexpr double kTick = 0.001;  // [s]
  const Stopped paused = stopFor(0.1);
  CAPTURE(paused.seen.worst, paused.seen.late, paused.least);
  CHECK(paused.seen.worst >= paused.least - kTick);
  CHECK(paused.seen.late >= 1);
  // All ticks missed during the stop count as one delay.
  CHECK(paused.seen.late < 50);

  const Stopped stopped = stopFor(Reengagement::kPause + 0.2);
  CAPTURE(stopped.seen.worst, stopped.least);
  CHECK(stopped.seen.worst <= Reengagement::kPause);
}

}  // namespace palpate::bare_loop_test
