#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

struct NamedField {
  FieldPtr field;
  std::string name;

  [[nodiscard]] const FieldFrame& frame() const;
  /// Returns a row for each point, as Field.sample does, without Python's lock.
  [[nodiscard]] py::array sample(const Doubles& points) const;
};

/// Returns a volume's field in the file's own space. Throws Error for an unknown interpolation.
[[nodiscard]] NamedField fieldOf(const std::shared_ptr<const Volume>& volume,
                                 const std::string& interpolation, bool axial);

}  // namespace palpate::python
