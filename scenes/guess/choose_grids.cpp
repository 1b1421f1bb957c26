/// Rules that choose the grids for a scene, in the order in which chooseGrids() applies them.
#include "palpate/scenes/guess/choose_grids.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <initializer_list>
#include <utility>

#include <fmt/format.h>

#include "palpate/scenes/guess/body.h"
#include "palpate/scenes/guess/components.h"
#include "palpate/scenes/guess/mode_rules.h"

namespace palpate::guess {
namespace {

bool hasWord(const std::string& text, std::initializer_list<const char*> words) {
  return std::any_of(words.begin(), words.end(),
                     [&](const char* word) { return text.find(word) != std::string::npos; });
}

/// Leaves out scalars that are components of a vector: a scene joins grids only if their names end
/// in .x, .y and .z.
void leaveComponents(const std::vector<Candidate>& candidates, Draft& draft) {
  std::vector<std::string> names;
  std::vector<const Candidate*> scalars;
  for (const Candidate& c : candidates) {
    if (!c.input->isScalar() || c.kind == Kind::kLevelSet) continue;
    names.push_back(c.grid);
    scalars.push_back(&c);
  }
  for (const Components& found : findComponents(names)) {
    std::array<const Candidate*, 3> parts{};
    for (std::size_t i = 0; i < 3; ++i) parts[i] = scalars[found.parts[i]];
    const auto fits = [&](const Candidate* part) {
      return part->input->grid->transform() == parts[0]->input->grid->transform();
    };
    if (!std::all_of(parts.begin(), parts.end(), fits)) continue;
    for (const Candidate* part : parts) draft.use(*part);
    draft.leaveOut(fmt::format("{}, {}, {}", parts[0]->grid, parts[1]->grid, parts[2]->grid),
                   "components of a vector, which a scene cannot join",
                   fmt::format("name them {0}.x, {0}.y and {0}.z in the .vdb, or import the "
                               "original file without --field: palpate import joins them",
                               found.name));
  }
}

/// Leaves out weights of distances: they state how reliably a scanner has measured a voxel.
void leaveWeights(const std::vector<Candidate>& candidates, Draft& draft) {
  const auto is_distance = [](const Candidate& c) {
    return c.kind == Kind::kLevelSet || c.kind == Kind::kDistance;
  };
  const auto distance = std::find_if(candidates.begin(), candidates.end(), is_distance);
  if (distance == candidates.end()) return;
  for (const Candidate& c : candidates) {
    if (!c.input->isScalar() || is_distance(c) || draft.isUsed(c) || c.scalar.low < 0.0) continue;
    const std::string name = lowerCase(c.input->name());
    if (name == "w" || hasWord(name, {"weight", "confidence", "observations"})) {
      draft.leaveOut(c, "the weights of the distances in grid " + distance->shownName());
    }
  }
}

void addLevelSets(const std::vector<Candidate>& candidates, Draft& draft) {
  for (const Candidate& c : candidates) {
    if (!draft.isFree(c, Kind::kLevelSet)) continue;
    if (draft.levelSets() == kMostLevelSets) {
      draft.leaveOut(c);
      continue;
    }
    draft.addVolume(c);
    draft.addLevelSet(levelSetSurface(c));
  }
}

/// Returns the anisotropy grid of directions: "tensor_fa" belongs to "tensor_direction".
const Candidate* anisotropyOf(const std::vector<Candidate>& candidates, const Candidate& fibres) {
  std::string prefix = lowerCase(fibres.input->name());
  const std::string ending = "direction";
  if (prefix.ends_with(ending)) {
    prefix.resize(prefix.size() - ending.size());
  } else {
    prefix += "_";
  }
  for (const Candidate& c : candidates) {
    const std::string name = lowerCase(c.input->name());
    if (c.kind != Kind::kLevelSet && c.scalar.range() > 0.0 &&
        (name == prefix + "anisotropy" || name == prefix + "fa" || name == "fa" ||
         name == "anisotropy")) {
      return &c;
    }
  }
  return nullptr;
}

/// Adds the first grid of directions that varies.
void addFibres(const std::vector<Candidate>& candidates, Draft& draft) {
  const Candidate* chosen = nullptr;
  for (const Candidate& c : candidates) {
    if (c.kind == Kind::kConstant && c.input->axial) draft.leaveOut(c, c.seen);
    if (!draft.isFree(c, Kind::kDirections)) continue;
    if (chosen != nullptr) {
      draft.leaveOut(c);
    } else {
      chosen = &c;
    }
  }
  if (chosen == nullptr) return;
  draft.addVolume(*chosen);
  if (const Candidate* by = anisotropyOf(candidates, *chosen)) {
    draft.addVolume(*by);
    draft.use(*by);
    draft.addMode(followDirectionsBy(*by, *chosen));
  } else {
    draft.addMode(followDirections(*chosen));
  }
}

bool isVelocity(const Candidate* c) {
  const std::string name = lowerCase(c->input->name());
  return name.rfind("vel", 0) == 0 || hasWord(name, {"velocity"}) || name == "v" || name == "u" ||
         name.rfind("flow", 0) == 0 || name.rfind("wind", 0) == 0;
}

struct Vectors {
  const Candidate* flow = nullptr;
  /// Uniform vectors; addUniform() may add one of them later.
  std::vector<const Candidate*> uniform;
};

/// Adds the first flow that is named like a velocity, otherwise the first flow.
Vectors addFlow(const std::vector<Candidate>& candidates, Draft& draft) {
  Vectors vectors;
  std::vector<const Candidate*> flows;
  for (const Candidate& c : candidates) {
    if (c.kind == Kind::kConstant && c.input->isVector() && !draft.isUsed(c)) {
      vectors.uniform.push_back(&c);
      draft.leaveOut(c, c.seen);
    }
    if (c.kind == Kind::kOther && c.input->isVector()) {
      draft.leaveOut(c.shownName(), c.seen, "resample the components to one lattice");
      draft.use(c);
    }
    if (draft.isFree(c, Kind::kFlow)) flows.push_back(&c);
  }
  if (flows.empty()) return vectors;
  auto chosen = std::find_if(flows.begin(), flows.end(), isVelocity);
  if (chosen == flows.end()) chosen = flows.begin();
  const Candidate& flow = **chosen;
  vectors.flow = &flow;
  for (const Candidate* c : flows) {
    if (c != &flow) draft.leaveOut(*c);
  }
  draft.addVolume(flow);
  const std::string speed = draft.addField("speed", Json{{"magnitude", flow.name}});
  draft.addMode(followFlow(flow, speed));
  if (!hasVortices(flow.vector)) return vectors;
  if (hasVortexCores(flow.vector)) {
    draft.addMode(vortexTube(flow));
    return vectors;
  }
  const std::string vorticity = draft.addField("vorticity", Json{{"curl", flow.name}});
  draft.addMode(vortexDrag(flow.vector, vorticity));
  return vectors;
}

/// Returns the scalars with values from 0 to 1, which may be fractions of materials.
std::vector<Candidate*> fractionsOf(std::vector<Candidate>& candidates, const Draft& draft) {
  constexpr double kTolerance = 0.01;  // interpolation can exceed the range 0 to 1 slightly
  std::vector<Candidate*> fractions;
  for (Candidate& c : candidates) {
    if (draft.isFree(c, Kind::kScalar) && c.scalar.low >= -kTolerance &&
        c.scalar.high <= 1.0 + kTolerance) {
      fractions.push_back(&c);
    }
  }
  return fractions;
}

/// Returns the index of the outermost material: by name, or by the mean on the box's faces.
std::size_t outermostOf(const std::vector<Candidate*>& fractions, const SumAnalysis& sum) {
  const auto is_void = [](const Candidate* c) {
    return hasWord(lowerCase(c->input->name()), {"void", "vacuum", "empty", "background"});
  };
  const auto named = std::find_if(fractions.begin(), fractions.end(), is_void);
  if (named != fractions.end()) return static_cast<std::size_t>(named - fractions.begin());
  const auto most = std::max_element(sum.at_faces.begin(), sum.at_faces.end());
  return static_cast<std::size_t>(most - sum.at_faces.begin());
}

bool isVolumeFraction(const Candidate* c) {
  return hasWord(lowerCase(c->input->name()),
                 {"volume fraction", "volume_fraction", "volumefraction", "volfrac", "vol_frac",
                  "vfrac", "vof"});
}

/// Leaves out masses of materials, because the fractions of the materials have their surfaces.
void leaveMasses(const std::vector<Candidate>& candidates, Draft& draft) {
  for (const Candidate& c : candidates) {
    const std::string name = lowerCase(c.input->name());
    if (draft.isFree(c, Kind::kScalar) && hasWord(name, {"mass"}) &&
        !hasWord(name, {"fraction", "density", "flux", "flow"})) {
      draft.leaveOut(c, "a mass of a material; the material's fraction gives the surface");
    }
  }
}

/// Adds surfaces of materials, the largest volume first. The outermost material gets no surface:
/// the hand moves in it. If the grids are named volume fractions, their sum may be less than 1, and
/// the rest is a void.
void addMaterials(std::vector<Candidate>& candidates, Draft& draft) {
  std::vector<Candidate*> fractions = fractionsOf(candidates, draft);
  const bool named = std::count_if(fractions.begin(), fractions.end(), isVolumeFraction) > 1;
  if (named) std::erase_if(fractions, [](const Candidate* c) { return !isVolumeFraction(c); });
  std::vector<const SuggestInput*> inputs;
  inputs.reserve(fractions.size());
  for (const Candidate* c : fractions) inputs.push_back(c->input);
  SumAnalysis sum = analyseSum(inputs);
  if (sum.other) {
    const auto other = static_cast<std::ptrdiff_t>(*sum.other);
    fractions.erase(fractions.begin() + other);
    sum.at_faces.erase(sum.at_faces.begin() + other);
    sum.throughout.erase(sum.throughout.begin() + other);
  }
  // Fractions of mixed gases also have the sum 1, but no surfaces.
  if (!(sum.is_one || (named && sum.is_at_most_one)) || !sum.apart) return;
  const std::size_t outermost = sum.is_one ? outermostOf(fractions, sum) : fractions.size();
  std::vector<std::pair<double, Candidate*>> materials;
  for (std::size_t i = 0; i < fractions.size(); ++i) {
    if (i != outermost) materials.emplace_back(sum.throughout[i], fractions[i]);
  }
  if (outermost < fractions.size()) {
    draft.leaveOut(*fractions[outermost],
                   "the material around the others: the hand moves in this material");
  }
  leaveMasses(candidates, draft);
  std::stable_sort(materials.begin(), materials.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  for (const auto& [share, c] : materials) {
    if (draft.freeModes() == 0) {
      draft.leaveOut(*c, "materials with larger volumes have priority");
      continue;
    }
    draft.use(*c);
    c->seen =
        fmt::format("the fraction of a material: {} grids with values from 0 to 1 add up to {}1",
                    fractions.size(), sum.is_one ? "" : "at most ");
    draft.addVolume(*c);
    draft.addMode(materialSurface(*c, share));
  }
}

/// Returns the score of a scalar. Evenly distributed values, a boundary, and the name of a familiar
/// quantity each increase the score.
double scoreOf(const Candidate& c) {
  constexpr double kObject = 0.3;  // relative to the largest entropy, 1
  constexpr double kFamiliar = 0.2;
  const bool familiar = hasWord(lowerCase(c.input->name()), {"temp", "pres", "dens"});
  return c.scalar.entropy + (c.scalar.has_object ? kObject : 0.0) + (familiar ? kFamiliar : 0.0);
}

std::vector<const Candidate*> scalarsByScore(std::vector<Candidate>& candidates, Draft& draft) {
  std::vector<const Candidate*> scalars;
  for (Candidate& c : candidates) {
    const bool other = c.kind == Kind::kLevelSet || c.kind == Kind::kBody || c.input->isVector();
    if (draft.isUsed(c) || other) continue;
    if (c.kind == Kind::kOther || c.kind == Kind::kConstant) {
      draft.leaveOut(c, c.seen);
      continue;
    }
    c.score = scoreOf(c);
    scalars.push_back(&c);
  }
  std::stable_sort(scalars.begin(), scalars.end(),
                   [](const Candidate* a, const Candidate* b) { return a->score > b->score; });
  return scalars;
}

void leaveInnerLabels(const Candidate& c, Draft& draft) {
  const std::vector<float>& all = c.scalar.distinct;
  if (c.kind != Kind::kLabels || all.size() <= 3) return;
  draft.leaveOut(fmt::format("labels {} to {} of {} as separate surfaces", shown(all[1]),
                             shown(all[all.size() - 2]), c.shownName()),
                 "an isosurface between two labels also encloses other labels",
                 "write a grid for each label, 1 inside of the label and 0 elsewhere, and put an "
                 "isosurface at 0.5");
}

/// Notes the labels of a segmentation that have no mode, because they are not among its largest.
void leaveSmallLabels(const Candidate& c, std::size_t most, Draft& draft) {
  if (c.segments.size() <= most || c.kind != Kind::kSegments) return;
  draft.leaveOut(fmt::format("{} of the {} labels of {}", c.segments.size() - most,
                             c.segments.size(), c.shownName()),
                 most == 1 ? "only the largest label gets a surface"
                           : fmt::format("only the {} largest labels get a surface", most),
                 "add modes with other labels, which palpate info lists");
}

const Candidate* bodyIn(const std::vector<Candidate>& candidates, const Candidate& image) {
  for (const Candidate& c : candidates) {
    if (c.kind != Kind::kBody) continue;
    const auto of = c.input->grid->getMetadata<openvdb::StringMetadata>(kMetaBodyOf);
    if (of && of->value() == image.input->name()) return &c;
  }
  return nullptr;
}

/// Adds at most `most` modes of a scalar. If the image has a body region, the modes act only in
/// this region.
void addModes(const std::vector<Candidate>& candidates, const Candidate& c, std::size_t most,
              Draft& draft) {
  const Candidate* body = c.kind == Kind::kHounsfield ? bodyIn(candidates, c) : nullptr;
  if (body != nullptr) draft.addVolume(*body);
  for (Json& mode : scalarModes(c, most)) {
    if (body != nullptr) confine(mode, body->name);
    draft.addMode(mode);
  }
  if (body == nullptr) return;
  draft.leaveOut("everything that is not connected to the largest body",
                 fmt::format("such as the table below a patient; to keep all, remove every \"by\": "
                             "\"{}\"; in a \"product\", remove the whole factor that has it",
                             body->name),
                 "");
}

/// Returns true if a scalar is redundant beside the flow: nearly a linear function of a component
/// of the flow or of its magnitude. The flow's modes show no surface. So a scalar with boundaries
/// is redundant only if this function has no offset: across a shock, every quantity is a linear
/// function of the velocity.
bool isShownBy(const Candidate& flow, const Candidate& scalar) {
  const Likeness likeness =
      scalar.scalar.boundaries.empty() ? Likeness::kLinear : Likeness::kMultiple;
  return isLike(*scalar.input, *flow.input, likeness);
}

/// Adds up to two scalars with the highest scores, except those that match the flow or a scalar
/// already added.
void addScalars(std::vector<Candidate>& candidates, const Candidate* flow, Draft& draft) {
  constexpr std::size_t kMost = 2;
  constexpr std::size_t kMostModes = 4;  // modes of one scalar: three surfaces and a drag
  std::vector<const Candidate*> chosen;
  for (const Candidate* c : scalarsByScore(candidates, draft)) {
    if (chosen.size() == std::min(kMost, draft.freeModes())) {
      draft.leaveOut(*c);
      continue;
    }
    const auto same = [&](const Candidate* o) {
      const bool are_labels = c->kind == Kind::kSegments && o->kind == Kind::kSegments;
      return !are_labels && isLike(*c->input, *o->input, Likeness::kLinear);
    };
    const Candidate* like = flow != nullptr && isShownBy(*flow, *c) ? flow : nullptr;
    const auto found = std::find_if(chosen.begin(), chosen.end(), same);
    if (found != chosen.end()) like = *found;
    if (like != nullptr) {
      draft.leaveOut(*c, "nearly a linear function of " + like->name);
    } else {
      chosen.push_back(c);
    }
  }
  // The first scalar may use up to kMostModes of the free modes. If a second scalar follows, the
  // first one leaves at least one mode.
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    const bool more = i + 1 < chosen.size();
    draft.addVolume(*chosen[i]);
    const std::size_t most = std::min(kMostModes, draft.freeModes() - (more ? 1 : 0));
    addModes(candidates, *chosen[i], most, draft);
    leaveInnerLabels(*chosen[i], draft);
    leaveSmallLabels(*chosen[i], most, draft);
  }
}

/// Adds the first uniform vector that is not zero; the hand can follow it.
void addUniform(const std::vector<const Candidate*>& uniform, Draft& draft) {
  for (const Candidate* c : uniform) {
    if (c->vector.speed.empty()) continue;
    draft.takeBack(*c);
    draft.addVolume(*c);
    draft.addMode(followUniform(*c));
    return;
  }
}

}  // namespace

void chooseGrids(std::vector<Candidate>& candidates, GuessFor stated, Draft& draft) {
  leaveComponents(candidates, draft);
  leaveWeights(candidates, draft);
  addLevelSets(candidates, draft);
  addFibres(candidates, draft);
  const Vectors vectors = addFlow(candidates, draft);
  if (stated == GuessFor::kAnything || stated == GuessFor::kCfd) addMaterials(candidates, draft);
  addScalars(candidates, vectors.flow, draft);
  if (!draft.hasModes()) addUniform(vectors.uniform, draft);
}

}  // namespace palpate::guess
