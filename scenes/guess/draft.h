/// Private to the scene guess: a scene that is not complete yet.
#pragma once

#include <cstddef>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "palpate/scenes/guess/candidate.h"
#include "palpate/scenes/guess/scene_json.h"

namespace palpate::guess {

/// Volumes, fields and modes of a scene, and the grids that the scene omits.
class Draft {
 public:
  explicit Draft(GuessNames names) : names_(std::move(names)), first_(names_.like) {}

  /// Returns a name for a volume or field that the draft does not use yet. It is `name`, with a
  /// number if necessary.
  std::string uniqueName(const std::string& name);

  /// Adds the volume of a candidate, unless the draft has it already. The candidate must remain at
  /// its address until write().
  void addVolume(const Candidate& candidate);
  /// Adds a derived field, and returns its name, which is made unique.
  std::string addField(const std::string& name, const Json& field);
  /// Adds a mode, whose name is made unique.
  void addMode(Json mode);
  /// Adds a mode of a level set.
  void addLevelSet(Json mode);

  /// Returns how many modes can still be added.
  [[nodiscard]] std::size_t freeModes() const;
  [[nodiscard]] std::size_t levelSets() const { return level_sets_; }
  [[nodiscard]] bool hasModes() const { return !modes_.empty(); }

  /// Adds a note that a candidate is left out. An empty `why` means that other grids have priority.
  void leaveOut(const Candidate& candidate, const std::string& why = "");
  void leaveOut(const std::string& name, const std::string& why, const std::string& remedy);
  /// Removes the note about a candidate that gets a mode after all.
  void takeBack(const Candidate& candidate);

  /// Marks a candidate as used: it is in the scene or left out, and later rules ignore it.
  void use(const Candidate& candidate) { used_.insert(&candidate); }
  [[nodiscard]] bool isUsed(const Candidate& candidate) const {
    return used_.count(&candidate) != 0;
  }
  [[nodiscard]] bool isFree(const Candidate& candidate, Kind kind) const {
    return candidate.kind == kind && !isUsed(candidate);
  }

  /// Returns the scene and the reasons for it. Throws VolumeError if there are no modes.
  [[nodiscard]] Guess write() const;

 private:
  /// A grid, or a part of a grid, that the scene omits.
  struct Omission {
    std::string name;
    std::string why;
    std::string remedy;
  };

  [[nodiscard]] std::string omissions(const char* before, const char* after) const;
  [[nodiscard]] std::string firstRemedy(const std::string& otherwise) const;

  GuessNames names_;
  /// Name of the first volume, at whose place the other volumes are; empty: no volume yet.
  std::string first_;
  std::set<std::string> volume_names_;  ///< Names of volumes and of fields
  std::set<std::string> mode_names_;
  std::set<const Candidate*> used_;
  std::vector<const Candidate*> shown_;  ///< Candidates whose volumes are in the scene.
  std::vector<Omission> omissions_;
  Json volumes_ = Json::object();
  Json fields_ = Json::object();
  std::vector<Json> modes_;
  std::size_t level_sets_ = 0;
};

}  // namespace palpate::guess
