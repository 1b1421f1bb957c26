/// The Python class for fields.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

/// A field, and its name for error messages.
struct NamedField {
  FieldPtr field;
  std::string name;

  [[nodiscard]] const FieldFrame& frame() const;
  /// Returns a row for each point, as Field.sample does. Releases Python's lock meanwhile.
  [[nodiscard]] py::array sample(const Doubles& points) const;
};

/// Returns the field of a volume in the file's own space. Throws Error for an unknown
/// interpolation.
[[nodiscard]] NamedField fieldOf(const std::shared_ptr<const Volume>& volume,
                                 const std::string& interpolation, bool axial);

}  // namespace palpate::python
