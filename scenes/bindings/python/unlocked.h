/// Runs tasks without Python's lock. Handles their threads, Ctrl-C, and the end of Python.
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

/// Time between two checks for signals such as Ctrl-C. A check takes Python's lock.
inline constexpr auto kAsk = std::chrono::milliseconds(50);

/// Returns true on the main thread, the only thread that receives signals. If another thread checks
/// for signals while Python ends, Python ends that thread within the check.
[[nodiscard]] bool onMainThread();

/// Counts threads other than the main thread that compute without Python's lock. Python does not
/// wait for daemon threads. So without this count, static objects of OpenVDB and TBB could be
/// destroyed while a thread uses them, and the process would abort.
class Computing {
 public:
  static Computing& all() {
    // never freed, because a parked thread outlives all static objects
    static auto* one = new Computing;
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
  /// Blocks the calling thread for ever if Python has ended. Loops that may take hours call
  /// parkAtEnd().
  void parkAtEnd() {
    if (!ended_.load(std::memory_order_relaxed)) return;
    leave();
    park();
  }
  /// Waits until no thread computes. Call awaitEnd() after the end of Python.
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

/// Releases Python's lock until this object is destroyed. If Python has ended by then, a thread
/// other than the main thread does not take the lock, but waits for the end of the process. With
/// the lock, Python would end this thread, and the process would abort.
class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {
    if (counted_) Computing::all().enter();
  }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;
  ~Unlocked() {
    if (counted_) Computing::all().leave();
    if (isFinalizing() && counted_) Computing::park();
    PyEval_RestoreThread(state_);
  }

 private:
  static bool isFinalizing() {
#if PY_VERSION_HEX >= 0x030D0000
    return Py_IsFinalizing() != 0;
#else
    return _Py_IsFinalizing() != 0;
#endif
  }

  PyThreadState* state_;
  bool counted_ = !onMainThread();
};

/// Checks for signals such as Ctrl-C. Throws the exception that Python raises for a signal.
void askPython();

class Asking {
 public:
  void operator()() {
    constexpr unsigned kBetween = 16;  // reading the clock in each call would slow the samples
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

/// Abandons a task: the task runs to its end, and its result is discarded. `work` is the task's
/// future. `ended` returns true after the task's end. `kept` is the object that the task reads.
void abandon(std::shared_ptr<void> work, std::function<bool()> ended, py::object kept);
void dropEnded();

/// Runs `work` without Python's lock and returns its result. On the main thread, `work` runs in
/// another thread: Ctrl-C ends the wait, and `work` continues. So `work` must own the objects that
/// it uses, or the caller must pass them as `kept`.
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
