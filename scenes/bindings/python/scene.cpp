#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "palpate/devices/json/json_node.h"
#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/loop/play_clock.h"
#include "palpate/scenes/apps/common/explain_tick.h"
#include "palpate/scenes/bindings/python/field.h"
#include "palpate/scenes/bindings/python/hand.h"
#include "palpate/scenes/bindings/python/python_module.h"
#include "palpate/scenes/bindings/python/run.h"
#include "palpate/scenes/bindings/python/unlocked.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::python {

using namespace pybind11::literals;

namespace {

using Volumes = std::map<std::string, std::shared_ptr<const Volume>>;

/// Returns a text unchanged. Converts other objects to JSON, numpy's arrays to lists.
std::string jsonOf(const py::object& given) {
  try {
    if (py::isinstance<py::str>(given)) return given.attr("encode")().cast<std::string>();
    const py::cpp_function plain([](const py::object& one) -> py::object {
      if (py::hasattr(one, "tolist")) {
        py::object list = one.attr("tolist")();
        // tolist() does not convert a long double
        if (py::type::of(list).is(py::type::of(one))) return py::float_(one);
        return list;
      }
      const auto type = py::str(py::type::of(one).attr("__name__")).cast<std::string>();
      throw py::type_error("a " + type + " is not a number, text, list or dict");
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
                     "give finite numbers, texts, lists, dicts or numpy arrays");
  }
}

/// Adds the volumes of a script to the JSON of a scene. The scene need not list these volumes.
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
  for (const auto& [name, words] : listed.items()) {
    if (!words.is_object() || words.contains("file")) continue;
    std::string given;
    for (const auto& [one, volume] : volumes) given += (given.empty() ? "" : ", ") + one;
    throw SceneError("scene: /volumes/" + name, "it has no \"file\", and volumes= does not have it",
                     "pass it in volumes= (given: " + given + "), or add \"file\"");
  }
  return scene.dump();
}

/// A valid scene, with the hand that Scene.step moves.
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
      throw DeviceError("path", "it has more than 10^8 ticks", "run it in parts");
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
    (void)rows.release();  // the capsule owns the rows now
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
  /// Returns the description for virtual time: reads may wait, because ticks have no deadline.
  [[nodiscard]] static SceneSpec waiting(SceneSpec spec) {
    spec.waits = true;
    return spec;
  }
  [[nodiscard]] static PyScene built(SceneSpec spec, const Volumes& volumes) {
    for (const auto& [name, volume] : volumes) spec.volumes.at(name).volume = volume;
    return aside([spec = std::move(spec)]() mutable { return PyScene(std::move(spec)); });
  }

  /// Returns the description with the volumes in memory, so that the volumes are not loaded again.
  [[nodiscard]] SceneSpec loaded() const {
    SceneSpec spec = spec_;
    for (auto& [name, volume] : spec.volumes) {
      // For these, built_ has only the first frame or the coarsest level.
      if (built_.sequences.count(name) != 0 || built_.windows.count(name) != 0) continue;
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

}  // namespace

void bindScene(py::module_& m) {
  py::class_<PyScene>(m, "Scene", "Volumes and the modes that make them tangible.")
      .def_static("load", &PyScene::load, "path"_a,
                  "Loads a scene file, a .vdb file, or a folder of .vdb files or bricks.")
      .def_static(
          "parse", &PyScene::parse, "scene"_a,
          "volumes"_a = std::map<std::string, std::shared_ptr<Volume>>{}, "folder"_a = ".",
          "Makes a scene from a dict or JSON text (docs/scene.md). `volumes` are the script's "
          "own volumes, by their names in the scene; they replace files. Relative paths "
          "of the other volumes start in `folder`.")
      .def(
          "run", &PyScene::run, "path"_a, "rate"_a = 1000.0,
          "Moves a hand along a path, as `palpate feel --device path:` does. Returns an array with "
          "the columns of `--trace`, except the loads of modes, one row per tick. `path` has shape "
          "(n, 3), one position per tick, or (n, 4), rows of t, x, y, z with straight lines "
          "between them. Other Python threads continue to run.")
      .def("hand", &PyScene::hand, "rate"_a = 1000.0,
           "Returns another hand with `rate` ticks a second.")
      .def("step", &PyScene::step, "x"_a, "y"_a, "z"_a, "play"_a = py::none(),
           "Runs one tick of the scene's own hand at 1 kHz, as Hand.step. Returns the force "
           "(fx, fy, fz) [N].")
      .def("explain", &PyScene::explain, "at"_a, "push"_a, "rate"_a = 1000.0,
           "Explains the force of one tick. Returns a dict, as `palpate explain --json` prints it. "
           "The hand first rests at `at` [m], then moves by `push` [m] within the tick.")
      .def_property_readonly("source", &PyScene::source)
      .def_property_readonly("bounds", [](const PyScene& s) { return tupleOf(s.bounds()); })
      .def_property_readonly("notes", &PyScene::notes,
                             "The notes that palpate prints for this scene.")
      .def_property_readonly("fields", &PyScene::fields, "The fields by name, in world space W.")
      .def_property_readonly("volumes", [](const PyScene& s) {
        std::map<std::string, std::shared_ptr<Volume>> volumes;
        for (const auto& [name, v] : s.volumes()) {
          volumes[name] = std::const_pointer_cast<Volume>(v);
        }
        return volumes;
      });
}

}  // namespace palpate::python
