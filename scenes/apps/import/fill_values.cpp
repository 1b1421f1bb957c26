#include "palpate/scenes/apps/import/fill_values.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>
#include <type_traits>
#include <utility>

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include "palpate/scenes/apps/import/whole_numbers.h"

namespace palpate::importer {
namespace {

/// Largest number of fill values at each end of the range, such as "no data" and "land".
constexpr std::size_t kMostFills = 2;

/// The outermost different finite values, in the order `Before`. At least the last of them is data,
/// not a fill value.
template <class Before>
struct Outermost {
  std::array<double, kMostFills + 1> values{};

  Outermost() { values.fill(std::numeric_limits<double>::quiet_NaN()); }
  void add(double value) {
    if (!std::isfinite(value)) return;
    for (double& own : values) {
      if (value == own) return;
      if (std::isnan(own) || Before()(value, own)) std::swap(value, own);
      if (std::isnan(value)) return;
    }
  }
  [[nodiscard]] bool isInner(double value) const { return Before()(values.back(), value); }
};

struct Ends {
  Outermost<std::less<>> low;
  Outermost<std::greater<>> high;

  void add(double value) {
    if (!low.isInner(value)) low.add(value);
    if (!high.isInner(value)) high.add(value);
  }
  void add(const Ends& other) {
    for (const double value : other.low.values) low.add(value);
    for (const double value : other.high.values) high.add(value);
  }
};

/// Returns the outermost values of component c in all ranks.
Ends endsOf(const Values& values, std::size_t c, const Shared& shared) {
  const auto width = static_cast<std::size_t>(values.components());
  const auto compute = [&](const auto* data) {
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, values.tuples(), 4096), Ends(),
        [=](const tbb::blocked_range<std::size_t>& part, Ends ends) {
          for (std::size_t i = part.begin(); i < part.end(); ++i) {
            ends.add(static_cast<double>(data[i * width + c]));
          }
          return ends;
        },
        [](Ends a, const Ends& b) {
          a.add(b);
          return a;
        });
  };
  const Ends own = shared.isKnown() ? Ends() : visit(values, compute);
  Ends all;
  for (const Ends& one : gatherOne(shared.group(), own)) all.add(one);
  return all;
}

struct Fills {
  std::size_t low = 0;
  std::size_t high = 0;
  double lowest = 0.0;
  double highest = 0.0;
};

/// Returns true if all values outside the range of `fills` are fill values (hideFillValues).
/// @param code  Values::lowestCode().
bool areFills(const Ends& ends, const Fills& fills, double code) {
  const double range = fills.highest - fills.lowest;
  if (!(range > 0.0)) return false;
  const double most = std::max(std::abs(fills.lowest), std::abs(fills.highest));
  const auto marks = [&](double value) { return value == code || isFillNumber(value, most); };
  for (std::size_t i = 0; i < fills.low; ++i) {
    const double value = ends.low.values[i];
    if (!marks(value) || fills.lowest - value < range) return false;
  }
  for (std::size_t i = 0; i < fills.high; ++i) {
    const double value = ends.high.values[i];
    // Some programs write 9999 for one kind of missing data, and -9999 for another.
    const auto* const low_end = ends.low.values.begin() + static_cast<std::ptrdiff_t>(fills.low);
    const bool has_twin = isFillNumber(-value, most) &&
                          std::find(ends.low.values.begin(), low_end, -value) != low_end;
    if (!(marks(value) || has_twin) || value - fills.highest < range) return false;
  }
  return true;
}

Fills fillsOf(const Ends& ends, double code) {
  for (std::size_t count = 2 * kMostFills; count > 0; --count) {
    for (std::size_t low = std::min(count, kMostFills) + 1; low-- > 0;) {
      const std::size_t high = count - low;
      if (high > kMostFills) break;
      const Fills fills{low, high, ends.low.values[low], ends.high.values[high]};
      if (areFills(ends, fills, code)) return fills;
    }
  }
  return {};
}

/// Replaces values outside their component's range by NaN, and subtracts an offset from all others.
/// The result has floats or doubles.
Values onlyWithin(const Values& values, const std::vector<Fills>& fills, double offset) {
  const bool is_float = values.type() == Type::kFloat32 || values.type() == Type::kFloat64;
  // A double represents every number of four bytes.
  const Type type = values.bytesEach() < 4 ? Type::kFloat32 : Type::kFloat64;
  Values out = is_float ? values : Values(type, values.components(), values.tuples());
  if (!is_float) {
    out.setLost(values.lost());
    for (const Fills& one : fills)
      out.setLost(wholeLoss(one.lowest - offset, one.highest - offset));
  }
  const auto copy = [&](const auto* from, auto* to) {
    using To = std::remove_pointer_t<decltype(to)>;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, values.tuples(), 4096),
                      [&](const tbb::blocked_range<std::size_t>& part) {
                        std::size_t n = part.begin() * fills.size();
                        for (std::size_t i = part.begin(); i < part.end(); ++i) {
                          for (const Fills& one : fills) {
                            const auto value = static_cast<double>(from[n]);
                            const bool is_data = value >= one.lowest && value <= one.highest;
                            to[n] = is_data ? static_cast<To>(minus(from[n], offset))
                                            : std::numeric_limits<To>::quiet_NaN();
                            ++n;
                          }
                        }
                      });
  };
  visit(values, [&](const auto* from) {
    if (out.type() == Type::kFloat32) {
      copy(from, out.as<float>());
    } else {
      copy(from, out.as<double>());
    }
  });
  return out;
}

/// Adds a note if a component has only two values, and one of them looks like a fill value.
/// @param name  Name of the component for the note.
void noteTwoValues(const std::string& name, const Ends& ends, std::vector<std::string>& notes) {
  const double low = ends.low.values[0];
  const double high = ends.high.values[0];
  const bool is_pair = low < high && ends.low.values[1] == high;
  const bool is_low = is_pair && isFillNumber(low, std::abs(high));
  if (!is_low && !(is_pair && isFillNumber(high, std::abs(low)))) return;
  std::string note = fmt::format(
      "{}: all finite values are {:.6g} or {:.6g}: both count as data, although programs write "
      "{:.6g} for missing data",
      name, low, high, is_low ? low : high);
  if (std::find(notes.begin(), notes.end(), note) == notes.end()) notes.push_back(std::move(note));
}

}  // namespace

bool isFillNumber(double value, double others) {
  const double size = std::abs(value);
  if (size > 1e30) return true;
  for (const double bits : {16.0, 32.0, 64.0}) {
    const double lowest = -std::exp2(bits - 1.0);
    if (value == lowest || value == lowest + 1.0) return true;
  }
  if (size < 999.0) return false;
  // A float may round a power of ten, so that its digits begin with 9.99999.
  constexpr double kRounding = 1e-6;
  const double digits = size / std::pow(10.0, std::floor(std::log10(size)));
  const bool is_power = digits < 1.0 + kRounding || digits > 10.0 - kRounding;
  // A smaller ratio may be data, such as a density of 1e16 beside 1e14.
  constexpr double kBeyond = 1e4;
  return (value < 0.0 && digits >= 9.99) ||
         (size >= std::max(1e10, kBeyond * others) && (is_power || digits >= 9.99));
}

bool hideFillValues(Array& array, std::vector<std::string>& notes, const Shared& shared) {
  const Values& values = array.values;
  std::vector<Fills> fills;
  bool found = false;
  for (std::size_t c = 0; c < static_cast<std::size_t>(values.components()); ++c) {
    const Ends ends = endsOf(values, c, shared);
    Fills one = fillsOf(ends, values.lowestCode());
    const std::string name =
        values.components() == 1
            ? array.name
            : fmt::format("{}, component {} of {}", array.name, c + 1, values.components());
    if (one.low + one.high == 0) {
      noteTwoValues(name, ends, notes);
      one.lowest = ends.low.values.front();
      one.highest = ends.high.values.front();
    }
    const auto tell = [&](double value) {
      found = true;
      std::string note = fmt::format(
          "{}: the value {:.6g} counts as missing data: the data are between {:.6g} and {:.6g}",
          name, value, one.lowest, one.highest);
      if (std::find(notes.begin(), notes.end(), note) == notes.end()) notes.push_back(note);
    };
    for (std::size_t i = 0; i < one.low; ++i) tell(ends.low.values[i]);
    for (std::size_t i = 0; i < one.high; ++i) tell(ends.high.values[i]);
    fills.push_back(one);
  }
  if (!found) return false;
  const double offset = wholeOffset(array, fills.front().lowest, fills.front().highest);
  array.values = onlyWithin(values, fills, offset);
  array.value_offset += offset;
  return true;
}

}  // namespace palpate::importer
