/// Work without Python's lock: its threads, Ctrl-C, and the end of Python.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <utility>

#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

/// Time between two polls for Python's signals, such as Ctrl-C. A poll takes Python's lock.
inline constexpr auto kAsk = std::chrono::milliseconds(50);

/// Returns true on the main thread, which alone receives signals. If another thread polled while
/// Python ends, Python would end it from within.
[[nodiscard]] bool onMainThread();

/// Counts threads other than the main one that compute without Python's lock. Python does not wait
/// for a daemon thread. The static objects of OpenVDB and TBB end with the process, so they would
/// end under a thread that still uses them, and the process would abort.
class Computing {
 public:
  static Computing& all() {
    static auto* one = new Computing;  // leaked: a parked thread outlives every static object
    return *one;
  }
  void enter() {
    const std::lock_guard lock(mutex_);
    ++threads_;
  }
  void leave() {
    const std::lock_guard lock(mutex_);
    --threads_;
    changed_.notify_all();
  }
  /// For a loop that may take hours: if Python has ended, the thread stops computing.
  void parkAtEnd() {
    if (!ended_.load(std::memory_order_relaxed)) return;
    leave();
    park();
  }
  /// Called after Python has ended: returns when no thread computes.
  void awaitEnd() {
    ended_ = true;
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return threads_ == 0; });
  }
  [[noreturn]] static void park();

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::atomic<bool> ended_ = false;
  int threads_ = 0;
};

/// Releases Python's lock. If a daemon thread took the lock back after Python has ended, Python
/// would end the thread from within, and the process with it. The thread waits for the end of the
/// process instead.
class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {
    if (counted_) Computing::all().enter();
  }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;
  ~Unlocked() {
    if (counted_) Computing::all().leave();
    if (_Py_IsFinalizing() != 0 && counted_) Computing::park();
    PyEval_RestoreThread(state_);
  }

 private:
  PyThreadState* state_;
  bool counted_ = !onMainThread();
};

/// Asks Python whether the user wants to stop, and throws its exception if so.
void askPython();

/// For a loop: calls askPython() at intervals.
class Asking {
 public:
  void operator()() {
    constexpr unsigned kBetween = 16;  // reading the clock costs a tenth of a sample
    if (!asks_) return Computing::all().parkAtEnd();
    if (++calls_ % kBetween != 0 || Clock::now() < next_) return;
    askPython();
    next_ = Clock::now() + kAsk;
  }

 private:
  using Clock = std::chrono::steady_clock;
  bool asks_ = onMainThread();
  unsigned calls_ = 0;
  Clock::time_point next_ = Clock::now() + kAsk;
};

/// Keeps work without a waiting caller: it runs to its end, and its result is dropped.
///
/// @param work   Its last owner waits for the end.
/// @param ended  Returns true once the work has ended.
/// @param kept   The object that it reads.
void abandon(std::shared_ptr<void> work, std::function<bool()> ended, py::object kept);
/// Drops abandoned work that has ended.
void dropEnded();

/// Runs `work` without Python's lock and returns its result. If the main thread calls, `work` runs
/// in another thread. Ctrl-C ends the wait, but not the work. `work` must therefore own the objects
/// that it uses, or the caller passes them as `kept`.
template <class Work>
auto aside(Work work, py::object kept = py::none()) {
  using Result = decltype(work());
  if (!onMainThread()) {
    const Unlocked unlocked;
    return work();
  }
  dropEnded();
  auto result = std::make_shared<std::future<Result>>();
  const auto ended = [result] {
    return result->wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  };
  try {
    const Unlocked unlocked;
    *result = std::async(std::launch::async, std::move(work));
    while (result->wait_for(kAsk) != std::future_status::ready) askPython();
  } catch (const py::error_already_set&) {
    abandon(result, ended, std::move(kept));
    throw;
  }
  return result->get();
}

}  // namespace palpate::python
