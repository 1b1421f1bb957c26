/// palpate feel: runs a scene under a hand, here in virtual time.
#include <chrono>
#include <cmath>
#include <csignal>
#include <fstream>
#include <limits>
#include <optional>
#include <thread>
#include <unistd.h>

#include <fmt/format.h>

#include "devices/path_device.h"
#include "devices/simulated_device.h"
#include "engine/error.h"
#include "engine/step.h"
#include "engine/telemetry.h"
#include "scenes/cli/common.h"
#include "scenes/cli/felt.h"
#include "scenes/cli/picture.h"
#include "scenes/cli/version.h"
#include "scenes/scene_file.h"

namespace palpate::cli {
namespace {

volatile std::sig_atomic_t interrupted = 0;
constexpr double kDefaultSeconds = 10.0;

struct Options {
  std::string scene;
  std::string device = "simulated";
  std::optional<double> seconds;
  double rate = 1000.0;
  std::string trace;
  std::string summary;
  std::string picture;
  bool json = false;
};

std::unique_ptr<Device> makeDevice(const Options& options, const Box& bounds) {
  const std::string& name = options.device;
  if (name == "simulated") {
    const auto target = explore(bounds, options.seconds.value_or(kDefaultSeconds));
    return std::make_unique<SimulatedDevice>(ArmParams{}, GripParams{}, target, options.rate);
  }
  if (name.rfind("path:", 0) == 0) {
    const std::string file = name.substr(5);
    std::ifstream holder;
    std::istream& in = openInput(file, holder);
    return std::make_unique<PathDevice>(readPath(in, file == "-" ? "standard input" : file),
                                        options.rate);
  }
  throw DeviceError("--device", "\"" + name + "\" is not in this version",
                    "use simulated or path:FILE.csv");
}

/// The trace, row by row; a file that is not asked for costs nothing.
class Trace {
 public:
  explicit Trace(const std::string& path) {
    if (path.empty()) return;
    file_.emplace(path);
    text_ =
        "t,probe_x,probe_y,probe_z,proxy_x,proxy_y,proxy_z,force_x,force_y,force_z,error_bound,"
        "iterations,substeps,primitives,tick_ns,status,limited\n";
  }

  void add(const Telemetry& tick) {
    if (!file_) return;
    const StepReport& r = tick.report;
    const auto vector = [&](const Vec3& v) {
      for (int a = 0; a < 3; ++a) text_ += number(v[a]) + ",";
    };
    text_ += number(tick.time) + ",";
    vector(tick.probe);
    vector(r.proxy);
    vector(r.force);
    text_ += fmt::format("{},{},{},{},{},{},{}\n", number(r.error_bound), r.iterations, r.substeps,
                         r.primitives, tick.tick_ns, wordFor(r.status), r.limited ? 1 : 0);
    if (text_.size() > 1U << 20U) flush();
  }

  void commit() {
    if (!file_) return;
    flush();
    file_->commit();
  }

 private:
  void flush() {
    file_->write(text_);
    text_.clear();
  }
  std::optional<WholeFile> file_;
  std::string text_;
};

OrderedJson machine() {
  OrderedJson json;
  std::ifstream cpuinfo("/proc/cpuinfo");
  std::string line;
  std::string model = "unknown";
  while (std::getline(cpuinfo, line)) {
    if (line.rfind("model name", 0) == 0) {
      model = line.substr(std::min(line.size(), line.find(':') + 2));
      break;
    }
  }
  json["processor"] = model;
  json["cores"] = std::thread::hardware_concurrency();
  json["compiler"] = kCompiler;
  json["build"] = kBuildType;
  return json;
}

/// A line on a terminal that says how far the run is; nothing in a pipe.
class Progress {
 public:
  explicit Progress(std::int64_t ticks) : ticks_(ticks), shown_(isatty(2) != 0) {}
  ~Progress() {
    if (drawn_) fmt::print(stderr, "\r\033[K");
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void at(std::int64_t tick) {
    if (!shown_ || ticks_ <= 0 || tick % 50000 != 0 || tick == 0) return;
    drawn_ = true;
    fmt::print(stderr, "\rfeeling {} %", 100 * tick / ticks_);
  }

 private:
  std::int64_t ticks_;
  bool shown_;
  bool drawn_ = false;
};

/// No two outputs may go to one place, and none to what is read.
void checkOutputs(const Options& options, const SceneSpec& spec) {
  std::vector<std::string> places{options.trace, options.summary, options.picture};
  if (options.json) places.emplace_back("-");
  for (std::size_t i = 0; i < places.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (places[i].empty() || places[i] != places[j]) continue;
      throw Error("feel", "two outputs would go to \"" + places[i] + "\"",
                  "give each its own place");
    }
  }
  std::vector<std::filesystem::path> inputs{options.scene};
  if (options.device.rfind("path:", 0) == 0) inputs.emplace_back(options.device.substr(5));
  for (const auto& [name, volume] : spec.volumes) inputs.push_back(volume.file);
  for (const std::string& place : places) {
    for (const std::filesystem::path& input : inputs) {
      std::error_code error;
      if (!place.empty() && place != "-" && std::filesystem::equivalent(place, input, error)) {
        throw Error(place, "it is an input of this run", "write to another file");
      }
    }
  }
}

int feel(const Options& options) {
  if (!(options.rate >= 10.0 && options.rate <= 100000.0)) {
    throw Error("--rate", fmt::format("{} Hz is not 10 to 100000", options.rate), "use 1000");
  }
  if (options.seconds && !(*options.seconds > 0.0 && *options.seconds <= 1e6)) {
    throw Error("--seconds",
                fmt::format("{} is not more than 0 and at most 1000000", *options.seconds),
                "use 10");
  }
  const auto on_signal = [](int) { interrupted = 1; };
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  std::signal(SIGHUP, on_signal);

  // Everything that can be refused is refused before anything runs.
  const SceneSpec spec = openScene(options.scene, showProgress("loading"));
  checkOutputs(options, spec);
  for (const std::string& note : spec.notes) complain(note);
  const BuiltScene built = buildScene(spec, showProgress("loading"));
  for (const std::string& note : built.notes) complain(note);
  const std::unique_ptr<Device> device = makeDevice(options, built.bounds);
  checkDevice(spec, device->info().name, device->info().max_stiffness);
  std::optional<Picture> picture;
  if (!options.picture.empty()) picture.emplace(options.picture);
  Trace trace(options.trace);
  std::optional<WholeFile> summary_file;
  if (!options.summary.empty()) summary_file.emplace(options.summary);

  const double dt = 1.0 / options.rate;
  const bool whole_path = !options.seconds && options.device != "simulated";
  const double seconds = options.seconds.value_or(kDefaultSeconds);
  const std::int64_t most = whole_path
                                ? std::numeric_limits<std::int64_t>::max()
                                : static_cast<std::int64_t>(std::llround(seconds * options.rate));
  Reader reader;
  ProxyState state(device->info().limits);
  Felt felt(*built.scene, options.rate);
  Progress progress(whole_path ? 0 : most);
  for (std::int64_t i = 0; i < most && !device->ended() && interrupted == 0; ++i) {
    Telemetry tick;
    const HandState hand = device->read();
    const auto start = std::chrono::steady_clock::now();
    tick.report = hapticStep(*built.scene, reader, hand, state, dt);
    const auto end = std::chrono::steady_clock::now();
    device->write(tick.report.force);
    tick.time = static_cast<double>(i) / options.rate;
    tick.probe = hand.position;
    tick.tick_ns = std::chrono::nanoseconds(end - start).count();
    trace.add(tick);
    felt.add(tick, state);
    if (picture) picture->add(tick);
    progress.at(i);
  }

  OrderedJson summary;
  summary["version"] = kVersion;
  summary["scene"] = spec.source;
  summary["device"] = device->info().name;
  summary["clock"] = "virtual";
  const OrderedJson counted = felt.summary();
  for (const auto& [key, value] : counted.items()) {
    summary[key] = value;
    // In virtual time no tick is late, and the rate is kept by definition: there is no clock.
    if (key == "rate_asked") {
      summary["rate_kept"] = nullptr;
      summary["late_ticks"] = nullptr;
    }
  }
  summary["machine"] = machine();
  trace.commit();
  if (summary_file) {
    summary_file->write(dump(summary, 2) + "\n");
    summary_file->commit();
  }
  if (picture) picture->draw(spec, built);
  if (options.json) {
    fmt::print("{}\n", dump(summary, 2));
  } else if (options.trace != "-" && options.summary != "-") {
    fmt::print("run       {} s at {} Hz in virtual time, device {}, {} ticks\n{}",
               rounded(summary["seconds"].get<double>()), rounded(options.rate),
               device->info().name, summary["ticks"].get<std::int64_t>(), felt.words());
  }
  if (!felt.anything()) {
    complain(
        "feel: nothing was felt: the hand met no mode that acts: palpate check shows where the "
        "volumes are");
  }
  if (interrupted != 0) return kInterrupted;
  if (!state.faulted()) return kDone;
  complain("feel: the force was cut: a position or sample was not finite: mend the path or volume");
  return kEndedEarly;
}

}  // namespace

void addFeel(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand("feel", "Feels a scene and says what was felt, and how well");
  auto options = std::make_shared<Options>();
  verb->add_option("SCENE", options->scene, "A scene file, a .vdb or a folder of .vdb")->required();
  verb->add_option("--device", options->device,
                   "simulated (arm and hand with dynamics), or path:FILE.csv (header t,x,y,z)");
  verb->add_option("--seconds", options->seconds,
                   "How long (default: 10, or to the end of the path)");
  verb->add_option("--rate", options->rate, "Ticks a second (default 1000)");
  verb->add_option("--trace", options->trace, "CSV, one row a tick");
  verb->add_option("--summary", options->summary, "JSON");
  verb->add_option("--picture", options->picture, "PNG: path over the slices, force over time");
  verb->add_flag("--json", options->json, "Print the summary as JSON");
  verb->footer(
      "Example:\n  palpate feel head.json --seconds 10 --trace trace.csv --summary "
      "summary.json --picture felt.png");
  verb->callback([=, &body] { body = [=] { return feel(*options); }; });
}

}  // namespace palpate::cli
