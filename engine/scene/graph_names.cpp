#include "palpate/engine/scene/graph_names.h"

#include "palpate/engine/error.h"

namespace palpate {

void GraphNames::checkDerived() const {
  for (const auto& [name, derived] : spec_.fields) {
    if (fields_.count(name) != 0) {
      throw SceneError("/fields/" + name, "a volume has the same name", "rename one of them");
    }
    std::set<std::string> open;
    (void)checkDerived(name, derived, open);
  }
}

bool GraphNames::isVector(const std::string& path, const std::string& name) const {
  std::set<std::string> open;
  return isVector(path, name, open);
}

void GraphNames::checkScalar(const std::string& path, const std::string& name) const {
  if (!isVector(path, name)) return;
  throw SceneError(path, "\"" + name + "\" is a vector", "give a scalar, such as its magnitude");
}

void GraphNames::throwUnknown(const std::string& path, const std::string& name) const {
  std::vector<std::string> names;
  for (const auto& [volume, field] : fields_) names.push_back(volume);
  for (const auto& [field, derived] : spec_.fields) names.push_back(field);
  const std::string near = nearestName(name, names);
  std::string remedy = !near.empty()   ? "did you mean \"" + near + "\"?"
                       : names.empty() ? "add a volume of this name"
                                       : "use one of:";
  if (near.empty()) {
    for (const std::string& n : names) remedy += " " + n;
  }
  throw SceneError(path, "there is no volume or field \"" + name + "\"", remedy);
}

const FieldPtr* GraphNames::volume(const std::string& name) const {
  const auto field = fields_.find(name);
  return field == fields_.end() ? nullptr : &field->second;
}

const DerivedSpec& GraphNames::derived(const std::string& path, const std::string& name) const {
  const auto derived = spec_.fields.find(name);
  if (derived == spec_.fields.end()) throwUnknown(path, name);
  return derived->second;
}

bool GraphNames::isVector(const std::string& path, const std::string& name,
                          std::set<std::string>& open) const {
  if (const FieldPtr* field = volume(name)) return field->index() == 1;
  return checkDerived(name, derived(path, name), open);
}

bool GraphNames::checkDerived(const std::string& name, const DerivedSpec& derived,
                              std::set<std::string>& open) const {
  const std::string path = "/fields/" + name;
  if (!open.insert(name).second) {
    throw SceneError(path, "the field is derived from itself", "remove the cycle");
  }
  const bool of_vector = isVector(path + "/" + wordFor(derived.derivation), derived.of, open);
  open.erase(name);
  const bool of_volume = volume(derived.of) != nullptr;
  const std::string operand = "\"" + derived.of + "\"";
  const char* word = wordFor(derived.derivation);
  const DerivationKind kind = kindOf(derived.derivation);
  if (!kind.of_volume) {
    if (!of_vector) {
      throw SceneError(path, std::string(word) + " needs a vector, but " + operand + " is a scalar",
                       kind.vector ? "give a vector" : "give a vector, or use the scalar itself");
    }
    return kind.vector;
  }
  if (!of_volume) {
    throw SceneError(path, std::string(word) + " needs a volume, but " + operand + " is derived",
                     "give a volume; a derived field has no stored derivatives");
  }
  if (of_vector != kind.of_vector) {
    throw SceneError(path,
                     std::string(word) + " needs a " + (of_vector ? "scalar" : "vector") +
                         " volume, but " + operand + " is a " + (of_vector ? "vector" : "scalar"),
                     std::string("give a ") + (kind.of_vector ? "vector" : "scalar") + " volume");
  }
  return kind.vector;
}

}  // namespace palpate
