/// Private to engine: what the names of a graph's spec are. Include it in .cpp files only.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "palpate/engine/graph.h"

namespace palpate {

/// The volumes of a scene and what is derived from them, by name; refuses what does not fit. Paths
/// are those of the scene file, for errors (SceneError).
class GraphNames {
 public:
  GraphNames(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields)
      : spec_(spec), fields_(fields) {}

  /// Throws where a derived field is none: its name is a volume's, its operand unfit, or itself.
  void checkDerived() const;
  /// True if `name` is, or derives to, a vector. Throws for unknown names and circles.
  [[nodiscard]] bool isVector(const std::string& path, const std::string& name) const;
  /// Throws where a name is unknown or no scalar.
  void checkScalar(const std::string& path, const std::string& name) const;
  /// "There is no volume or field of that name", and which is near.
  [[noreturn]] void throwUnknown(const std::string& path, const std::string& name) const;

  /// The volume of that name; null where there is none.
  [[nodiscard]] const FieldPtr* volume(const std::string& name) const;
  /// Throws where it is neither that nor a volume.
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
