/// Private to engine: what the names in a graph's spec stand for. Include it in .cpp files only.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/graph.h"

namespace palpate {

/// The volumes of a scene and the fields derived from them, by name; refuses what does not fit.
/// Paths are those of the scene file, for errors (SceneError).
class GraphNames {
 public:
  /// Checks nothing yet. `spec` and `fields` must outlive it.
  GraphNames(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields)
      : spec_(spec), fields_(fields) {}

  /// Throws where a derived field has a volume's name, an unfit operand, or itself as operand.
  void checkDerived() const;
  /// True if `name` is, or derives to, a vector. Throws for unknown names and circles.
  [[nodiscard]] bool isVector(const std::string& path, const std::string& name) const;
  /// Throws where a name is unknown or is not that of a scalar.
  void checkScalar(const std::string& path, const std::string& name) const;
  /// Throws that there is no volume or field of that name, with the name that is nearest.
  [[noreturn]] void throwUnknown(const std::string& path, const std::string& name) const;

  /// The volume of that name; null where there is none.
  [[nodiscard]] const FieldPtr* volume(const std::string& name) const;
  /// The derived field of that name. Throws where there is none.
  [[nodiscard]] const DerivedSpec& derived(const std::string& path, const std::string& name) const;

 private:
  bool isVector(const std::string& path, const std::string& name,
                std::set<std::string>& open) const;
  /// Checks one derived field's operand; true if the result is a vector.
  bool checkDerived(const std::string& name, const DerivedSpec& derived,
                    std::set<std::string>& open) const;

  const GraphSpec& spec_;
  const std::map<std::string, FieldPtr>& fields_;
};

}  // namespace palpate
