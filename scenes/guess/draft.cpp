#include "palpate/scenes/guess/draft.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::guess {
namespace {

std::string lineOf(const Json& mode) {
  std::string line = mode["name"].get<std::string>() + ": " + mode["mode"].get<std::string>() +
                     " of " + mode["of"].get<std::string>();
  if (mode.contains("value")) line += " at " + inlined(mode["value"]);
  if (mode.contains("label")) line += " at label " + inlined(mode["label"]);
  return line + ": " + mode["description"].get<std::string>();
}

/// Adds `name` to `taken`, or `name` with the lowest free number from 2. Returns the added name.
std::string takeFreeName(std::set<std::string>& taken, const std::string& name, char separator) {
  std::string tried = name;
  for (int n = 2; !taken.insert(tried).second; ++n) {
    tried = fmt::format("{}{}{}", name, separator, n);
  }
  return tried;
}

}  // namespace

std::string Draft::uniqueName(const std::string& name) {
  return takeFreeName(volume_names_, names_.prefix + name, '_');
}

void Draft::addVolume(const Candidate& candidate) {
  if (volumes_.contains(candidate.name)) return;
  Json volume{{"file", names_.file}};
  if (!candidate.grid.empty()) volume["grid"] = candidate.grid;
  volume["description"] = candidate.seen;
  if (candidate.kind == Kind::kDirections) volume["axial"] = true;
  shown_.push_back(&candidate);
  volume["place"] = first_.empty() ? Json{{"fit", 0.1}} : Json{{"like", first_}};
  if (first_.empty()) first_ = candidate.name;
  volumes_[candidate.name] = volume;
}

std::string Draft::addField(const std::string& name, const Json& field) {
  std::string unique = uniqueName(name);
  fields_[unique] = field;
  return unique;
}

void Draft::addMode(Json mode) {
  auto name = mode["name"].get<std::string>();
  if (name.find(names_.prefix) == std::string::npos) name.insert(0, names_.prefix);
  mode["name"] = takeFreeName(mode_names_, name, ' ');
  modes_.push_back(std::move(mode));
}

void Draft::addLevelSet(Json mode) {
  addMode(std::move(mode));
  ++level_sets_;
}

std::size_t Draft::freeModes() const {
  constexpr std::size_t kMost = 5;  // largest number of modes besides level sets
  // at most this number of level sets count as modes, so that other grids get at least two
  constexpr std::size_t kMostByLevelSets = 3;
  const std::size_t taken =
      modes_.size() - level_sets_ + std::min<std::size_t>(level_sets_, kMostByLevelSets);
  return kMost - std::min(kMost, taken);
}

void Draft::leaveOut(const Candidate& candidate, const std::string& why) {
  leaveOut(candidate.shownName(), why, "");
  use(candidate);
}

void Draft::leaveOut(const std::string& name, const std::string& why, const std::string& remedy) {
  omissions_.push_back({name, why, remedy});
}

void Draft::takeBack(const Candidate& candidate) {
  std::erase_if(omissions_,
                [&](const Omission& left) { return left.name == candidate.shownName(); });
}

std::string Draft::omissions(const char* before, const char* after) const {
  std::string all;
  for (const Omission& left : omissions_) {
    all += (all.empty() ? "" : ", ") + left.name;
    if (!left.why.empty()) all += " (" + left.why + ")";
  }
  return all.empty() ? "" : before + all + after;
}

std::string Draft::firstRemedy(const std::string& otherwise) const {
  for (const Omission& left : omissions_) {
    if (!left.remedy.empty()) return left.remedy;
  }
  return otherwise;
}

Guess Draft::write() const {
  if (modes_.empty()) {
    throw VolumeError(names_.file, "no grid can be used in a scene" + omissions(" (", ")"),
                      firstRemedy("choose a file or an array whose values vary"));
  }
  Guess out;
  std::string description =
      "A first guess by palpate: adjust values and strengths to what you want to feel.";
  description += omissions(" Left out: ", ".");
  Json scene;
  scene["description"] = description;
  scene["palpate"] = 1;
  // Sets no stiffness, so that fitCoupling can lower the default to the limit of the device.
  scene["coupling"] = Json{{"damping", 0.5}};
  scene["volumes"] = volumes_;
  if (!fields_.empty()) scene["fields"] = fields_;
  scene["modes"] = modes_;
  out.scene = indented(scene) + "\n";
  for (const Candidate* c : shown_) out.seen.push_back(c->shownName() + ": " + c->seen);
  for (const Json& mode : modes_) out.made.push_back(lineOf(mode));
  for (const Omission& left : omissions_) {
    const std::string why = left.why.empty() ? "other grids have priority" : left.why;
    out.left.push_back(left.name + ": " + why + (left.remedy.empty() ? "" : ": " + left.remedy));
  }
  return out;
}

}  // namespace palpate::guess
