/// Types and functions that all source files of the Python module use.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "palpate/engine/types.h"

namespace palpate::python {

namespace py = pybind11;

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;

[[nodiscard]] py::tuple tupleOf(const Vec3& v);
/// Returns a pair: the lower and the upper corner.
[[nodiscard]] py::tuple tupleOf(const Box& box);
/// Returns three finite numbers as a vector. Throws Error, which names the argument `what`.
[[nodiscard]] Vec3 vectorOf(const Doubles& values, const char* what);

// Each function registers a part of the module. Later parts use the types of earlier parts.
void bindErrors(py::module_& m);
/// Registers functions that wait for this module's threads when Python ends.
void registerEnd();
void bindField(py::module_& m);
void bindVolume(py::module_& m);
void bindArrayVolume(py::module_& m);
void bindHand(py::module_& m);
void bindScene(py::module_& m);
void bindBalance(py::module_& m);

}  // namespace palpate::python
