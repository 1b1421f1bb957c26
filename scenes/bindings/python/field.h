/// A field for scripts.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

/// A field, with a name for messages.
struct NamedField {
  FieldPtr field;
  std::string name;

  [[nodiscard]] const FieldFrame& frame() const;
  /// Returns one row a point: Field.sample. Releases Python's lock.
  [[nodiscard]] py::array sample(const Doubles& points) const;
};

/// Returns the field of a volume in the volume's own space. Throws Error for an unknown
/// interpolation.
[[nodiscard]] NamedField fieldOf(const std::shared_ptr<const Volume>& volume,
                                 const std::string& interpolation, bool axial);

}  // namespace palpate::python
