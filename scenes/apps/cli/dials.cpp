#include "palpate/scenes/apps/cli/dials.h"

#include <algorithm>
#include <numeric>
#include <string>
#include <utility>

namespace palpate::cli {
namespace {

using Numbers = std::map<std::vector<std::string>, std::vector<std::size_t>>;

/// Returns the indices of the modes by name; without a name, by kind and volume.
Numbers known(const SceneSpec& spec) {
  Numbers numbers;
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    std::vector<std::string> by{mode.name};
    if (mode.name.empty()) by.insert(by.end(), {wordFor(mode.kind), mode.of});
    numbers[by].push_back(i);
  }
  return numbers;
}

/// Scales the outputs of the first curve. If a factor were added, `by` could apply to another
/// factor.
void scale(TransferSpec& property, double factor) {
  TransferFunction& curve = property.factors.front().curve;
  std::vector<TransferFunction::Knot> knots = curve.knots();
  for (TransferFunction::Knot& knot : knots) knot.second *= factor;
  curve = TransferFunction::piecewise(std::move(knots));
}

}  // namespace

ModeIds idsOf(const SceneSpec& spec) {
  ModeIds ids{std::vector<std::uint32_t>(spec.graph.modes.size()), 0};
  ids.next = static_cast<std::uint32_t>(ids.of.size());
  std::iota(ids.of.begin(), ids.of.end(), 0U);
  return ids;
}

ModeIds idsOf(const SceneSpec& edited, const SceneSpec& before, const ModeIds& ids) {
  const Numbers then = known(before);
  ModeIds now{std::vector<std::uint32_t>(edited.graph.modes.size()), ids.next};
  for (const auto& [by, numbers] : known(edited)) {
    const auto old = then.find(by);
    const bool same = old != then.end() && old->second.size() == numbers.size();
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      now.of[numbers[i]] = same ? ids.of[old->second[i]] : now.next++;
    }
  }
  return now;
}

std::vector<LiveDial> inOrder(const Dials& dials, const ModeIds& ids) {
  std::vector<LiveDial> all;
  for (const std::uint32_t mode : ids.of) {
    const auto dial = dials.find(mode);
    all.push_back({mode, dial == dials.end() ? 1.0F : dial->second});
  }
  return all;
}

void dial(SceneSpec& spec, const std::vector<LiveDial>& dials) {
  constexpr double kOff = 1e-9;
  const std::size_t count = std::min(dials.size(), spec.graph.modes.size());
  for (std::size_t i = 0; i < count; ++i) {
    ModeSpec& mode = spec.graph.modes[i];
    const double factor = std::max<double>(dials[i].factor, kOff);
    if (factor == 1.0 || mode.kind == ModeKind::kUser) continue;
    scale(mode.strength, factor);
    scale(mode.viscosity, factor);
  }
}

}  // namespace palpate::cli
