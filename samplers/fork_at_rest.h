/// A fork of a process with threads that sleep.
#pragma once

#include <chrono>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>
#include <thread>
#include <unistd.h>

namespace palpate {

/// Returns true if all other threads of this process sleep.
inline bool othersSleep() {
  const std::string own = std::to_string(gettid());
  std::error_code error;
  for (const auto& thread : std::filesystem::directory_iterator("/proc/self/task", error)) {
    if (thread.path().filename() == own) continue;
    std::string stat;
    std::getline(std::ifstream(thread.path() / "stat"), stat);
    const std::size_t name_end = stat.rfind(')');  // "ID (NAME) STATE ..."
    if (name_end != std::string::npos && stat.compare(name_end, 4, ") S ") != 0) return false;
  }
  return true;
}

/// Waits until all other threads sleep, at most 1 s, then forks. Returns the result of fork().
///
/// A child that does not call exec() needs this. If a thread looks up a symbol during a fork, the
/// child of glibc 2.36 keeps a mark of this search, which never ends there. A thread that starts in
/// the child may get the mark with the old stack. Then the child waits forever when it loads or
/// unloads a library; MPI_Finalize unloads some. Threads may exist before main(): log4cplus, which
/// OpenVDB uses, starts four.
inline pid_t forkAtRest() {
  constexpr std::chrono::milliseconds kLongest(1000);
  for (std::chrono::milliseconds waited(0); waited < kLongest && !othersSleep(); ++waited) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return fork();
}

}  // namespace palpate
