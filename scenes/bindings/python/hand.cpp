#include "palpate/scenes/bindings/python/hand.h"

#include <cmath>
#include <utility>

#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/error.h"
#include "palpate/engine/safety/safety.h"

namespace palpate::python {

using namespace pybind11::literals;

namespace {

void checkTime(const char* name, double seconds) {
  constexpr double kMost = 1e9;  // [s]: limit of PathDevice
  if (std::abs(seconds) <= kMost) return;
  throw DeviceError(name, "it is not a time within 1e9 s", "give seconds from -1e9 to 1e9");
}

}  // namespace

DeviceInfo pathInfo() {
  return PathDevice({PathPoint{}}, 1000.0).info();
}

Hand::Hand(std::shared_ptr<const Scene> scene, const PlayParams& play, double rate)
    : scene_(std::move(scene)), dt_(1.0 / rate), clock_(play), state_(pathInfo().limits) {}

std::tuple<double, double, double> Hand::step(double x, double y, double z,
                                              std::optional<double> play) {
  if (play) {
    checkTime("play", *play);
    // If a script sets the time, the playback counts as continuous since the last tick.
    const double from = std::exchange(play_, *play);
    state_.playAt(play_, (play_ - from) / dt_);
  } else {
    play_ = clock_.next(head_, dt_);
    state_.playAt(play_, head_.rate);
  }
  report_ = hapticStep(*scene_, reader_, {{x, y, z}}, state_, dt_);
  return {report_.force.x(), report_.force.y(), report_.force.z()};
}

void Hand::seek(double seconds) {
  checkTime("seek", seconds);
  clock_.seek(seconds);
}

py::tuple Hand::proxy() const {
  return tupleOf(report_.proxy);
}

std::string Hand::fault() const {
  return state_.faulted() ? wordsFor(state_.fault()) : std::string();
}

py::dict Hand::report() const {
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

void bindHand(py::module_& m) {
  py::class_<Hand>(m, "Hand", "A hand in a scene, from Scene.hand(rate).")
      .def("step", &Hand::step, "x"_a, "y"_a, "z"_a, "play"_a = py::none(),
           "Runs one tick with the probe at x, y, z [m]. Returns the force (fx, fy, fz) [N]. Plays "
           "sequences to `play` [s]; without `play`, the scene's settings advance them by one "
           "tick.")
      .def("seek", &Hand::seek, "seconds"_a,
           "Moves the playback of sequences to `seconds` [s]. The next step without `play` goes on "
           "from there, within the range of the scene's `play`. The data fade in over 50 ms, as "
           "after a jump in `palpate feel`.")
      .def("clear", &Hand::clear, "Clears a fault, so that the force returns.")
      .def_property_readonly("proxy", &Hand::proxy, "The proxy after the last tick [m].")
      .def_property_readonly("fault", &Hand::fault,
                             "The reason why the force is cut; empty if it is not cut.")
      .def_property_readonly("report", &Hand::report, "A report of the last tick, as a dict.");
}

}  // namespace palpate::python
