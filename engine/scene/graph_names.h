/// Private to engine: resolves the names in a graph's spec. Include it in .cpp files only.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/scene/graph.h"

namespace palpate {

/// The volumes of a scene and the fields derived from them, by name; rejects specs with errors.
/// Paths are those of the scene file, for errors (SceneError).
class GraphNames {
 public:
  /// Does not check yet. `spec` and `fields` must outlive it.
  GraphNames(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields)
      : spec_(spec), fields_(fields) {}

  /// Throws if a derived field has a volume's name, an unfit operand, or itself as operand.
  void checkDerived() const;
  /// Returns true if `name` is, or derives to, a vector. Throws for unknown names and circles.
  [[nodiscard]] bool isVector(const std::string& path, const std::string& name) const;
  /// Throws if a name is unknown or is not that of a scalar.
  void checkScalar(const std::string& path, const std::string& name) const;
  /// Throws that no volume or field has that name, with the nearest name.
  [[noreturn]] void throwUnknown(const std::string& path, const std::string& name) const;

  /// Returns the volume of that name; null if it does not exist.
  [[nodiscard]] const FieldPtr* volume(const std::string& name) const;
  /// Returns the derived field of that name. Throws if it does not exist.
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
