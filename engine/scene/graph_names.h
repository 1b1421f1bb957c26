/// Private to engine: resolves the names in a graph's spec. Include it in .cpp files only.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/scene/graph.h"

namespace palpate {

/// The volumes of a scene and the derived fields, by name. The functions reject wrong specs by
/// SceneError. A `path` is that of the name in the scene file, for messages.
class GraphNames {
 public:
  /// Stores references without a check. `spec` and `fields` must outlive the object.
  GraphNames(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields)
      : spec_(spec), fields_(fields) {}

  /// Throws if a derived field has a volume's name, an unknown or unsuitable operand, or is derived
  /// from itself.
  void checkDerived() const;
  /// Returns true if `name` is or derives a vector. Throws for unknown names, unsuitable operands
  /// and cycles.
  [[nodiscard]] bool isVector(const std::string& path, const std::string& name) const;
  /// Throws if `name` is unknown or not a scalar.
  void checkScalar(const std::string& path, const std::string& name) const;
  /// Throws an error for an unknown name. The remedy is the nearest known name, or all known names.
  [[noreturn]] void throwUnknown(const std::string& path, const std::string& name) const;

  /// Returns the volume called `name`; null if it does not exist.
  [[nodiscard]] const FieldPtr* volume(const std::string& name) const;
  /// Returns the derived field called `name`. Throws if it does not exist.
  [[nodiscard]] const DerivedSpec& derived(const std::string& path, const std::string& name) const;

 private:
  bool isVector(const std::string& path, const std::string& name,
                std::set<std::string>& open) const;
  /// Checks one derived field's operand. Returns true if the result is a vector.
  bool checkDerived(const std::string& name, const DerivedSpec& derived,
                    std::set<std::string>& open) const;

  const GraphSpec& spec_;
  const std::map<std::string, FieldPtr>& fields_;
};

}  // namespace palpate
