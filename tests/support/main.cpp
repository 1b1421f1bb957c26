#define CATCH_CONFIG_MAIN  // Catch2 3 has its main in a library.
#include <chrono>
#include <csignal>
#include <cstdio>
#include <iostream>
#include <memory>
#include <sched.h>
#include <stdexcept>
#include <string>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>

#include "tests/support/random.h"

namespace {

/// Keeps every core busy during this object's life, with one computing process per core.
class BusyNeighbours {
 public:
  BusyNeighbours() {
    const pid_t parent = getpid();
    const long cores = sysconf(_SC_NPROCESSORS_ONLN);
    for (long core = 0; core < cores; ++core) {
      const pid_t child = fork();
      if (child < 0) throw std::runtime_error("fork() of a neighbour failed: end other programs");
      if (child != 0) {
        children_.push_back(child);
        continue;
      }
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      if (getppid() != parent) _exit(0);
      cpu_set_t one;
      CPU_ZERO(&one);
      CPU_SET(static_cast<std::size_t>(core), &one);
      sched_setaffinity(0, sizeof(one), &one);
      for (volatile unsigned long n = 0;;) n = n + 1;
    }
  }
  ~BusyNeighbours() {
    for (const pid_t child : children_) {
      kill(child, SIGKILL);
      waitpid(child, nullptr, 0);
    }
  }
  BusyNeighbours(const BusyNeighbours&) = delete;
  BusyNeighbours& operator=(const BusyNeighbours&) = delete;

 private:
  std::vector<pid_t> children_;
};

using Listener = Catch::TestEventListenerBase;

/// Runs [host] tests, which depend on the scheduler, while every core is busy. Prints a line for
/// each test: result, seconds, name. After a random test, prints a line with the number of cases.
struct Surroundings : Listener {
  using Listener::Listener;

  void testCaseStarting(const Catch::TestCaseInfo& test) override {
    Listener::testCaseStarting(test);
    palpate::test::askedCases() = {};
    begun_ = std::chrono::steady_clock::now();
    name_ = test.name;
    if (test.tagsAsString().find("[host]") != std::string::npos) {
      neighbours_ = std::make_unique<BusyNeighbours>();
    }
  }
  void testCaseEnded(const Catch::TestCaseStats& stats) override {
    Listener::testCaseEnded(stats);
    neighbours_.reset();
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begun_;
    std::printf("%-7s %8.3f s  %s\n", stats.totals.testCases.failed == 0 ? "passed" : "failed",
                took.count(), name_.c_str());
    std::fflush(stdout);
    const auto [run, usual] = palpate::test::askedCases();
    if (usual > 0) {
      std::cout << "random cases: " << run << " of " << usual << ": " << name_ << '\n';
    }
  }

 private:
  std::string name_;  ///< of the running test
  std::unique_ptr<BusyNeighbours> neighbours_;
  std::chrono::steady_clock::time_point begun_;
};
CATCH_REGISTER_LISTENER(Surroundings)

}  // namespace
