#include "palpate/scenes/apps/import/sentinels.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "palpate/scenes/guess/scalar_parts.h"

namespace palpate::importer {
namespace {

/// Least distance of a sentinel from all other values, relative to their range. Also the least
/// magnitude of a negative sentinel, relative to theirs.
constexpr double kFarFromOthers = 10.0;
/// Least magnitude of a positive sentinel, relative to that of all other values. Results have steep
/// peaks: specific dissipation at a wall is ten times that of the next cell.
constexpr double kHuge = 1000.0;

struct Extremes {
  double low = std::numeric_limits<double>::infinity();
  double next_low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  double next_high = -std::numeric_limits<double>::infinity();

  void add(double v) {
    if (v < low) {
      next_low = low;
      low = v;
    } else if (v > low && v < next_low) {
      next_low = v;
    }
    if (v > high) {
      next_high = high;
      high = v;
    } else if (v < high && v > next_high) {
      next_high = v;
    }
  }
  /// Returns false if no value can be a sentinel. This spares most arrays from being sorted.
  [[nodiscard]] bool mayHaveSentinel() const {
    return next_low - low > kFarFromOthers * (high - next_low) ||
           high - next_high > kFarFromOthers * (next_high - low);
  }
};

template <class Take>
void visitFinite(const Values& values, int component, Take take) {
  visit(values, [&](const auto* data) {
    const auto width = static_cast<std::size_t>(values.components());
    for (std::size_t i = static_cast<std::size_t>(component); i < values.size(); i += width) {
      const auto value = static_cast<float>(data[i]);
      if (std::isfinite(value)) take(value);
    }
  });
}

std::optional<float> sentinelOf(const Values& values, int component) {
  constexpr double kLeast = 2.0;  // a number that occurs once may be a result of the solver
  Extremes extremes;
  visitFinite(values, component, [&](float value) { extremes.add(static_cast<double>(value)); });
  if (!extremes.mayHaveSentinel()) return std::nullopt;
  std::vector<float> sorted;
  visitFinite(values, component, [&](float value) { sorted.push_back(value); });
  std::sort(sorted.begin(), sorted.end());
  const std::optional<float> alone = guess::noDataOf(sorted, kLeast);
  if (!alone) return std::nullopt;
  const bool lowest = *alone == sorted.front();
  const double low = lowest ? extremes.next_low : extremes.low;
  const double high = lowest ? extremes.high : extremes.next_high;
  const bool only_negative = *alone < 0.0F && low >= 0.0;
  const double most = std::max(std::abs(low), std::abs(high));
  const bool is_large = *alone < 0.0F ? *alone < -kFarFromOthers * most : *alone > kHuge * most;
  return only_negative || is_large ? alone : std::nullopt;
}

/// Sets the tuples with this value in a component to NaN. Returns their number.
template <class T>
std::size_t removeFrom(const Values& values, int component, float sentinel) {
  const auto width = static_cast<std::size_t>(values.components());
  T* tuple = values.as<T>();
  std::size_t count = 0;
  for (std::size_t i = 0; i < values.tuples(); ++i, tuple += width) {
    if (static_cast<float>(tuple[component]) != sentinel) continue;
    std::fill(tuple, tuple + width, std::numeric_limits<T>::quiet_NaN());
    ++count;
  }
  return count;
}

Values copyOf(const Values& values) {
  if (values.type() != Type::kFloat32 && values.type() != Type::kFloat64) return floatsOf(values);
  Values out(values.type(), values.components(), values.tuples());
  out.setLost(values.lost());
  visit(values, [&](const auto* from) {
    using T = std::remove_cv_t<std::remove_pointer_t<decltype(from)>>;
    std::copy(from, from + values.size(), out.as<T>());
  });
  return out;
}

}  // namespace

Values withoutSentinels(const Values& values, const std::string& name,
                        std::vector<std::string>& notes) {
  Values out = values;
  for (int c = 0; c < values.components(); ++c) {
    while (const std::optional<float> sentinel = sentinelOf(out, c)) {
      if (out.data() == values.data()) out = copyOf(values);
      const std::size_t count = out.type() == Type::kFloat32
                                    ? removeFrom<float>(out, c, *sentinel)
                                    : removeFrom<double>(out, c, *sentinel);
      notes.push_back(fmt::format("{}: {} values of {:.7g}, far from all others, mark missing data",
                                  name, count, *sentinel));
    }
  }
  return out;
}

}  // namespace palpate::importer
