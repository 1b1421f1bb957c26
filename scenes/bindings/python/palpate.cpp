/// The Python module `palpate`: volumes, fields, scenes and hands for scripts. See docs/python.md.
/// No loop calls Python: `run` and `sample` release its lock, `step` is one tick.
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <csignal>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <pybind11/eval.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>
#include <stdexcept>
#include <string>
#include <unistd.h>
#include <utility>
#include <vector>

#include "palpate/devices/json/json_node.h"
#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/play_clock.h"
#include "palpate/engine/tick/step.h"
#include "palpate/engine/version.h"
#include "palpate/samplers/grid/array_volume.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/apps/common/explain_tick.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::python {
namespace {

namespace py = pybind11;
using namespace pybind11::literals;

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;

constexpr double kFarthest = 1e6;  // [m], as hapticStep

// The module's errors are Python classes, so that a script can raise and pickle them.
constexpr char kErrors[] = R"py(
class Error(Exception):
    """What was wrong, why, and what to do about it: one line as str()."""
    def __init__(self, what, why, remedy):
        super().__init__(what, why, remedy)
        self.what, self.why, self.remedy = what, why, remedy
    def __str__(self):
        return f"{self.what}: {self.why}: {self.remedy}"

class VolumeError(Error):
    """A file, grid or array that cannot be felt."""

class SceneError(Error):
    """A scene that is wrong; `what` names the place in it, such as /modes/0/of."""

class DeviceError(Error):
    """A path that no hand can follow."""

for each in (Error, VolumeError, SceneError, DeviceError):
    each.__module__ = "palpate"
)py";

void raise(const char* kind, const Error& e) {
  const py::object type = py::module_::import("palpate").attr(kind);
  const auto line = [](const std::string& text) { return cli::sentence(text).text(); };
  const py::object error = type(line(e.subject()), line(e.reason()), line(e.remedy()));
  PyErr_SetObject(type.ptr(), error.ptr());
}

void translate(std::exception_ptr thrown) {
  try {
    if (thrown) std::rethrow_exception(std::move(thrown));
  } catch (const VolumeError& e) {
    raise("VolumeError", e);
  } catch (const SceneError& e) {
    raise("SceneError", e);
  } catch (const DeviceError& e) {
    raise("DeviceError", e);
  } catch (const Error& e) {
    raise("Error", e);
  } catch (const std::bad_alloc&) {
    raise("Error", {"memory", "there is not enough of it", "ask for less at once"});
  }
}

// Ctrl-C: Python's signals have to be polled. A thread without Python's lock takes it for a moment
// to do so.

constexpr auto kAsk = std::chrono::milliseconds(50);

/// Returns true on the main thread, which alone receives signals. If another thread polled while
/// Python ends, Python would end it from within.
bool onMainThread() {
  return gettid() == getpid();
}

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
  [[noreturn]] static void park() {
    while (true) pause();
  }

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
void askPython() {
  const py::gil_scoped_acquire acquired;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

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

/// Called when Python ends: threads have to end before the objects that they use. Another Ctrl-C
/// ends this wait, too.
void awaitAbandoned() {
  if (abandoned().empty()) return;
  std::signal(SIGINT, SIG_DFL);
  const Unlocked unlocked;
  for (Abandoned& one : abandoned()) {
    one.ended = nullptr;
    one.work.reset();
  }
}

pid_t begun_in = 0;  ///< The process of the threads; its forks do not have them.

/// Called after Python has ended, and before static objects end.
void awaitThreads() {
  if (getpid() != begun_in) return;
  std::signal(SIGINT, SIG_DFL);
  Computing::all().awaitEnd();
}

/// Runs `work` without Python's lock and returns its result. For the main thread, `work` runs in
/// another thread: it cannot be stopped, but the caller need not wait for it. So `work` owns the
/// objects that it uses, or they are `kept`.
template <class Work>
auto aside(Work work, py::object kept = py::none()) {
  using Result = decltype(work());
  if (!onMainThread()) {
    const Unlocked unlocked;
    return work();
  }
  auto& all = abandoned();
  all.erase(std::remove_if(all.begin(), all.end(), [](const auto& one) { return one.ended(); }),
            all.end());
  auto result = std::make_shared<std::future<Result>>();
  const auto ended = [result] {
    return result->wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  };
  try {
    const Unlocked unlocked;
    *result = std::async(std::launch::async, std::move(work));
    while (result->wait_for(kAsk) != std::future_status::ready) askPython();
  } catch (const py::error_already_set&) {
    abandoned().push_back({result, ended, std::move(kept)});
    throw;
  }
  return result->get();
}

py::tuple tupleOf(const Vec3& v) {
  return py::make_tuple(v.x(), v.y(), v.z());
}

py::tuple tupleOf(const Box& box) {
  return py::make_tuple(tupleOf(box.lower), tupleOf(box.upper));
}

Vec3 vectorOf(const Doubles& values, const char* what) {
  if (values.ndim() != 1 || values.shape(0) != 3) {
    throw Error(what, "it is not three numbers", "give (x, y, z)");
  }
  Vec3 v(values.at(0), values.at(1), values.at(2));
  if (!v.allFinite()) throw Error(what, "a number of it is not finite", "give (x, y, z)");
  return v;
}

// Volumes.

LoadOptions optionsOf(bool fill, int smooth) {
  constexpr int kWidest = 16;  // as in a scene file
  if (smooth < 0 || smooth > kWidest) {
    throw Error("smooth", std::to_string(smooth) + " voxels are not 0 to 16", "use 1");
  }
  LoadOptions options;
  options.non_finite = fill ? NonFinite::kFill : NonFinite::kRefuse;
  options.smooth = smooth;
  return options;
}

/// Warns of rounded integers, as `palpate import` does for floats.
void warnOfRounding(const py::array& values, const std::string& name) {
  const char kind = values.dtype().kind();
  if ((kind != 'i' && kind != 'u') || values.itemsize() < 8 || values.size() == 0) return;
  const py::int_ exact(std::int64_t{1} << 53U);
  const bool held =
      values.attr("max")().attr("item")() <= exact && values.attr("min")().attr("item")() >= -exact;
  if (held) return;
  const std::string told = name + ": whole numbers above 9,007,199,254,740,992 are rounded";
  if (PyErr_WarnEx(PyExc_UserWarning, told.c_str(), 1) != 0) throw py::error_already_set();
}

/// Returns floats and doubles as they are, other numbers as the smaller of the two that holds them
/// exactly.
py::array numbersOf(const py::object& given, const std::string& name) {
  if (py::isinstance(given, py::module_::import("numpy").attr("ma").attr("MaskedArray"))) {
    throw VolumeError(name, "it is a masked array", "give array.filled(background)");
  }
  py::array values = py::array::ensure(given);
  if (!values) throw VolumeError(name, "it is no array", "give one of numpy's, or nested lists");
  const char kind = values.dtype().kind();
  const py::ssize_t size = values.itemsize();
  const bool is_float = kind == 'f' && (size == 4 || size == 8);
  if (is_float && values.dtype().attr("isnative").cast<bool>()) return values;
  if (kind != 'f' && kind != 'i' && kind != 'u' && kind != 'b') {
    throw VolumeError(name, "its values are no real numbers",
                      "give an array of floats or integers");
  }
  warnOfRounding(values, name);
  const bool small = kind == 'f' ? size <= 4 : size <= 2;
  return values.attr("astype")(small ? "float32" : "float64").cast<py::array>();
}

std::shared_ptr<const Volume> volumeOf(const py::object& given, const py::object& spacing,
                                       const Doubles& origin, const std::string& name,
                                       bool level_set, std::optional<double> background, bool fill,
                                       int smooth) {
  const py::array values = numbersOf(given, name);
  const bool vector = values.ndim() == 4 && values.shape(3) == 3;
  if (values.ndim() != 3 && !vector) {
    throw VolumeError(name, "it is an array neither of (nx, ny, nz) nor of (nx, ny, nz, 3)",
                      "give values by x, y and z, a vector's components last");
  }
  VoxelArray array;
  array.values = values.data();
  array.type = values.itemsize() == 4 ? VoxelArray::Type::kFloat : VoxelArray::Type::kDouble;
  array.vector = vector;
  for (std::size_t a = 0; a < 3; ++a) {
    array.size[a] = values.shape(static_cast<py::ssize_t>(a));
    array.stride[a] = values.strides(static_cast<py::ssize_t>(a));
  }
  if (vector) array.component_stride = values.strides(3);
  const Doubles steps = Doubles::ensure(spacing);
  if (steps && steps.ndim() == 0) {
    array.axes = steps.data()[0] * Mat3::Identity();
  } else if (steps && steps.ndim() == 1 && steps.shape(0) == 3) {
    array.axes = vectorOf(steps, "spacing").asDiagonal();
  } else if (steps && steps.ndim() == 2 && steps.shape(0) == 3 && steps.shape(1) == 3) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) array.axes(i, j) = steps.at(i, j);
    }
  } else {
    throw VolumeError(name, "its spacing is not a number, three or 3 x 3",
                      "give the steps along x, y and z, or as columns of a matrix");
  }
  array.origin = vectorOf(origin, "origin");
  array.name = name;
  array.level_set = level_set;
  array.background = background;
  return aside([array, options = optionsOf(fill, smooth)] { return makeVolume(array, options); },
               values);
}

py::dict infoOf(const Volume& volume) {
  const GridInfo& info = volume.info();
  py::dict dict;
  dict["name"] = info.name;
  dict["type"] = info.type;
  dict["class"] = wordFor(info.grid_class);
  dict["vector"] = info.vector;
  dict["voxel"] = tupleOf(info.voxel);
  dict["active_voxels"] = info.active_voxels;
  dict["bounds"] = tupleOf(info.bounds);
  dict["memory"] = volume.memory();
  dict["lowest"] = info.lowest;
  dict["highest"] = info.highest;
  dict["mean"] = info.mean;
  dict["background"] = info.background;
  dict["filled"] = info.filled;
  return dict;
}

// Fields.

/// A row of the result of Field.sample.
struct ScalarRow {
  bool inside;
  double value;
  std::array<double, 3> gradient;
};
struct VectorRow {
  bool inside;
  std::array<double, 3> value;
  std::array<std::array<double, 3>, 3> jacobian;
};

ScalarRow rowOf(const ScalarSample& s) {
  return {s.inside, s.value, {s.gradient.x(), s.gradient.y(), s.gradient.z()}};
}

VectorRow rowOf(const VectorSample& s) {
  VectorRow row{s.inside, {s.value.x(), s.value.y(), s.value.z()}, {}};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      row.jacobian[i][j] = s.jacobian(static_cast<int>(i), static_cast<int>(j));
    }
  }
  return row;
}

template <class Row, class Field>
py::array sampled(const Field& field, const Doubles& points) {
  if (points.ndim() < 1 || points.shape(points.ndim() - 1) != 3) {
    throw Error("points", "their last axis has not three numbers", "give an array of (n, 3)");
  }
  const std::vector<py::ssize_t> shape(points.shape(), points.shape() + points.ndim() - 1);
  py::array_t<Row> rows(shape);
  const auto count = static_cast<std::size_t>(rows.size());
  Row* row = rows.mutable_data();
  const double* p = points.data();
  {
    const Unlocked unlocked;
    FieldCache cache;
    field.reset(cache);
    Asking asking;
    for (std::size_t i = 0; i < count; ++i, p += 3) {
      asking();
      row[i] = rowOf(field.sample(Vec3(p[0], p[1], p[2]), cache));
    }
  }
  return rows;
}

/// A field, with a name for messages.
struct NamedField {
  FieldPtr field;
  std::string name;

  [[nodiscard]] const FieldFrame& frame() const {
    return std::visit([](const auto& f) -> const FieldFrame& { return f->frame(); }, field);
  }
  [[nodiscard]] py::array sample(const Doubles& points) const {
    if (const auto* scalar = std::get_if<0>(&field)) return sampled<ScalarRow>(**scalar, points);
    return sampled<VectorRow>(*std::get<1>(field), points);
  }
};

NamedField fieldOf(const std::shared_ptr<const Volume>& volume, const std::string& interpolation,
                   bool axial) {
  const auto known = interpolationNamed(interpolation);
  if (!known) {
    throw Error("interpolation", "\"" + interpolation + "\" is not known",
                "use trilinear, nearest, quadratic or cubic");
  }
  const Sampling sampling{*known, axial};
  return {aside([volume, sampling] { return makeVdbField(volume, Placement{}, sampling); }),
          volume->info().name};
}

/// Samples the field on a lattice over its bounds, for VTK. The default of `spacing` is a voxel, or
/// 1/256 of the longest side if that is more: half a voxel would be too fine for large volumes.
py::object toVtk(const NamedField& field, std::optional<double> spacing) {
  const FieldFrame& frame = field.frame();
  const Vec3 size = frame.bounds.size();
  const double step = spacing.value_or(std::max(frame.voxel, size.maxCoeff() / 256.0));
  constexpr double kMost = 1e9;
  const Vec3 counts = (size / step).array().floor() + 1.0;
  if (!(step > 0.0) || !(counts.prod() <= kMost)) {
    throw Error("spacing", "it is not above 0, or leads to more than 10^9 points",
                "give metres, or the volume's own unit, from point to point");
  }
  const auto nx = static_cast<py::ssize_t>(counts.x());
  const auto ny = static_cast<py::ssize_t>(counts.y());
  const auto nz = static_cast<py::ssize_t>(counts.z());
  // x runs fastest, as in VTK.
  Doubles points(std::vector<py::ssize_t>{nz, ny, nx, 3});
  double* p = points.mutable_data();
  for (py::ssize_t k = 0; k < nz; ++k) {
    for (py::ssize_t j = 0; j < ny; ++j) {
      for (py::ssize_t i = 0; i < nx; ++i, p += 3) {
        p[0] = frame.bounds.lower.x() + step * static_cast<double>(i);
        p[1] = frame.bounds.lower.y() + step * static_cast<double>(j);
        p[2] = frame.bounds.lower.z() + step * static_cast<double>(k);
      }
    }
  }
  const py::object rows = field.sample(points).attr("reshape")(-1);
  py::module_ model;
  py::module_ support;
  try {
    model = py::module_::import("vtkmodules.vtkCommonDataModel");
    support = py::module_::import("vtkmodules.util.numpy_support");
  } catch (const py::error_already_set& e) {
    if (!e.matches(PyExc_ImportError)) throw;
    throw Error("to_vtk", "VTK's Python modules are not there", "install python3-vtk9");
  }
  py::object image = model.attr("vtkImageData")();
  image.attr("SetDimensions")(nx, ny, nz);
  image.attr("SetSpacing")(step, step, step);
  image.attr("SetOrigin")(frame.bounds.lower.x(), frame.bounds.lower.y(), frame.bounds.lower.z());
  const auto add = [&](const py::object& values, const std::string& name) {
    py::object array = support.attr("numpy_to_vtk")(values, "deep"_a = true);
    array.attr("SetName")(name);
    image.attr("GetPointData")().attr("AddArray")(array);
  };
  const py::object numpy = py::module_::import("numpy");
  add(numpy.attr("ascontiguousarray")(rows["value"]), field.name);
  add(rows["inside"].attr("astype")("uint8"), "inside");
  image.attr("GetPointData")().attr("SetActiveScalars")(field.name);
  return image;
}

// Scenes and hands.

/// A row of a run: the columns of `palpate feel --trace`.
struct TraceRow {
  double t;
  std::array<double, 3> probe;
  std::array<double, 3> proxy;
  std::array<double, 3> force;
  double error_bound;
  std::int64_t iterations;
  std::int64_t substeps;
  std::int64_t primitives;
  std::int64_t tick_ns;
  std::array<char32_t, 16> status;
  bool limited;
  double waiting;
};

py::dtype traceType() {
  py::list names;
  py::list formats;
  py::list offsets;
  const auto add = [&](const std::string& name, const char* format, std::size_t offset) {
    names.append(name);
    formats.append(format);
    offsets.append(offset);
  };
  const auto add3 = [&](const std::string& name, std::size_t offset) {
    for (const char* axis : {"_x", "_y", "_z"}) {
      add(name + axis, "f8", offset);
      offset += sizeof(double);
    }
  };
  add("t", "f8", offsetof(TraceRow, t));
  add3("probe", offsetof(TraceRow, probe));
  add3("proxy", offsetof(TraceRow, proxy));
  add3("force", offsetof(TraceRow, force));
  add("error_bound", "f8", offsetof(TraceRow, error_bound));
  add("iterations", "i8", offsetof(TraceRow, iterations));
  add("substeps", "i8", offsetof(TraceRow, substeps));
  add("primitives", "i8", offsetof(TraceRow, primitives));
  add("tick_ns", "i8", offsetof(TraceRow, tick_ns));
  add("status", "U16", offsetof(TraceRow, status));
  add("limited", "?", offsetof(TraceRow, limited));
  add("waiting", "f8", offsetof(TraceRow, waiting));
  return {names, formats, offsets, sizeof(TraceRow)};
}

TraceRow rowOf(const Telemetry& tick) {
  const StepReport& r = tick.report;
  TraceRow row{};
  const auto put = [](std::array<double, 3>& to, const Vec3& v) { to = {v.x(), v.y(), v.z()}; };
  row.t = tick.time;
  put(row.probe, tick.probe);
  put(row.proxy, r.proxy);
  put(row.force, r.force);
  row.error_bound = r.error_bound;
  row.iterations = r.iterations;
  row.substeps = r.substeps;
  row.primitives = r.primitives;
  row.tick_ns = tick.tick_ns;
  const char* word = wordFor(r.status);
  for (std::size_t i = 0; word[i] != '\0'; ++i) row.status[i] = static_cast<unsigned char>(word[i]);
  row.limited = r.limited;
  row.waiting = r.stiffness * r.waiting.norm();
  return row;
}

/// Stores rows in memory that was reserved before the first tick.
class Rows final : public TickSink {
 public:
  explicit Rows(std::size_t most) { rows.reserve(most); }
  void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
    if (rows.size() < rows.capacity()) rows.push_back(rowOf(tick));
  }
  std::vector<TraceRow> rows;
};

/// Reads positions, one a tick, or rows of t, x, y, z.
std::vector<PathPoint> pathOf(const Doubles& given, double rate) {
  const py::ssize_t width = given.ndim() == 2 ? given.shape(1) : 0;
  if ((width != 3 && width != 4) || given.shape(0) == 0) {
    throw DeviceError("path", "it is an array neither of (n, 3) nor of (n, 4)",
                      "give positions x, y, z, a tick each, or rows of t, x, y, z");
  }
  std::vector<PathPoint> path;
  const double* row = given.data();
  for (py::ssize_t i = 0; i < given.shape(0); ++i, row += width) {
    const double* p = row + (width - 3);
    const double t = width == 4 ? row[0] : static_cast<double>(i) / rate;
    const PathPoint point{t, {p[0], p[1], p[2]}};
    if (!std::isfinite(t) || !point.p.allFinite() || point.p.cwiseAbs().maxCoeff() >= kFarthest) {
      throw DeviceError("path row " + std::to_string(i), "it has a number that is no place or time",
                        "give seconds, and metres within 1,000 km");
    }
    if (!path.empty() && !(t > path.back().t)) {
      throw DeviceError("path row " + std::to_string(i), "the time does not rise",
                        "sort the rows by t and drop equal times");
    }
    path.push_back(point);
  }
  return path;
}

DeviceInfo pathInfo() {
  return PathDevice({PathPoint{}}, 1000.0).info();
}

/// A script's own hand in a scene, one tick at a time.
class Hand {
 public:
  Hand(std::shared_ptr<const Scene> scene, const PlayParams& play, double rate)
      : scene_(std::move(scene)), dt_(1.0 / rate), clock_(play), state_(pathInfo().limits) {}

  std::tuple<double, double, double> step(double x, double y, double z,
                                          std::optional<double> play) {
    if (play) {
      constexpr double kMost = 1e9;  // as the times of PathDevice
      if (!(std::abs(*play) <= kMost)) {
        throw DeviceError("play", "it is no number of seconds", "give one, up to 1e9");
      }
      // A script's time counts as continuous play, however long the step.
      const double from = std::exchange(play_, *play);
      state_.playAt(play_, (play_ - from) / dt_);
    } else {
      play_ = clock_.next(head_, dt_);
      state_.playAt(play_, head_.rate);
    }
    report_ = hapticStep(*scene_, reader_, {{x, y, z}}, state_, dt_);
    return {report_.force.x(), report_.force.y(), report_.force.z()};
  }
  void clear() { state_.clearFault(); }

  [[nodiscard]] py::tuple proxy() const { return tupleOf(report_.proxy); }
  [[nodiscard]] std::string fault() const {
    return state_.faulted() ? wordsFor(state_.fault()) : std::string();
  }
  [[nodiscard]] py::dict report() const {
    py::dict dict;
    dict["force"] = tupleOf(report_.force);
    dict["wanted"] = tupleOf(report_.wanted);
    dict["proxy"] = tupleOf(report_.proxy);
    dict["stiffness"] = report_.stiffness;
    dict["error_bound"] = report_.error_bound;
    dict["iterations"] = report_.iterations;
    dict["substeps"] = report_.substeps;
    dict["samples"] = report_.samples;
    dict["primitives"] = report_.primitives;
    dict["parts"] = report_.parts;
    dict["status"] = wordFor(report_.status);
    dict["limited"] = report_.limited;
    return dict;
  }

 private:
  std::shared_ptr<const Scene> scene_;
  double dt_;
  PlayClock clock_;    ///< For ticks without a time of their own.
  PlayHead head_;      ///< Present state of `clock_`.
  double play_ = 0.0;  ///< Play time of the last tick [s].
  Reader reader_;
  ProxyState state_;
  StepReport report_;
};

using Volumes = std::map<std::string, std::shared_ptr<const Volume>>;

/// Returns text as it is, other objects as Python's json writes them; numpy objects as lists and
/// numbers.
std::string jsonOf(const py::object& given) {
  try {
    if (py::isinstance<py::str>(given)) return given.attr("encode")().cast<std::string>();
    const py::cpp_function plain([](const py::object& one) -> py::object {
      if (py::hasattr(one, "tolist")) {
        py::object list = one.attr("tolist")();
        if (py::type::of(list).is(py::type::of(one))) return py::float_(one);  // a long double
        return list;
      }
      const auto type = py::str(py::type::of(one).attr("__name__")).cast<std::string>();
      throw py::type_error("a " + type + " is no number, text, list or dict");
    });
    return py::module_::import("json")
        .attr("dumps")(given, "default"_a = plain, "allow_nan"_a = false)
        .cast<std::string>();
  } catch (const py::error_already_set& e) {
    if (!e.matches(PyExc_TypeError) && !e.matches(PyExc_ValueError) &&
        !e.matches(PyExc_RecursionError)) {
      throw;
    }
    const auto why = py::str(e.value()).cast<std::string>();
    throw SceneError("scene", "it cannot be written as JSON (" + why + ")",
                     "give finite numbers, texts, lists and dicts, or numpy's");
  }
}

/// Adds the script's own volumes to a scene: they need no file, and may have no entry.
std::string withVolumes(const std::string& text, const Volumes& volumes) {
  if (volumes.empty()) return text;
  Json scene = parseJson(text, "scene", raiseAs<SceneError>);
  if (!scene.is_object()) return text;
  Json& listed = scene.emplace("volumes", Json::object()).first.value();
  for (const auto& [name, volume] : volumes) {
    if (!listed.is_object()) break;
    Json& words = listed.emplace(name, Json::object()).first.value();
    if (words.is_object()) words.emplace("file", name);
  }
  return scene.dump();
}

/// A scene that can be felt, and its hand for Scene.step.
class PyScene {
 public:
  explicit PyScene(SceneSpec spec) : spec_(waiting(std::move(spec))), built_(buildScene(spec_)) {
    checkDevice(spec_, pathInfo());
  }

  [[nodiscard]] static PyScene load(const std::filesystem::path& path) {
    return aside([path] { return PyScene(openScene(path)); });
  }

  [[nodiscard]] static PyScene parse(const py::object& given, const Volumes& volumes,
                                     const std::filesystem::path& folder) {
    SceneSpec spec = parseScene(withVolumes(jsonOf(given), volumes), "scene", folder);
    return built(std::move(spec), volumes);
  }

  [[nodiscard]] py::array run(const Doubles& given, double rate) const {
    cli::checkRate("rate", rate);
    std::vector<PathPoint> path = pathOf(given, rate);
    const double ticks = (path.back().t - path.front().t) * rate + 2.0;
    constexpr double kMost = 1e8;
    if (!(ticks <= kMost)) {
      throw DeviceError("path", "it takes more than 10^8 ticks", "run it in pieces");
    }
    PathDevice device(std::move(path), rate);
    auto rows = std::make_unique<Rows>(static_cast<std::size_t>(ticks));
    {
      const Unlocked unlocked;
      const PlayClock clock(built_.play);
      HapticLoop loop(device, rate, rows.get());
      loop.playBy(&clock);
      loop.publish(built_.scene);
      TickTime time;
      time.dt = 1.0 / rate;
      Asking asking;
      for (std::int64_t i = 0; !device.ended(); ++i) {
        asking();
        time.now = static_cast<double>(i) / rate;
        loop.tick(time);
      }
    }
    const std::vector<TraceRow>& made = rows->rows;
    const py::capsule owner(rows.get(), [](void* p) { delete static_cast<Rows*>(p); });
    (void)rows.release();  // the capsule owns it
    return {traceType(), {made.size()}, {sizeof(TraceRow)}, made.data(), owner};
  }

  [[nodiscard]] std::unique_ptr<Hand> hand(double rate) const {
    cli::checkRate("rate", rate);
    return std::make_unique<Hand>(built_.scene, built_.play, rate);
  }
  std::tuple<double, double, double> step(double x, double y, double z,
                                          std::optional<double> play) {
    if (!own_) own_ = hand(1000.0);
    return own_->step(x, y, z, play);
  }

  [[nodiscard]] py::object explain(const Doubles& at, const Doubles& push, double rate) const {
    const Vec3 from = vectorOf(at, "at");
    const Vec3 by = vectorOf(push, "push");
    const std::string text = aside([spec = loaded(), from, by, rate] {
      // The scene has reported its notes already.
      const auto silent = [](const std::string& /*line*/) {};
      return cli::dump(cli::explainTick(spec, from, by, rate, nullptr, silent).json);
    });
    return py::module_::import("json").attr("loads")(text);
  }

  [[nodiscard]] const std::string& source() const { return spec_.source; }
  [[nodiscard]] const Box& bounds() const { return built_.bounds; }
  [[nodiscard]] std::vector<std::string> notes() const {
    std::vector<std::string> all = spec_.notes;
    all.insert(all.end(), built_.notes.begin(), built_.notes.end());
    return all;
  }
  [[nodiscard]] std::map<std::string, NamedField> fields() const {
    std::map<std::string, NamedField> named;
    for (const auto& [name, field] : built_.fields) named[name] = {field, name};
    return named;
  }
  [[nodiscard]] Volumes volumes() const { return built_.volumes; }

 private:
  /// Ticks from Python are in virtual time.
  [[nodiscard]] static SceneSpec waiting(SceneSpec spec) {
    spec.waits = true;
    return spec;
  }
  [[nodiscard]] static PyScene built(SceneSpec spec, const Volumes& volumes) {
    for (const auto& [name, volume] : volumes) spec.volumes.at(name).volume = volume;
    return aside([spec = std::move(spec)]() mutable { return PyScene(std::move(spec)); });
  }

  /// Returns the scene with the volumes that are already loaded.
  [[nodiscard]] SceneSpec loaded() const {
    SceneSpec spec = spec_;
    for (auto& [name, volume] : spec.volumes) {
      if (const auto found = built_.volumes.find(name); found != built_.volumes.end()) {
        volume.volume = found->second;
      }
    }
    return spec;
  }

  SceneSpec spec_;
  BuiltScene built_;
  std::unique_ptr<Hand> own_;
};

// The balance.

Primitive primitiveOf(const std::string& kind, const Doubles& position, const Doubles& direction,
                      double strength) {
  Primitive primitive;
  bool known = false;
  for (const PrimitiveKind k : {PrimitiveKind::kForce, PrimitiveKind::kPoint, PrimitiveKind::kLine,
                                PrimitiveKind::kPlane}) {
    if (kind != wordFor(k)) continue;
    primitive.kind = k;
    known = true;
  }
  if (!known)
    throw Error("kind", "\"" + kind + "\" is not known", "use force, point, line or plane");
  if (!(strength >= 0.0) || !std::isfinite(strength)) {
    throw Error("strength", "it is not a number of at least 0", "give newtons");
  }
  primitive.strength = strength;
  primitive.position = vectorOf(position, "position");
  if (primitive.kind != PrimitiveKind::kPoint) {
    const Vec3 q = vectorOf(direction, "direction");
    const double length = q.stableNorm();
    if (!(length > 0.0) || !std::isfinite(length)) {
      throw Error("direction", "it has no direction", "give a vector that is not zero");
    }
    primitive.direction = (q / length).normalized();
  }
  return primitive;
}

py::dict solve(double stiffness, const Doubles& probe, const std::vector<Primitive>& primitives,
               const std::optional<Doubles>& start) {
  const Vec3 from = vectorOf(probe, "probe");
  const SolveResult result =
      solveProxy(from, stiffness, primitives, start ? vectorOf(*start, "start") : from);
  if (result.status == SolveStatus::kBadInput) {
    throw Error("solve",
                "a number is not finite or overflows, the stiffness is not above 0, or there are "
                "more than " +
                    std::to_string(kMaxPrimitives) + " primitives",
                "give metres, newtons and N/m of a haptic scene");
  }
  py::dict dict;
  dict["proxy"] = tupleOf(result.proxy);
  dict["force"] = tupleOf(Vec3(stiffness * result.offset));
  dict["error_bound"] = result.error_bound;
  dict["iterations"] = result.iterations;
  dict["solver"] = result.solver == SolverKind::kClosedForm ? "closed-form" : "general";
  dict["status"] = result.status == SolveStatus::kConverged ? "converged" : "iteration-limit";
  return dict;
}

// The module.

void bindErrors(py::module_& m) {
  py::exec(kErrors, m.attr("__dict__"));
  if (py::hasattr(m, "each")) py::delattr(m, "each");
  py::register_exception_translator(translate);
}

/// Registers what waits for threads when Python ends.
void registerEnd() {
  py::module_::import("atexit").attr("register")(py::cpp_function(&awaitAbandoned));
  begun_in = getpid();
  if (Py_AtExit(&awaitThreads) != 0) {
    throw std::runtime_error("palpate: Python takes no more functions to call at its end");
  }
}

void bindField(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(ScalarRow, inside, value, gradient);
  PYBIND11_NUMPY_DTYPE(VectorRow, inside, value, jacobian);

  py::class_<NamedField>(m, "Field",
                         "A scalar or vector field. In a scene it stands in W, in metres; of a "
                         "volume by itself in the volume's own space. Derivatives are per unit of "
                         "the volume's own space.")
      .def("sample", &NamedField::sample, "points"_a,
           "A structured array of a row a point: inside, value and gradient of a scalar; inside, "
           "value and jacobian[i][j] = d v_i / d x_j of a vector. Points: (n, 3) or (3,).")
      .def("to_vtk", &toVtk, "spacing"_a = py::none(),
           "A vtkImageData of the field sampled over its bounds, `spacing` apart: by default a "
           "voxel, but at most 257 points a side. pyvista.wrap() takes it.")
      .def_readonly("name", &NamedField::name)
      .def_property_readonly("vector", [](const NamedField& f) { return f.field.index() == 1; })
      .def_property_readonly("voxel", [](const NamedField& f) { return f.frame().voxel; })
      .def_property_readonly("bounds",
                             [](const NamedField& f) { return tupleOf(f.frame().bounds); });
}

void bindVolume(py::module_& m) {
  py::class_<Volume, std::shared_ptr<Volume>>(m, "Volume", "One grid in memory; never changes.")
      .def_static(
          "load",
          [](const std::filesystem::path& file, const std::string& grid, bool fill, int smooth) {
            return std::const_pointer_cast<Volume>(
                aside([file, grid, options = optionsOf(fill, smooth)] {
                  return loadVolume(file, grid, options);
                }));
          },
          "file"_a, "grid"_a = "", "fill"_a = false, "smooth"_a = 0,
          "A grid of a .vdb; its name may be left out where there is one. `fill`: values that are "
          "no numbers become the background. `smooth`: width of a Gaussian, in voxels.")
      .def(
          "field",
          [](const std::shared_ptr<Volume>& volume, const std::string& interpolation, bool axial) {
            return fieldOf(volume, interpolation, axial);
          },
          "interpolation"_a = "trilinear", "axial"_a = false,
          "The field over it, in its own space: trilinear, nearest, quadratic or cubic. The edge "
          "of "
          "the values, as an array's end, disturbs a quadratic or cubic one within eight voxels.")
      .def_property_readonly("name", [](const Volume& v) { return v.info().name; })
      .def_property_readonly("info", &infoOf, "What `palpate info` prints, as a dict.");
}

void bindArrayVolume(py::module_& m) {
  m.def(
      "volume",
      [](const py::object& values, const py::object& spacing, const Doubles& origin,
         const std::string& name, bool level_set, std::optional<double> background, bool fill,
         int smooth) {
        return std::const_pointer_cast<Volume>(
            volumeOf(values, spacing, origin, name, level_set, background, fill, smooth));
      },
      "array"_a, "spacing"_a = 1.0, "origin"_a = std::array<double, 3>{0.0, 0.0, 0.0},
      "name"_a = "values", py::kw_only(), "level_set"_a = false, "background"_a = py::none(),
      "fill"_a = false, "smooth"_a = 0,
      "An array of (nx, ny, nz) or, of vectors, (nx, ny, nz, 3) as a volume: array[i, j, k] stands "
      "at origin + spacing (i, j, k). Spacing: one number, three, or a 3 x 3 matrix whose columns "
      "are the steps. Values equal to the background are no data; by default it is the median of "
      "the faces, of vectors zero. level_set: signed distances, negative within. "
      "Where the values end at other than the background, a quadratic or cubic field is off "
      "within eight voxels of that edge: give more of the array, or trilinear.");
}

void bindHand(py::module_& m) {
  py::class_<Hand>(m, "Hand", "A hand in a scene, from Scene.hand(rate).")
      .def("step", &Hand::step, "x"_a, "y"_a, "z"_a, "play"_a = py::none(),
           "One tick with the probe at x, y, z [m]: the force (fx, fy, fz) [N]. Sequences are "
           "played to `play` [s]; without it as the scene says, a tick's time on.")
      .def("clear", &Hand::clear, "Lets force out again after a fault.")
      .def_property_readonly("proxy", &Hand::proxy, "The proxy after the last tick [m].")
      .def_property_readonly("fault", &Hand::fault, "Why the force is cut; empty: it is not.")
      .def_property_readonly("report", &Hand::report, "What the last tick did.");
}

void bindScene(py::module_& m) {
  py::class_<PyScene>(m, "Scene", "Volumes and what is felt of them.")
      .def_static("load", &PyScene::load, "path"_a,
                  "A scene file, a .vdb, or a folder of .vdb or bricks.")
      .def_static("parse", &PyScene::parse, "scene"_a,
                  "volumes"_a = std::map<std::string, std::shared_ptr<Volume>>{}, "folder"_a = ".",
                  "A scene from a dict or JSON as docs/scene.md has it. `volumes`: of the "
                  "script's own, by the scene's names, in place of files. `folder`: where the "
                  "paths of the others start.")
      .def("run", &PyScene::run, "path"_a, "rate"_a = 1000.0,
           "Feels along a path, as `palpate feel --device path:`: an array with the columns of its "
           "trace, a row a tick. path: (n, 3) positions, a tick each, or (n, 4) rows of t, x, y, "
           "z, linear between. Other threads of Python run meanwhile.")
      .def("hand", &PyScene::hand, "rate"_a = 1000.0, "Another hand, `rate` ticks a second.")
      .def("step", &PyScene::step, "x"_a, "y"_a, "z"_a, "play"_a = py::none(),
           "One tick at 1 kHz of the scene's own hand, as Hand.step: the force (fx, fy, fz) [N].")
      .def("explain", &PyScene::explain, "at"_a, "push"_a, "rate"_a = 1000.0,
           "Why one tick's force is what it is: a dict as `palpate explain --json` prints it. The "
           "hand rests at `at` [m] first, then moves by `push` [m] within the tick.")
      .def_property_readonly("source", &PyScene::source)
      .def_property_readonly("bounds", [](const PyScene& s) { return tupleOf(s.bounds()); })
      .def_property_readonly("notes", &PyScene::notes, "What palpate would tell its user.")
      .def_property_readonly("fields", &PyScene::fields, "By name, placed in W.")
      .def_property_readonly("volumes", [](const PyScene& s) {
        std::map<std::string, std::shared_ptr<Volume>> volumes;
        for (const auto& [name, v] : s.volumes()) {
          volumes[name] = std::const_pointer_cast<Volume>(v);
        }
        return volumes;
      });
}

void bindBalance(py::module_& m) {
  py::class_<Primitive>(m, "Primitive", "A haptic primitive of the paper, section 4.1.")
      .def(py::init(&primitiveOf), "kind"_a, "position"_a = std::array<double, 3>{0.0, 0.0, 0.0},
           "direction"_a = std::array<double, 3>{1.0, 0.0, 0.0}, "strength"_a = 1.0,
           "kind: force, point, line or plane; position [m]; strength [N].")
      .def_property_readonly("kind", [](const Primitive& p) { return wordFor(p.kind); })
      .def_property_readonly("position", [](const Primitive& p) { return tupleOf(p.position); })
      .def_property_readonly("direction", [](const Primitive& p) { return tupleOf(p.direction); })
      .def_readonly("strength", &Primitive::strength);

  m.def("solve", &solve, "stiffness"_a, "probe"_a, "primitives"_a, "start"_a = py::none(),
        "Where the primitives balance a spring of this stiffness [N/m] to the probe [m]: a dict of "
        "proxy, force on the hand, error_bound, iterations, solver and status.");
}

}  // namespace
}  // namespace palpate::python

PYBIND11_MODULE(palpate, m) {
  using namespace palpate;
  using namespace palpate::python;

  m.doc() = "palpate: feel a volume. Metres, newtons and seconds, in the right-handed world W.";
  m.attr("__version__") = kVersion;
  m.attr("__commit__") = commit();
  bindErrors(m);
  registerEnd();
  bindField(m);
  bindVolume(m);
  bindArrayVolume(m);
  bindHand(m);
  bindScene(m);
  bindBalance(m);
}
