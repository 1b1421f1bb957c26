#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <set>
#include <string>
#include <type_traits>
#include <utility>

#include "palpate/samplers/grid/labels.h"
#include "palpate/scenes/guess/sampling.h"
#include "palpate/scenes/guess/scalar_parts.h"
#include "palpate/scenes/guess/scene_json.h"

namespace palpate::guess {

void analyseLabels(const std::vector<ScalarSample>& samples, ScalarAnalysis& scalar) {
  const auto share = [](double part, double all) { return all > 0.0 ? part / all : 0.0; };
  double whole = 0.0;
  std::vector<float> distinct;
  for (const float value : scalar.values) {
    // Above 2^24, every float is a whole number, so larger values do not count.
    whole += value == std::round(value) && std::abs(value) <= 0x1p24F ? 1.0 : 0.0;
    if (distinct.size() <= kMostDistinct && (distinct.empty() || distinct.back() != value)) {
      distinct.push_back(value);
    }
  }
  scalar.whole =
      scalar.range() >= 1.0 ? share(whole, static_cast<double>(scalar.values.size())) : 0.0;
  if (distinct.size() > kMostDistinct) return;
  // `alike` ignores pairs with the most frequent value, which surrounds the others.
  float common = scalar.values.front();
  std::ptrdiff_t most = 0;
  for (const float value : distinct) {
    const auto [from, to] = std::equal_range(scalar.values.begin(), scalar.values.end(), value);
    if (to - from > most) {
      most = to - from;
      common = value;
    }
  }
  double pairs = 0.0;
  double alike = 0.0;
  double others = 0.0;
  double skips = 0.0;
  for (const ScalarSample& sample : samples) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (!sample.known[axis]) continue;
      for (const float near : {sample.before[axis], sample.after[axis]}) {
        if (near != common && sample.value != common) {
          pairs += 1.0;
          alike += near == sample.value ? 1.0 : 0.0;
        }
        if (near == sample.value) continue;
        others += 1.0;
        const auto [less, more] = std::minmax(near, sample.value);
        const auto next = std::upper_bound(distinct.begin(), distinct.end(), less);
        if (next != distinct.end() && *next < more) skips += 1.0;
      }
    }
  }
  scalar.alike = share(alike, pairs);
  scalar.skips = share(skips, others);
  if (scalar.outside && std::find(distinct.begin(), distinct.end(),
                                  static_cast<float>(*scalar.outside)) == distinct.end()) {
    const auto edge = [](const ScalarSample& sample) { return sample.at_edge; };
    if (std::any_of(samples.begin(), samples.end(), edge)) {
      distinct.push_back(static_cast<float>(*scalar.outside));
      std::sort(distinct.begin(), distinct.end());
    }
  }
  scalar.distinct = std::move(distinct);
}

std::vector<Label> segmentsOf(const SuggestInput& input) {
  if (!input.isScalar() || input.bricks) return {};
  const std::vector<Label> all = labelsIn(*input.grid);
  std::map<double, std::uint64_t> voxels;
  for (const Label& label : all) voxels[label.value] = 0;
  if (all.empty()) return {};
  withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
    const auto& grid = static_cast<const G&>(*input.grid);
    std::uint64_t others = 0;
    std::uint64_t* count = &others;
    auto last = std::numeric_limits<double>::quiet_NaN();
    for (auto it = grid.cbeginValueOn(); it; ++it) {
      const auto value = static_cast<double>(*it);
      if (value != last) {
        last = value;
        const auto found = std::isnan(value) ? voxels.end() : voxels.find(value);
        count = found == voxels.end() ? &others : &found->second;
      }
      *count += it.getVoxelCount();
    }
    const auto background = static_cast<double>(grid.background());
    if (!std::isnan(background)) voxels.erase(background);
    return 0;
  });
  std::map<std::string, std::set<double>> named;
  for (const Label& label : all) named[label.name].insert(label.value);
  const auto is_usable = [&named](const std::string& name) {
    const std::string text = Json(name).dump(-1, ' ', false, Json::error_handler_t::replace);
    return Json::parse(text) == name && named.at(name).size() == 1;
  };
  std::vector<std::pair<std::uint64_t, Label>> sized;
  for (const Label& label : all) {
    const auto found = voxels.find(label.value);
    const std::uint64_t count = found == voxels.end() ? 0 : std::exchange(found->second, 0);
    if (count == 0) continue;
    sized.emplace_back(count, label);
    if (!is_usable(label.name)) sized.back().second.name.clear();
  }
  std::stable_sort(sized.begin(), sized.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<Label> segments;
  segments.reserve(sized.size());
  for (auto& [count, label] : sized) segments.push_back(std::move(label));
  return segments;
}

std::optional<float> noDataOf(const std::vector<float>& sorted, double least) {
  // relative to the range of the other values; the values of air and flesh are nearer to each other
  constexpr double kFar = 10.0;
  // a grid with at most this number of different values may have labels
  constexpr std::size_t kFew = 64;
  std::size_t distinct = 1;
  for (std::size_t i = 1; i < sorted.size() && distinct <= kFew; ++i) {
    distinct += sorted[i] != sorted[i - 1] ? 1 : 0;
  }
  if (distinct <= kFew) return std::nullopt;
  const auto far_from = [&](float value, double low, double high) {
    return std::max(low - value, value - high) > kFar * (high - low) && high > low;
  };
  for (const float value : {sorted.front(), sorted.back()}) {
    const auto [from, to] = std::equal_range(sorted.begin(), sorted.end(), value);
    const auto count = static_cast<double>(to - from);
    if (count < least) continue;
    const bool lowest = from == sorted.begin();
    if (lowest ? to == sorted.end() : from == sorted.begin()) continue;
    const double low = lowest ? *to : sorted.front();
    const double high = lowest ? sorted.back() : *(from - 1);
    if (far_from(value, low, high)) return value;
  }
  return std::nullopt;
}

}  // namespace palpate::guess
