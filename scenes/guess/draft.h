/// Private to the scene guess: the scene that is being put together.
#pragma once

#include <cstddef>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "palpate/scenes/guess/candidate.h"
#include "palpate/scenes/guess/scene_json.h"

namespace palpate::guess {

/// Volumes, fields and modes of a scene, and the omissions.
class Draft {
 public:
  explicit Draft(GuessNames names) : names_(std::move(names)), first_(names_.like) {}

  /// Returns a name for a volume or a field that no other volume or field has.
  std::string uniqueName(const std::string& name);

  /// Adds a candidate's volume once. The draft keeps the address until write().
  void addVolume(const Candidate& candidate);
  /// Adds a derived field under a unique name, and returns that name.
  std::string addField(const std::string& name, const Json& field);
  /// Adds a mode under a unique name.
  void addMode(Json mode);
  /// Adds a mode for a level set.
  void addLevelSet(Json mode);

  /// Returns the number of free modes.
  [[nodiscard]] std::size_t freeModes() const;
  [[nodiscard]] std::size_t levelSets() const { return level_sets_; }
  [[nodiscard]] bool hasModes() const { return !modes_.empty(); }

  /// Records an omission. An empty `why` means that other grids have priority.
  void leaveOut(const Candidate& candidate, const std::string& why = "");
  void leaveOut(const std::string& name, const std::string& why, const std::string& remedy);
  /// Removes the omission of a candidate that gets a mode after all.
  void takeBack(const Candidate& candidate);

  /// Marks a candidate that is in the scene, or left out, so that no later rule adds it.
  void use(const Candidate& candidate) { used_.insert(&candidate); }
  [[nodiscard]] bool isUsed(const Candidate& candidate) const {
    return used_.count(&candidate) != 0;
  }
  [[nodiscard]] bool isFree(const Candidate& candidate, Kind kind) const {
    return candidate.kind == kind && !isUsed(candidate);
  }

  /// Returns the scene with its reasons. Throws VolumeError if there are no modes.
  [[nodiscard]] Guess write() const;

 private:
  /// A grid or a part of one that is not in the scene.
  struct Omission {
    std::string name;
    std::string why;
    std::string remedy;
  };

  [[nodiscard]] std::string omissions(const char* before, const char* after) const;
  [[nodiscard]] std::string firstRemedy(const std::string& otherwise) const;

  GuessNames names_;
  std::string first_;  ///< The volume that the others are placed like; empty: none yet.
  std::set<std::string> volume_names_;  ///< and names of fields
  std::set<std::string> mode_names_;
  std::set<const Candidate*> used_;
  std::vector<const Candidate*> shown_;  ///< Candidates with a volume in the scene.
  std::vector<Omission> omissions_;
  Json volumes_ = Json::object();
  Json fields_ = Json::object();
  std::vector<Json> modes_;
  std::size_t level_sets_ = 0;
};

}  // namespace palpate::guess
