#include "palpate/bench/methods/map_methods.h"

#include <span>

#include "palpate/bench/methods/constraint_approach.h"
#include "palpate/bench/methods/euler_adaptive.h"
#include "palpate/bench/methods/euler_fixed.h"
#include "palpate/bench/methods/force_function.h"
#include "palpate/bench/methods/nelder_mead.h"
#include "palpate/bench/methods/smallest_residual.h"

namespace palpate {
namespace {

/// Wraps a method of the literature, with its default setting or with `params`.
template <class... Params>
MapBalance placedBy(methods::Balance (*method)(const Vec3&, double, std::span<const Primitive>,
                                               const Vec3&, const Params&...) noexcept,
                    const Params&... params) {
  return [=](const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
             const Vec3& start) {
    return method(probe, stiffness, primitives, start, params...).offset;
  };
}

}  // namespace

std::vector<MapMethod> methodsOver(const MapContact& contact) {
  methods::EulerFixedParams fixed;
  fixed.step = 1e-2;
  fixed.max_iterations = 2000;
  methods::NelderMeadParams simplex;
  simplex.tolerance = 1e-8;
  methods::SmallestResidualParams smallest;
  smallest.tolerance = 1e-8;
  return {solverOver(contact),
          wrapBalance(contact, "constraint approach", placedBy(methods::constraintApproach)),
          wrapBalance(contact, "force function", placedBy(methods::forceFunction)),
          wrapBalance(contact, "Euler, fixed step", placedBy(methods::eulerFixed, fixed)),
          wrapBalance(contact, "Euler, adaptive step",
                      placedBy(methods::eulerAdaptive, methods::EulerAdaptiveParams{})),
          wrapBalance(contact, "Nelder-Mead", placedBy(methods::nelderMead, simplex)),
          wrapBalance(contact, "smallest residual", placedBy(methods::smallestResidual, smallest))};
}

}  // namespace palpate
