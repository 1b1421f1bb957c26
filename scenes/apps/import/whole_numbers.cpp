#include "palpate/scenes/apps/import/whole_numbers.h"

#include <algorithm>
#include <cstddef>
#include <limits>

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

namespace palpate::importer {
namespace {

/// 2^24: up to this number, a float represents all whole numbers.
constexpr double kFloatWhole = 16777216.0;

bool holdsWholeNumbers(const Array& array) {
  const Type type = array.values.type();
  if (array.values.components() != 1 || array.values.bytesEach() < 4) return false;
  return type == Type::kFloat64 ? array.whole : type != Type::kFloat32;
}

struct ValueRange {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  double rounding = 0.0;  ///< Largest difference to the nearest float.
};

ValueRange widened(const ValueRange& a, const ValueRange& b) {
  return {std::min(a.low, b.low), std::max(a.high, b.high), std::max(a.rounding, b.rounding)};
}

/// Returns the range of all finite values of all ranks.
ValueRange rangeOf(const Values& values, const Shared& shared) {
  const auto compute = [&](const auto* data) {
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, values.size(), 4096), ValueRange(),
        [=](const tbb::blocked_range<std::size_t>& part, ValueRange range) {
          for (std::size_t i = part.begin(); i < part.end(); ++i) {
            const auto value = static_cast<double>(data[i]);
            const auto rounded = static_cast<double>(static_cast<float>(value));
            if (!std::isfinite(value)) continue;
            range = widened(range, {value, value, std::abs(value - rounded)});
          }
          return range;
        },
        widened);
  };
  const ValueRange own = shared.isKnown() ? ValueRange() : visit(values, compute);
  ValueRange all;
  for (const ValueRange& one : gatherOne(shared.group(), own)) all = widened(all, one);
  return all;
}

/// Returns the values minus an offset: doubles as doubles, others as floats.
Values lessOffset(const Values& values, double offset) {
  const bool doubles = values.type() == Type::kFloat64;
  Values out(doubles ? Type::kFloat64 : Type::kFloat32, 1, values.tuples());
  out.setLost(values.lost());
  const auto copy = [&](const auto* from, auto* to) {
    using To = std::remove_pointer_t<decltype(to)>;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, values.tuples(), 4096),
                      [=](const tbb::blocked_range<std::size_t>& part) {
                        for (std::size_t i = part.begin(); i < part.end(); ++i) {
                          to[i] = static_cast<To>(minus(from[i], offset));
                        }
                      });
  };
  visit(values, [&](const auto* from) {
    if (doubles) {
      copy(from, out.as<double>());
    } else {
      copy(from, out.as<float>());
    }
  });
  return out;
}

/// Returns the loss of converting doubles to floats; "" if it is small for their range.
Loss doubleLoss(const ValueRange& range) {
  constexpr double kSmall = 1e-4;
  const double share = range.rounding / (range.high - range.low);
  if (!(share > kSmall) || !std::isfinite(share)) return "";
  return fmt::format("values are rounded to floats, by up to {:.2g}: {:.2g} % of their range",
                     range.rounding, 100.0 * share);
}

}  // namespace

double wholeOffset(const Array& array, double lowest, double highest) {
  if (!holdsWholeNumbers(array) || !(lowest <= highest)) return 0.0;
  const double most = std::max(std::abs(lowest), std::abs(highest));
  if (most <= kFloatWhole) return 0.0;
  // The range of 64-bit integers is only known as doubles, which are rounded.
  const double rounding =
      std::floor(2.0 * (std::nextafter(most, std::numeric_limits<double>::infinity()) - most));
  if (highest - lowest + rounding > kFloatWhole) return 0.0;
  return std::min(lowest, std::nextafter(std::exp2(64.0), 0.0));  // 2^64 itself needs 65 bits
}

Loss wholeLoss(double lowest, double highest) {
  const double most = std::max(std::abs(lowest), std::abs(highest));
  return std::isfinite(most) && most > kFloatWhole
             ? "whole numbers with a magnitude above 16,777,216 may be rounded"
             : "";
}

void subtractOffset(Array& array, std::optional<double>& series, const Shared& shared) {
  const bool whole = holdsWholeNumbers(array);
  if (!whole && array.value_offset == 0.0 && series.value_or(0.0) == 0.0) {
    series = 0.0;
    if (array.values.type() == Type::kFloat64 && array.values.lost().empty()) {
      array.values.setLost(doubleLoss(rangeOf(array.values, shared)));
    }
    return;
  }
  const ValueRange range = rangeOf(array.values, shared);
  if (!series) {
    series =
        array.value_offset != 0.0 ? array.value_offset : wholeOffset(array, range.low, range.high);
  }
  if (const double more = *series - array.value_offset; more != 0.0) {
    array.values = lessOffset(array.values, more);
    array.values.setLost(wholeLoss(range.low - more, range.high - more));
    array.value_offset = *series;
  } else if (whole && array.whole) {
    array.values.setLost(wholeLoss(range.low, range.high));
  }
  constexpr double kDouble = 9007199254740992.0;  // 2^53
  if (array.whole && std::max(std::abs(range.low), std::abs(range.high)) > kDouble) {
    array.values.setLost(
        "whole numbers with a magnitude above 9,007,199,254,740,992 may be rounded: they were read "
        "as doubles");
  }
}

}  // namespace palpate::importer
