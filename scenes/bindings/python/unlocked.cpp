#include "palpate/scenes/bindings/python/unlocked.h"

#include <algorithm>
#include <csignal>
#include <stdexcept>
#include <unistd.h>
#include <vector>

namespace palpate::python {
namespace {

/// A task whose result is discarded, but which runs to its end.
struct Abandoned {
  std::shared_ptr<void> work;  ///< Future of the task; the future's destructor waits for the task.
  std::function<bool()> ended;
  py::object kept;
};
std::vector<Abandoned>& abandoned() {
  // never freed: Python objects must not be destroyed after the interpreter has ended
  static auto* all = new std::vector<Abandoned>;
  return *all;
}

/// Waits at the end of Python for abandoned tasks, because they use Python objects. During this
/// wait, Ctrl-C ends the process.
void awaitAbandoned() {
  if (abandoned().empty()) return;
  std::signal(SIGINT, SIG_DFL);
  const Unlocked unlocked;
  for (Abandoned& one : abandoned()) {
    one.ended = nullptr;
    one.work.reset();
  }
}

/// Id of the process that has imported the module. Its forks have no threads to wait for.
pid_t begun_in = 0;

/// Waits for the computing threads. Python calls awaitThreads() at its end, before static objects
/// are destroyed.
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
    throw std::runtime_error(
        "palpate: Python cannot register another exit function: import palpate before other "
        "modules");
  }
}

}  // namespace palpate::python
