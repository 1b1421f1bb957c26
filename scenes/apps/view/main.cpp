/// `palpate-view`: the program of the window, which `palpate view` starts. It loads the scene a
/// second time for drawing, and reads the state of the loop from shared memory.
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <future>
#include <memory>
#include <new>
#include <sched.h>
#include <string>
#include <sys/resource.h>
#include <thread>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <tbb/task_group.h>
#include <vtkObject.h>
#include <vtkOutputWindow.h>
#include <vtkRenderWindow.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/view/display.h"
#include "palpate/scenes/apps/view/shapes.h"
#include "palpate/scenes/apps/view/window.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"
#include "palpate/scenes/library/scene_file.h"

namespace {

using namespace palpate;

/// Lowers the priority of this process, so that the loop has priority on every core.
void stepBack() {
  constexpr int kNice = 10;
  (void)!nice(kNice);
  // A software renderer starts at most this number of threads.
  const unsigned cores = std::thread::hardware_concurrency();
  setenv("LP_NUM_THREADS", std::to_string(cores > 2 ? cores - 1 : 1).c_str(), 0);
}

/// Ends the program without allocating memory. A library might not pass std::bad_alloc on.
[[noreturn]] void endWithoutMemory() {
  constexpr char kWords[] =
      "palpate: window: not enough memory to draw this scene: free memory, or run palpate feel, "
      "which does not draw\n";
  (void)!write(STDERR_FILENO, kWords, sizeof kWords - 1);
  _exit(cli::kEndedEarly);
}

/// Makes this process end before the loop if memory runs out: raises its OOM score, and limits its
/// memory to `most` [bytes]. If `most` is not positive, the limit is the memory that is available
/// now.
void takeNoMore(double most) {
  std::ofstream("/proc/self/oom_score_adj") << 1000;
  std::ifstream info("/proc/meminfo");
  std::string word;
  while (most <= 0.0 && info >> word) {
    if (word == "MemAvailable:" && info >> most) most *= 1024.0;
  }
  if (most <= 0.0) return;
  const rlimit limit{static_cast<rlim_t>(most), static_cast<rlim_t>(most)};
  (void)setrlimit(RLIMIT_DATA, &limit);
  std::set_new_handler(endWithoutMemory);
}

/// Excludes the core `loops`, which the loop uses, for all threads of this process. New threads
/// inherit the cores of their creator. A graphics driver's thread may undo this.
void stepAside(int loops) {
  cpu_set_t cores;
  if (loops < 0 || sched_getaffinity(0, sizeof cores, &cores) != 0) return;
  CPU_CLR(loops, &cores);
  // Repeats, because a thread that was not moved yet may have started another thread.
  for (bool moved = true; moved;) {
    moved = false;
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
      const pid_t thread = std::stoi(task.path().filename().string());
      cpu_set_t its;
      if (sched_getaffinity(thread, sizeof its, &its) != 0 || !CPU_ISSET(loops, &its)) continue;
      moved = sched_setaffinity(thread, sizeof cores, &cores) == 0 || moved;
    }
  }
}

/// Throws Error if OpenGL does not start, or its version is too old for VTK, which would crash.
void needOpenGL() {
  const auto window = vtkSmartPointer<vtkRenderWindow>::New();
  window->SetOffScreenRendering(1);
  if (window->SupportsOpenGL() == 0) {
    throw Error("display", "OpenGL does not start, or its version is below 3.2",
                "install a newer graphics driver");
  }
}

BuiltScene shown(const std::string& scene) {
  SceneSpec spec = openScene(scene);
  spec.waits = true;  // reads may block: this process has no real-time thread
  return buildScene(spec);
}

int run(int argc, char** argv) {
  CLI::App app{"The window of palpate view. Start it with palpate view."};
  app.name("palpate-view");
  app.set_version_flag("--version", versionText());
  std::string scene;
  std::string picture;
  std::string told;
  std::string shot;
  double told_every = 0.5;
  double most_memory = 0.0;
  view::ViewWindow::Options options;
  int live = -1;
  bool watch = false;
  app.add_option("SCENE", scene)->required();
  app.add_option("--live", live, "File descriptor of the memory that the loop shares")->required();
  app.add_option("--picture", picture, "Draw one picture, as a PNG file, and exit");
  app.add_option("--camera", options.camera, "Side of the camera");
  app.add_option("--slice", options.slice, "Planes of slices instead of surfaces and clouds");
  app.add_option("--reengage", options.reengage,
                 "Time from the last late tick until the loop restores the force [s]; 0: never");
  app.add_flag("--watch", watch, "Redraw the scene when its file changes");
  app.add_option("--told", told)->group("")->envname("PALPATE_VIEW_TOLD");
  app.add_option("--shot", shot)->group("")->envname("PALPATE_VIEW_SHOT");
  app.add_option("--told-every", told_every)->group("")->envname("PALPATE_VIEW_TOLD_EVERY");
  app.add_option("--memory", most_memory)->group("")->envname("PALPATE_VIEW_MEMORY");
  app.add_option("--width", options.width)->group("")->envname("PALPATE_VIEW_WIDTH");
  app.add_option("--height", options.height)->group("")->envname("PALPATE_VIEW_HEIGHT");
  app.add_option("--patience", options.patience)->group("")->envname("PALPATE_VIEW_PATIENCE");
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    return app.exit(e);
  } catch (const CLI::ParseError& e) {
    cli::complain(fmt::format("usage: {}: start the window with palpate view", e.what()));
    return cli::kBadInput;
  }
  LiveShare share(live);
  stepBack();
  const bool still = !picture.empty();
  const int loops = still ? -1 : loopsCore();
  stepAside(loops);
  // This call precedes takeNoMore(): under a limit of memory, a graphics driver would report no
  // display.
  view::needDisplay(still);
  vtkObject::GlobalWarningDisplayOff();
  needOpenGL();
  // If memory runs out while TBB starts, TBB 2022 waits forever. So it starts before the limit.
  tbb::task_group().run_and_wait([] {});
  takeNoMore(most_memory);
  auto seen = cli::writtenAt(scene);
  auto shapes = std::make_unique<view::Shapes>(shown(scene), still);
  if (watch) {
    options.again = [&scene, &seen, still] {
      const auto now = cli::writtenAt(scene);
      if (now == seen) return std::future<std::unique_ptr<view::Shapes>>();
      seen = now;
      return std::async(std::launch::async, [scene, still] {
        return std::make_unique<view::Shapes>(shown(scene), still);
      });
    };
  }
  options.shown = [loops] { stepAside(loops); };
  options.offscreen = still;
  if (options.offscreen) options.magnify = 2;
  const std::string title = fmt::format(
      "palpate: {}", cli::Legible(std::filesystem::path(scene).filename().string()).text());
  view::ViewWindow window(share.block(), std::move(shapes), title, options);
  if (still) {
    window.draw(picture);
    if (!told.empty()) std::ofstream(told) << window.told().dump(2) << "\n";
    return cli::kDone;
  }
  window.run(told_every, shot, told);
  return cli::kDone;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace palpate;
  // This process ignores Ctrl-C. The loop's process receives it too, and ends the run.
  std::signal(SIGINT, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  try {
    return run(argc, argv);
  } catch (const Error& e) {
    cli::complain(e.what());
    return cli::kBadInput;
  } catch (const std::bad_alloc&) {
    endWithoutMemory();
  } catch (const std::exception& e) {
    cli::complain(fmt::format(
        "internal error: {}: please report this message and your command line", e.what()));
    return cli::kInternal;
  }
}
