#include "palpate/scenes/bindings/python/unlocked.h"

#include <algorithm>
#include <csignal>
#include <stdexcept>
#include <unistd.h>
#include <vector>

namespace palpate::python {
namespace {

/// Work without a waiting caller: it runs to its end, and its result is dropped.
struct Abandoned {
  std::shared_ptr<void> work;  ///< Its last owner waits for the end.
  std::function<bool()> ended;
  py::object kept;  ///< The object that it reads.
};
std::vector<Abandoned>& abandoned() {
  static auto* all = new std::vector<Abandoned>;  // leaked: Python's objects outlive no interpreter
  return *all;
}

/// Called when Python ends: waits for threads, because they use objects that end with Python.
/// Another Ctrl-C ends the process.
void awaitAbandoned() {
  if (abandoned().empty()) return;
  std::signal(SIGINT, SIG_DFL);
  const Unlocked unlocked;
  for (Abandoned& one : abandoned()) {
    one.ended = nullptr;
    one.work.reset();
  }
}

pid_t begun_in = 0;  ///< The process that has the threads. A fork of it has none of them.

/// Called after Python has ended, and before static objects end.
void awaitThreads() {
  if (getpid() != begun_in) return;
  std::signal(SIGINT, SIG_DFL);
  Computing::all().awaitEnd();
}

}  // namespace

bool onMainThread() {
  return gettid() == getpid();
}

void Computing::park() {
  while (true) pause();
}

void askPython() {
  const py::gil_scoped_acquire acquired;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

void abandon(std::shared_ptr<void> work, std::function<bool()> ended, py::object kept) {
  abandoned().push_back({std::move(work), std::move(ended), std::move(kept)});
}

void dropEnded() {
  auto& all = abandoned();
  all.erase(std::remove_if(all.begin(), all.end(), [](const auto& one) { return one.ended(); }),
            all.end());
}

void registerEnd() {
  py::module_::import("atexit").attr("register")(py::cpp_function(&awaitAbandoned));
  begun_in = getpid();
  if (Py_AtExit(&awaitThreads) != 0) {
    throw std::runtime_error("palpate: Python cannot register another exit function");
  }
}

}  // namespace palpate::python
