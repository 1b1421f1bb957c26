#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/balance/solver.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

using namespace pybind11::literals;

namespace {

Primitive primitiveOf(const std::string& kind, const Doubles& position, const Doubles& direction,
                      double strength) {
  Primitive primitive;
  bool known = false;
  for (const PrimitiveKind k : {PrimitiveKind::kForce, PrimitiveKind::kPoint, PrimitiveKind::kLine,
                                PrimitiveKind::kPlane}) {
    if (kind != wordFor(k)) continue;
    primitive.kind = k;
    known = true;
  }
  if (!known)
    throw Error("kind", "\"" + kind + "\" is not known", "use force, point, line or plane");
  if (!(strength >= 0.0) || !std::isfinite(strength)) {
    throw Error("strength", "it is negative or not finite", "give a finite force of at least 0 N");
  }
  primitive.strength = strength;
  primitive.position = vectorOf(position, "position");
  if (primitive.kind != PrimitiveKind::kPoint) {
    const Vec3 q = vectorOf(direction, "direction");
    const double length = q.stableNorm();
    if (!(length > 0.0) || !std::isfinite(length)) {
      throw Error("direction", "it is zero or not finite", "give a finite vector that is not zero");
    }
    primitive.direction = (q / length).normalized();
  }
  return primitive;
}

py::dict solve(double stiffness, const Doubles& probe, const std::vector<Primitive>& primitives,
               const std::optional<Doubles>& start) {
  const Vec3 from = vectorOf(probe, "probe");
  const SolveResult result =
      solveProxy(from, stiffness, primitives, start ? vectorOf(*start, "start") : from);
  if (result.status == SolveStatus::kBadInput) {
    if (!(stiffness > 0.0)) {
      throw Error("solve", "the stiffness is not above 0", "give a stiffness in N/m, such as 500");
    }
    if (primitives.size() > kMaxPrimitives) {
      const std::string most = std::to_string(kMaxPrimitives);
      throw Error("solve", "there are more than " + most + " primitives", "give at most " + most);
    }
    throw Error("solve", "a number is not finite or overflows",
                "give finite values in metres, newtons and N/m");
  }
  py::dict dict;
  dict["proxy"] = tupleOf(result.proxy);
  dict["force"] = tupleOf(Vec3(stiffness * result.offset));
  dict["error_bound"] = result.error_bound;
  dict["iterations"] = result.iterations;
  dict["solver"] = result.solver == SolverKind::kClosedForm ? "closed-form" : "general";
  dict["status"] = result.status == SolveStatus::kConverged ? "converged" : "iteration-limit";
  return dict;
}

}  // namespace

void bindBalance(py::module_& m) {
  py::class_<Primitive>(m, "Primitive",
                        "A constraint on the proxy: a directed force, a point, a line or a plane.")
      .def(py::init(&primitiveOf), "kind"_a, "position"_a = std::array<double, 3>{0.0, 0.0, 0.0},
           "direction"_a = std::array<double, 3>{1.0, 0.0, 0.0}, "strength"_a = 1.0,
           "`kind` is force, point, line or plane; `position` is in metres, `strength` in newtons.")
      .def_property_readonly("kind", [](const Primitive& p) { return wordFor(p.kind); })
      .def_property_readonly("position", [](const Primitive& p) { return tupleOf(p.position); })
      .def_property_readonly("direction", [](const Primitive& p) { return tupleOf(p.direction); })
      .def_readonly("strength", &Primitive::strength);

  m.def("solve", &solve, "stiffness"_a, "probe"_a, "primitives"_a, "start"_a = py::none(),
        "Finds the proxy at which the primitives balance a spring of this stiffness [N/m] to the "
        "probe [m]. Returns a dict: proxy, force on the hand, error_bound, iterations, solver, "
        "status.");
}

}  // namespace palpate::python
