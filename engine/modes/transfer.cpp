#include "palpate/engine/modes/transfer.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

[[noreturn]] void refuse(const std::string& why, const char* remedy) {
  throw SceneError("transfer function", why, remedy);
}

bool lower(const TransferFunction::Knot& a, const TransferFunction::Knot& b) noexcept {
  return a.second < b.second;
}

}  // namespace

TransferFunction::TransferFunction(double constant) : knots_{{0.0, constant}} {
  if (!std::isfinite(constant) || constant < 0.0) {
    refuse("a constant is " + std::to_string(constant) + ", not a finite number >= 0",
           "give a number >= 0");
  }
}

TransferFunction TransferFunction::window(double level, double width, double max) {
  if (!std::isfinite(level) || !std::isfinite(width) || !std::isfinite(max)) {
    refuse("a window's level, width or max is not finite", "give finite numbers");
  }
  if (width <= 0.0)
    refuse("a window's width is " + std::to_string(width) + ", not above 0", "give a width > 0");
  return piecewise({{level - 0.5 * width, 0.0}, {level + 0.5 * width, max}});
}

TransferFunction TransferFunction::piecewise(std::vector<Knot> knots) {
  if (knots.empty()) refuse("a piecewise curve has no point", "give at least one [input, output]");
  for (const Knot& knot : knots) {
    if (!std::isfinite(knot.first) || !std::isfinite(knot.second)) {
      refuse("a point of a curve is not finite", "give finite inputs and outputs");
    }
    if (knot.second < 0.0) {
      refuse("a curve has the output " + std::to_string(knot.second) + ", which is negative",
             "give outputs >= 0, and reverse a force with \"sense\"");
    }
  }
  const auto ascending = [](const Knot& a, const Knot& b) { return a.first < b.first; };
  if (!std::is_sorted(knots.begin(), knots.end(), ascending)) {
    refuse("the inputs of a curve's points do not ascend", "sort the points by input");
  }
  return TransferFunction(std::move(knots));
}

double TransferFunction::highest() const noexcept {
  return std::max_element(knots_.begin(), knots_.end(), lower)->second;
}

double TransferFunction::lowest() const noexcept {
  return std::min_element(knots_.begin(), knots_.end(), lower)->second;
}

bool TransferFunction::isZeroFrom(double x, double sign) const noexcept {
  return (*this)(x) == 0.0 && std::all_of(knots_.begin(), knots_.end(), [&](const Knot& knot) {
           return knot.second == 0.0 || sign * (knot.first - x) < 0.0;
         });
}

std::vector<TransferFunction::Knot>::const_iterator TransferFunction::above(
    double x) const noexcept {
  return std::upper_bound(knots_.begin(), knots_.end(), x,
                          [](double input, const Knot& knot) { return input < knot.first; });
}

double TransferFunction::slope(double x) const noexcept {
  if (std::isnan(x)) return 0.0;
  const auto after = above(x);
  if (after == knots_.begin() || after == knots_.end()) return 0.0;
  const Knot& a = *(after - 1);
  const Knot& b = *after;
  return (b.second - a.second) / (b.first - a.first);
}

double TransferFunction::operator()(double x) const noexcept {
  if (std::isnan(x)) return 0.0;
  if (knots_.size() == 1) return knots_.front().second;
  const auto after = above(x);
  if (after == knots_.begin()) return knots_.front().second;
  if (after == knots_.end()) return knots_.back().second;
  const Knot& a = *(after - 1);
  const Knot& b = *after;
  return a.second + (b.second - a.second) * ((x - a.first) / (b.first - a.first));
}

}  // namespace palpate
