#include "palpate/scenes/library/compute_fields.h"

#include <map>
#include <memory>
#include <string>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

class FieldComputer {
 public:
  FieldComputer(const SceneSpec& spec, BuiltScene& built, SceneCache& cache)
      : spec_(spec), built_(built), cache_(cache) {}

  GraphSpec compute() {
    GraphSpec graph = spec_.graph;
    for (const auto& [name, why] : wanted()) {
      const Made* made = make(name);
      if (made == nullptr) continue;
      Sampling sampling = samplingOf(spec_, made->from);
      sampling.axial = made->axial;
      const DerivedSpec& derived = spec_.graph.fields.at(name);
      built_.computed[name] = {std::string(wordFor(derived.derivation)) + " of " + derived.of,
                               made->from, why};
      built_.volumes[name] = made->volume;
      built_.placements[name] = built_.placements.at(made->from);
      built_.samplings[name] = sampling;
      built_.fields[name] = cache_.field(made->volume, built_.placements.at(name), sampling);
      graph.fields.erase(name);
    }
    return graph;
  }

 private:
  /// Limits the memory: a computed scalar may need as much memory as its volume, and a gradient
  /// three times as much.
  static constexpr int kMostComputed = 64;
  struct Made {
    std::shared_ptr<const Volume> volume;
    std::string from;
    bool axial = false;
  };

  [[nodiscard]] std::map<std::string, std::string> wanted() const {
    const auto& fields = spec_.graph.fields;
    std::map<std::string, std::string> names;
    for (std::size_t i = 0; i < spec_.graph.modes.size(); ++i) {
      const ModeSpec& mode = spec_.graph.modes[i];
      const auto field = fields.find(mode.of);
      if (field == fields.end() || kindOf(field->second.derivation).vector) continue;
      if (mode.kind != ModeKind::kSurface && mode.kind != ModeKind::kIsosurface &&
          mode.kind != ModeKind::kForce) {
        continue;
      }
      names.emplace(mode.of, mode.name.empty()
                                 ? fmt::format("mode /modes/{} needs its gradient", i)
                                 : fmt::format("mode \"{}\" needs its gradient", mode.name));
    }
    for (const auto& [name, field] : fields) {
      if (kindOf(field.derivation).of_volume && fields.count(field.of) != 0) {
        names.emplace(field.of, fmt::format("field \"{}\" needs its derivatives", name));
      }
    }
    // compileGraph rejects a field that has the name of a volume.
    for (const auto& [name, volume] : spec_.volumes) names.erase(name);
    return names;
  }

  /// Returns null if the name is unknown, if the fields form a circle, or if the derivation does
  /// not apply to the volume.
  const Made* make(const std::string& name) {
    const auto known = made_.find(name);
    if (known != made_.end()) return known->second.volume != nullptr ? &known->second : nullptr;
    // Stays null until the volume is computed, which ends the recursion for a circle of fields.
    Made& made = made_[name];
    const auto volume = built_.volumes.find(name);
    if (volume != built_.volumes.end()) {
      made = {volume->second, name, spec_.volumes.at(name).sampling.axial};
      return &made;
    }
    const auto field = spec_.graph.fields.find(name);
    if (field == spec_.graph.fields.end()) return nullptr;
    const Derivation what = field->second.derivation;
    const Made* of = make(field->second.of);
    if (of == nullptr || of->volume->info().vector != kindOf(what).of_vector) return nullptr;
    const std::string path = pathIn(spec_, "/fields/" + name);
    if (built_.sequences.count(of->from) != 0) {
      throw SceneError(
          path, "the field has to be computed at load, which is not possible for a sequence",
          "compute the field for each frame beforehand, or remove the modes and fields "
          "that need its derivatives");
    }
    if (built_.windows.count(of->from) != 0) {
      throw SceneError(
          path,
          "the field has to be computed at load, which is not possible for a volume in bricks",
          "compute the field before you write the bricks, or remove the modes and fields that "
          "need its derivatives");
    }
    if (of->axial && kindOf(what).of_volume) {
      throw SceneError(
          path, "the field has to be computed at load, but axial vectors have no derivatives",
          "remove the modes and fields that need its derivatives, or remove \"axial\" if the signs "
          "of the vectors matter");
    }
    // A scene from another site may contain thousands of fields.
    if (++computed_ > kMostComputed) {
      throw SceneError(
          path, fmt::format("more than {} fields have to be computed at load", kMostComputed),
          "remove fields that are derived from derived fields, or modes that need the gradient of "
          "a derived field");
    }
    try {
      made = {cache_.derive(of->volume, what), of->from, of->axial && what == Derivation::kUnit};
    } catch (const VolumeError& e) {
      throw SceneError::within(path, e);
    }
    return &made;
  }

  const SceneSpec& spec_;
  BuiltScene& built_;
  SceneCache& cache_;
  int computed_ = 0;
  std::map<std::string, Made> made_;
};

}  // namespace

GraphSpec computeFields(const SceneSpec& spec, BuiltScene& built, SceneCache& cache) {
  return FieldComputer(spec, built, cache).compute();
}

}  // namespace palpate
