#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/grid/array_volume.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/bindings/python/field.h"
#include "palpate/scenes/bindings/python/python_module.h"
#include "palpate/scenes/bindings/python/unlocked.h"
#include "palpate/scenes/library/new_file.h"
#include "palpate/scenes/library/save_volume.h"
#include "palpate/scenes/library/smooth_text.h"

namespace palpate::python {

using namespace pybind11::literals;

namespace {

/// A width in voxels, or a text with a unit such as "1.5 file".
using Width = std::variant<double, std::string>;

SmoothWidth widthOf(const Width& smooth) {
  if (const double* voxels = std::get_if<double>(&smooth)) {
    if (!(*voxels >= 0.0 && *voxels <= kMostSmooth)) {
      throw Error("smooth", fmt::format("it is {:g} voxels", *voxels),
                  fmt::format("give 0 to {:g} voxels", kMostSmooth));
    }
    return {*voxels, false};
  }
  const auto& text = std::get<std::string>(smooth);
  const std::optional<SmoothText> read = readSmoothText(text);
  if (!read || read->metres > 0.0) {
    throw Error("smooth", "\"" + text + "\" is not a width in the volume's own unit",
                "give voxels, such as 1.5, or a length in the volume's own unit, such as \"1.5 "
                "file\"");
  }
  return {read->size, true};
}

LoadOptions optionsOf(bool fill, const Width& smooth) {
  LoadOptions options;
  options.non_finite = fill ? NonFinite::kFill : NonFinite::kRefuse;
  options.smooth = widthOf(smooth);
  return options;
}

/// Warns if integers were rounded, as `palpate import` does.
void warnOfRounding(const py::array& values, const std::string& name) {
  const char kind = values.dtype().kind();
  if ((kind != 'i' && kind != 'u') || values.itemsize() < 8 || values.size() == 0) return;
  const py::int_ exact(std::int64_t{1} << 53U);
  const bool held =
      values.attr("max")().attr("item")() <= exact && values.attr("min")().attr("item")() >= -exact;
  if (held) return;
  const std::string warning =
      name + ": integers with a magnitude above 9,007,199,254,740,992 are rounded";
  if (PyErr_WarnEx(PyExc_UserWarning, warning.c_str(), 1) != 0) throw py::error_already_set();
}

/// Warns if the default background is above all other values, as for a mask that touches most
/// faces.
void warnOfBackground(const GridInfo& info) {
  if (!(info.background > info.highest)) return;
  const std::string warning =
      info.name +
      ": its highest value is the median of its faces, so it is the background and has "
      "no data: give background=, such as 0, if it is matter";
  if (PyErr_WarnEx(PyExc_UserWarning, warning.c_str(), 1) != 0) throw py::error_already_set();
}

/// Returns arrays of native floats and doubles unchanged. Converts other arrays to floats if this
/// is exact, otherwise to doubles, which may round.
py::array numbersOf(const py::object& given, const std::string& name) {
  if (py::isinstance(given, py::module_::import("numpy").attr("ma").attr("MaskedArray"))) {
    throw VolumeError(name, "it is a masked array", "give array.filled(background)");
  }
  py::array values = py::array::ensure(given);
  if (!values) {
    throw VolumeError(name, "it cannot be read as an array",
                      "give a numpy array, or nested lists of equal lengths");
  }
  const char kind = values.dtype().kind();
  const py::ssize_t size = values.itemsize();
  const bool is_float = kind == 'f' && (size == 4 || size == 8);
  if (is_float && values.dtype().attr("isnative").cast<bool>()) return values;
  if (kind != 'f' && kind != 'i' && kind != 'u' && kind != 'b') {
    throw VolumeError(name, "its values are not real numbers",
                      "give an array of floats or integers");
  }
  warnOfRounding(values, name);
  const bool small = kind == 'f' ? size <= 4 : size <= 2;
  return values.attr("astype")(small ? "float32" : "float64").cast<py::array>();
}

std::shared_ptr<const Volume> volumeOf(const py::object& given, const py::object& spacing,
                                       const Doubles& origin, const std::string& name,
                                       bool level_set, std::optional<double> background, bool fill,
                                       const Width& smooth) {
  const py::array values = numbersOf(given, name);
  const bool vector = values.ndim() == 4 && values.shape(3) == 3;
  if (values.ndim() != 3 && !vector) {
    throw VolumeError(name, "its shape is neither (nx, ny, nz) nor (nx, ny, nz, 3)",
                      "order the axes x, y, z, then the components of vectors");
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
    throw VolumeError(name, "its spacing is not one number, three numbers or a 3 x 3 matrix",
                      "give the steps along x, y and z, or a matrix with the steps as columns");
  }
  array.origin = vectorOf(origin, "origin");
  array.name = name;
  array.level_set = level_set;
  array.background = background;
  auto volume = aside(
      [array, options = optionsOf(fill, smooth)] { return makeVolume(array, options); }, values);
  if (!vector && !level_set && !background && !fill) warnOfBackground(volume->info());
  return volume;
}

std::shared_ptr<const Volume> loadFrom(const std::filesystem::path& file, const std::string& grid,
                                       const LoadOptions& options) {
  if (!isBricks(file)) return loadVolume(file, grid, options);
  if (grid.empty() && options.non_finite == NonFinite::kRefuse && options.smooth.sigma == 0.0) {
    return loadBricks(file);
  }
  throw Error(file.string(), "it is a folder of bricks, which is loaded unchanged",
              "omit grid, fill and smooth, or load a .vdb file");
}

/// Writes the volume as a .vdb, or as bricks if the path does not end in .vdb.
void save(const std::shared_ptr<Volume>& volume, const std::filesystem::path& path, bool half) {
  aside([volume, path, half] {
    if (path.extension() != ".vdb") {
      (void)writeBricks(path, brickInput(volume, half));
      return;
    }
    cli::WholeFile file(path);
    saveVolume(nameOfOpen(file.descriptor(), file.place()), *volume, half);
    file.commit();
  });
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
  py::dict labels;
  for (const Label& label : info.labels) {
    labels[py::int_(static_cast<long>(label.value))] = label.name;
  }
  dict["labels"] = labels;
  return dict;
}

}  // namespace

void bindVolume(py::module_& m) {
  py::class_<Volume, std::shared_ptr<Volume>>(m, "Volume", "One grid in memory. It never changes.")
      .def_static(
          "load",
          [](const std::filesystem::path& file, const std::string& grid, bool fill,
             const Width& smooth) {
            return std::const_pointer_cast<Volume>(
                aside([file, grid, options = optionsOf(fill, smooth)] {
                  return loadFrom(file, grid, options);
                }));
          },
          "file"_a, "grid"_a = "", "fill"_a = false, "smooth"_a = Width(0.0),
          "Reads a grid of a .vdb file. If the file has one grid, its name may be left out. With "
          "`fill`, values that are NaN, infinite or above 1e100 become the background. `smooth` is "
          "the standard deviation of a Gaussian: 0 to 32 voxels, or a text such as \"1.5 file\" in "
          "the file's unit. Without these options, also reads a folder of bricks, all of it into "
          "memory.")
      .def("save", &save, "path"_a, "half"_a = false,
           "Writes the volume: as a .vdb file if `path` ends in .vdb, and replaces an existing "
           "file; else as a folder of bricks, as `palpate brick` does. With `half`, rounds values "
           "to 16 bits. Bricks hold at most 32 bits.")
      .def(
          "field",
          [](const std::shared_ptr<Volume>& volume, const std::string& interpolation, bool axial) {
            return fieldOf(volume, interpolation, axial);
          },
          "interpolation"_a = "trilinear", "axial"_a = false,
          "Returns the volume's field in the volume's own space: trilinear, nearest, quadratic or "
          "cubic. A quadratic or cubic field is wrong within eight voxels of the edge of the "
          "values, such as the end of an array.")
      .def_property_readonly("name", [](const Volume& v) { return v.info().name; })
      .def_property_readonly("info", &infoOf, "The data that `palpate info` prints, as a dict.");
}

void bindArrayVolume(py::module_& m) {
  m.def(
      "volume",
      [](const py::object& values, const py::object& spacing, const Doubles& origin,
         const std::string& name, bool level_set, std::optional<double> background, bool fill,
         const Width& smooth) {
        return std::const_pointer_cast<Volume>(
            volumeOf(values, spacing, origin, name, level_set, background, fill, smooth));
      },
      "array"_a, "spacing"_a = 1.0, "origin"_a = std::array<double, 3>{0.0, 0.0, 0.0},
      "name"_a = "values", py::kw_only(), "level_set"_a = false, "background"_a = py::none(),
      "fill"_a = false, "smooth"_a = Width(0.0),
      "Makes a volume from an array of shape (nx, ny, nz), or (nx, ny, nz, 3) for vectors. "
      "array[i, j, k] is the value at origin + spacing (i, j, k). `spacing` is one number, three "
      "numbers, or a 3 x 3 matrix with the steps as columns. Values equal to `background` count as "
      "no data; the default is the median of the faces, or zero for vectors. `level_set` marks "
      "signed distances, negative inside. `smooth` is that of Volume.load. If the values at an "
      "edge differ from the background, a "
      "quadratic or cubic field is wrong within eight voxels of that edge: add a margin, or use "
      "trilinear.");
}

}  // namespace palpate::python
