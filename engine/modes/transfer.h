/// Transfer functions, which map a property's value to a strength or another material property.
#pragma once

#include <utility>
#include <vector>

namespace palpate {

/// A piecewise-linear curve through knots, constant before the first and after the last knot.
class TransferFunction {
 public:
  using Knot = std::pair<double, double>;  ///< Input and output at one point of the curve.

  /// Makes a constant >= 0. Throws SceneError for invalid numbers, as do window() and piecewise().
  TransferFunction(double constant = 0.0);  // NOLINT(google-explicit-constructor): a number is one
  /// Returns a ramp from 0 at level - width/2 to max at level + width/2. width > 0, max >= 0.
  [[nodiscard]] static TransferFunction window(double level, double width, double max);
  /// Returns the curve through knots with ascending inputs and outputs >= 0. Needs at least one
  /// knot; all numbers must be finite. Two equal inputs make a step; there, the later knot counts.
  [[nodiscard]] static TransferFunction piecewise(std::vector<Knot> knots);

  /// Returns true if the curve has one knot, and false for a flat curve with several.
  [[nodiscard]] bool isConstant() const noexcept { return knots_.size() == 1; }
  /// Returns the knots, at least one, by ascending input. A constant has one knot, at input 0.
  [[nodiscard]] const std::vector<Knot>& knots() const noexcept { return knots_; }

  /// Returns the curve's largest output.
  [[nodiscard]] double highest() const noexcept;
  [[nodiscard]] double lowest() const noexcept;  ///< Returns the curve's smallest output, >= 0.

  /// Returns true if the output is 0 at x and at all inputs above x (sign > 0) or below x (sign <
  /// 0). Returns false if a step at x has an output above 0 on either side.
  [[nodiscard]] bool isZeroFrom(double x, double sign) const noexcept;

  /// Returns the curve's output at x; 0 if x is NaN. RT: no allocation. Cost: O(log knots).
  [[nodiscard]] double operator()(double x) const noexcept;
  /// Returns the curve's slope just above x; 0 if x is NaN. RT: no allocation. Cost: O(log knots).
  [[nodiscard]] double slope(double x) const noexcept;

 private:
  explicit TransferFunction(std::vector<Knot> knots) : knots_(std::move(knots)) {}
  /// Returns the first knot with an input above x; the end of the knots if there is none, or if x
  /// is NaN.
  [[nodiscard]] std::vector<Knot>::const_iterator above(double x) const noexcept;

  std::vector<Knot> knots_;
};

}  // namespace palpate
