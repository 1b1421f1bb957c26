/// Transfer functions: from a property's value to a strength.
#pragma once

#include <utility>
#include <vector>

namespace palpate {

/// A piecewise-linear curve through knots, constant before the first and after the last. A number
/// is one knot, a window two (also known as PiecewiseFunction and WindowFunction).
class TransferFunction {
 public:
  using Knot = std::pair<double, double>;  ///< input, output

  /// Makes a constant >= 0 for every input. Throws SceneError for bad numbers, as window() and
  /// piecewise() do.
  TransferFunction(double constant = 0.0);  // NOLINT(google-explicit-constructor): a number is one
  /// Returns a curve that rises linearly from 0 at level - width/2 to max at level + width/2. width
  /// > 0, max >= 0.
  [[nodiscard]] static TransferFunction window(double level, double width, double max);
  /// Returns the curve through knots of ascending input and outputs >= 0. Two equal inputs are a
  /// step: the later one counts from there on. At least one knot; all finite.
  [[nodiscard]] static TransferFunction piecewise(std::vector<Knot> knots);

  /// Returns true if the curve is one knot; a flat curve of several does not count.
  [[nodiscard]] bool isConstant() const noexcept { return knots_.size() == 1; }
  /// Returns the knots of the curve by ascending input, at least one. A plain number has one, at
  /// input 0.
  [[nodiscard]] const std::vector<Knot>& knots() const noexcept { return knots_; }

  /// Returns the curve's largest output.
  [[nodiscard]] double highest() const noexcept;
  [[nodiscard]] double lowest() const noexcept;  ///< The curve's smallest output, >= 0.

  /// Returns the curve at x; 0 for NaN. RT: no allocation. Cost: O(log knots).
  [[nodiscard]] double operator()(double x) const noexcept;
  /// Returns the curve's slope just above x; 0 for NaN. RT: no allocation. Cost: O(log knots).
  [[nodiscard]] double slope(double x) const noexcept;

 private:
  explicit TransferFunction(std::vector<Knot> knots) : knots_(std::move(knots)) {}
  /// Returns the first knot above x; the end if no knot is above x, or x is NaN.
  [[nodiscard]] std::vector<Knot>::const_iterator above(double x) const noexcept;

  std::vector<Knot> knots_;
};

}  // namespace palpate
