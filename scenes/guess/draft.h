/// Private to the scene guess: an incomplete scene.
#pragma once

#include <cstddef>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "palpate/scenes/guess/candidate.h"
#include "palpate/scenes/guess/scene_json.h"

namespace palpate::guess {

/// An incomplete scene, and notes about grids that are left out.
class Draft {
 public:
  explicit Draft(GuessNames names) : names_(std::move(names)), first_(names_.like) {}

  /// Returns an unused name for a volume or field: the common prefix and `name`, with a number if
  /// necessary.
  std::string uniqueName(const std::string& name);

  /// Adds a candidate's volume, unless it was added before. The candidate must keep its address
  /// until write().
  void addVolume(const Candidate& candidate);
  /// Adds a derived field under a unique name, and returns this name.
  std::string addField(const std::string& name, const Json& field);
  /// Adds a mode under a unique name.
  void addMode(Json mode);
  void addLevelSet(Json mode);

  [[nodiscard]] std::size_t freeModes() const;
  [[nodiscard]] std::size_t levelSets() const { return level_sets_; }
  [[nodiscard]] bool hasModes() const { return !modes_.empty(); }

  /// Adds a note that a candidate is left out, and marks the candidate as used. If `why` is empty,
  /// the reason is that other grids have priority.
  void leaveOut(const Candidate& candidate, const std::string& why = "");
  void leaveOut(const std::string& name, const std::string& why, const std::string& remedy);
  /// Removes the note about a candidate that is used after all.
  void takeBack(const Candidate& candidate);

  /// Marks a candidate as used: later rules ignore it, whether it is in the scene or left out.
  void use(const Candidate& candidate) { used_.insert(&candidate); }
  [[nodiscard]] bool isUsed(const Candidate& candidate) const {
    return used_.count(&candidate) != 0;
  }
  [[nodiscard]] bool isFree(const Candidate& candidate, Kind kind) const {
    return candidate.kind == kind && !isUsed(candidate);
  }

  /// Returns the scene and the reasons for it. Throws VolumeError for a draft without modes.
  [[nodiscard]] Guess write() const;

 private:
  struct Omission {
    std::string name;
    std::string why;
    std::string remedy;
  };

  [[nodiscard]] std::string omissions(const char* before, const char* after) const;
  [[nodiscard]] std::string firstRemedy(const std::string& otherwise) const;

  GuessNames names_;
  /// Name of the first volume, whose place all other volumes get; may be empty.
  std::string first_;
  std::set<std::string> volume_names_;
  std::set<std::string> mode_names_;
  std::set<const Candidate*> used_;
  std::vector<const Candidate*> shown_;
  std::vector<Omission> omissions_;
  Json volumes_ = Json::object();
  Json fields_ = Json::object();
  std::vector<Json> modes_;
  std::size_t level_sets_ = 0;
};

}  // namespace palpate::guess
