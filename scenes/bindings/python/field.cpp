#include "palpate/scenes/bindings/python/field.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <variant>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/scenes/bindings/python/unlocked.h"

namespace palpate::python {

using namespace pybind11::literals;

namespace {

/// A row in the result of Field.sample.
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
    throw Error("points", "their last axis does not have three numbers",
                "give an array of shape (n, 3)");
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

/// Samples the field on a lattice for VTK. The default spacing is the edge of a voxel, but at least
/// 1/256 of the longest side.
py::object toVtk(const NamedField& field, std::optional<double> spacing) {
  const FieldFrame& frame = field.frame();
  const Vec3 size = frame.bounds.size();
  const double step = spacing.value_or(std::max(frame.voxel, size.maxCoeff() / 256.0));
  constexpr double kMost = 1e9;
  const Vec3 counts = (size / step).array().floor() + 1.0;
  if (!(step > 0.0) || !(counts.prod() <= kMost)) {
    throw Error("spacing", "it is not above 0, or leads to more than 10^9 points",
                "give a greater distance between points, in metres or the volume's own unit");
  }
  const auto nx = static_cast<py::ssize_t>(counts.x());
  const auto ny = static_cast<py::ssize_t>(counts.y());
  const auto nz = static_cast<py::ssize_t>(counts.z());
  // x is the fastest axis, as in VTK.
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
    const auto why = py::str(e.value()).cast<std::string>();
    throw Error("to_vtk", "VTK's Python modules cannot be imported (" + why + ")",
                "install python3-vtk9");
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

}  // namespace

const FieldFrame& NamedField::frame() const {
  return std::visit([](const auto& f) -> const FieldFrame& { return f->frame(); }, field);
}

py::array NamedField::sample(const Doubles& points) const {
  if (const auto* scalar = std::get_if<0>(&field)) return sampled<ScalarRow>(**scalar, points);
  return sampled<VectorRow>(*std::get<1>(field), points);
}

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

void bindField(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(ScalarRow, inside, value, gradient);
  PYBIND11_NUMPY_DTYPE(VectorRow, inside, value, jacobian);

  py::class_<NamedField>(
      m, "Field",
      "A scalar or vector field. A field of a scene is in world space W, in metres. A field of a "
      "volume alone is in the volume's own space. Derivatives are per unit of the volume's own "
      "space.")
      .def("sample", &NamedField::sample, "points"_a,
           "Returns a structured array with one row per point. A scalar has inside, value and "
           "gradient; a vector has inside, value and jacobian[i][j] = d v_i / d x_j. The last "
           "axis of `points` has three numbers, as in the shapes (n, 3) and (3,).")
      .def("to_vtk", &toVtk, "spacing"_a = py::none(),
           "Returns a vtkImageData with samples of the field over its bounds, `spacing` apart. The "
           "default is a voxel's edge, or more for at most 257 points per side. pyvista.wrap() "
           "accepts the result.")
      .def_readonly("name", &NamedField::name)
      .def_property_readonly("vector", [](const NamedField& f) { return f.field.index() == 1; })
      .def_property_readonly("voxel", [](const NamedField& f) { return f.frame().voxel; })
      .def_property_readonly("bounds",
                             [](const NamedField& f) { return tupleOf(f.frame().bounds); });
}

}  // namespace palpate::python
