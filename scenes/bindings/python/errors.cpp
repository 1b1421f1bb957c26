#include <exception>
#include <new>
#include <pybind11/eval.h>
#include <string>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/say.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {
namespace {

// The exceptions are Python classes, so that a script can raise and pickle them.
constexpr char kErrors[] = R"py(
class Error(Exception):
    """Holds what failed, why, and the remedy; str() returns one line."""
    def __init__(self, what, why, remedy):
        super().__init__(what, why, remedy)
        self.what, self.why, self.remedy = what, why, remedy
    def __str__(self):
        return f"{self.what}: {self.why}: {self.remedy}"

class VolumeError(Error):
    """A file, grid or array cannot be used as a volume."""

class SceneError(Error):
    """A scene is not valid; `what` names the place in it, such as /modes/0/of."""

class DeviceError(Error):
    """A path or a time of play cannot be used for a hand."""

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
    raise("Error", {"memory", "the call needs more memory than is available",
                    "split the work into smaller calls, or use smaller volumes"});
  }
}

}  // namespace

void bindErrors(py::module_& m) {
  py::exec(kErrors, m.attr("__dict__"));
  if (py::hasattr(m, "each")) py::delattr(m, "each");
  py::register_exception_translator(translate);
}

}  // namespace palpate::python
