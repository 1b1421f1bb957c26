/// The Python module `palpate` (docs/python.md). `run` and `sample` release Python's lock, and take
/// it only to check for signals. `step` computes one tick.
#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

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
  if (!v.allFinite())
    throw Error(what, "one of its numbers is not finite", "give finite numbers (x, y, z)");
  return v;
}

}  // namespace palpate::python

PYBIND11_MODULE(palpate, m) {
  using namespace palpate;
  using namespace palpate::python;

  m.doc() =
      "Haptic rendering of volumes. Units are metres, newtons and seconds, in the right-handed "
      "world W.";
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
