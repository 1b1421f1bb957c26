#include "palpate/scenes/apps/common/explain_tick.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

namespace palpate::cli {
namespace {

/// A tick with the data that explain it.
struct Told {
  const Opened& opened;
  const Scene& scene;
  Vec3 at;    ///< Position at which the proxy was put [m].
  Vec3 hand;  ///< [m]
  Rest rest;
  StepReport report;
  LimitedForce limited;
  ForceLimits limits;
  double dt = 0.0;
  const StepTrace& trace;
  const ProxyState& state;

  /// Returns the last place where properties were read [m]. After a fault before any reading,
  /// returns the proxy's last place.
  [[nodiscard]] const Vec3& place() const {
    const auto steps = trace.steps();
    const auto last = std::find_if(steps.rbegin(), steps.rend(),
                                   [](const StepTrace::Step& step) { return !step.foreseen; });
    return last == steps.rend() ? rest.report.proxy : last->at;
  }
  /// Returns the proxy before its last move [m]; guides are evaluated from there.
  [[nodiscard]] const Vec3& proxy() const {
    return trace.count == 0 ? rest.report.proxy : trace.steps().back().proxy;
  }
  [[nodiscard]] const Graph& graph() const { return scene.graph; }
  [[nodiscard]] const Properties& properties() const { return state.properties(); }
  [[nodiscard]] std::size_t modes() const { return scene.graph.modes.size(); }
};

const Properties::Scalar& scalarOf(const Told& told, int i) {
  return told.properties().scalars[static_cast<std::size_t>(i)];
}
const Properties::Vector& vectorOf(const Told& told, int i) {
  return told.properties().vectors[static_cast<std::size_t>(i)];
}
const std::string& scalarName(const Told& told, int i) {
  return told.graph().scalar_properties[static_cast<std::size_t>(i)];
}
const std::string& vectorName(const Told& told, int i) {
  return told.graph().vector_properties[static_cast<std::size_t>(i)];
}

/// Returns the place where a field of this motion was read, in the motion's rest frame.
const Vec3& seenFrom(const Told& told, int motion) {
  return motion < 0 ? told.place() : told.state.bodies()[static_cast<std::size_t>(motion)].seen;
}

/// Returns the place of a guide in this tick.
Primitive primitiveOf(const Told& told, const GuideMode& guide) {
  Primitive primitive{guide.shape, guide.position, guide.direction};
  const std::vector<Mode>& modes = told.graph().modes;
  for (std::size_t i = 0; i < modes.size(); ++i) {
    const int motion = told.graph().mode_motions[i];
    if (std::get_if<GuideMode>(&modes[i]) != &guide || motion < 0) continue;
    const Pose& pose = told.state.bodies()[static_cast<std::size_t>(motion)].pose;
    primitive.position = pose(guide.position);
    primitive.direction = pose.vector(guide.direction);
  }
  return primitive;
}

/// Common members of the modes of all kinds.
struct Parts {
  int scalar = -1;  ///< The mode acts where this field has data,
  int vector = -1;  ///< and this one a direction.
  const Transfer* strength = nullptr;
  const Transfer* friction = nullptr;
  const Transfer* viscosity = nullptr;
  double own = 0.0;  ///< Input of factors without a property: a guide's distance to the probe [m].
};

/// Finds the members by the names that modes give them.
template <class M>
Parts partsOf(const Told& /*told*/, const M& m) {
  static_assert(
      std::is_same_v<M, UserMode> || requires { m.strength, m.scalar; } ||
          requires { m.strength, m.vector; } || requires { m.strength, m.skin; },
      "explain knows what a mode reads by these names");
  Parts parts;
  if constexpr (requires { m.scalar; }) parts.scalar = m.scalar;
  if constexpr (requires { m.vector; }) parts.vector = m.vector;
  if constexpr (requires { m.curl; }) parts.vector = m.curl;
  if constexpr (requires { m.skin; }) parts.vector = m.skin.gradient;
  if constexpr (requires { m.skin, m.level; }) parts.scalar = m.skin.value;
  if constexpr (requires { m.strength; }) parts.strength = &m.strength;
  if constexpr (requires { m.friction; }) parts.friction = &m.friction;
  if constexpr (requires { m.viscosity; }) parts.viscosity = &m.viscosity;
  return parts;
}
Parts partsOf(const Told& told, const GuideMode& m) {
  return {-1, -1, &m.strength, nullptr, nullptr, distanceTo(primitiveOf(told, m), told.hand)};
}

/// Reports a material property, factor by factor.
OrderedJson report(const Told& told, const Transfer& transfer, double own) {
  OrderedJson json;
  json["value"] = transfer(told.properties(), own);
  json["factors"] = OrderedJson::array();
  for (const Transfer::Factor& factor : transfer.factors) {
    OrderedJson entry;
    if (factor.scalar >= 0) {
      const Properties::Scalar& input = scalarOf(told, factor.scalar);
      entry["reads"] = scalarName(told, factor.scalar);
      entry["input"] = input.inside ? OrderedJson(input.value) : OrderedJson();
      entry["output"] = input.inside ? factor.curve(input.value) : 0.0;
    } else if (!factor.curve.isConstant()) {
      entry["reads"] = "distance of the hand";
      entry["input"] = own;
      entry["output"] = factor.curve(own);
    } else {
      entry["output"] = factor.curve(0.0);
    }
    json["factors"].push_back(entry);
  }
  return json;
}

/// Explains in words which factor is zero; with several the first.
std::string whyZero(const OrderedJson& transfer) {
  for (const OrderedJson& factor : transfer["factors"]) {
    if (factor["output"].get<double>() != 0.0) continue;
    if (!factor.contains("reads")) return "it has a factor 0";
    const auto reads = factor["reads"].get<std::string>();
    if (factor["input"].is_null()) return reads + " has no data here";
    return fmt::format("0 where {} is {}", reads, shown(factor["input"].get<double>()));
  }
  return "it is 0";
}

/// Returns the names of the fields in a set.
std::vector<std::string> namesOf(const Graph& graph, const FieldSet& set) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < graph.scalar_names.size(); ++i) {
    if ((set.scalars >> i & 1U) != 0) names.push_back(graph.scalar_names[i]);
  }
  for (std::size_t i = 0; i < graph.vector_names.size(); ++i) {
    if ((set.vectors >> i & 1U) != 0) names.push_back(graph.vector_names[i]);
  }
  return names;
}

std::string joined(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

/// Returns the fields with bounds that hold the proxy.
FieldSet fieldsAround(const Told& told) {
  const Graph& graph = told.graph();
  FieldSet set;
  for (std::size_t i = 0; i < graph.scalar_frames.size(); ++i) {
    set.scalars |=
        std::uint64_t{holds(graph.scalar_frames[i].bounds, seenFrom(told, graph.scalar_motions[i]))}
        << i;
  }
  for (std::size_t i = 0; i < graph.vector_frames.size(); ++i) {
    set.vectors |=
        std::uint64_t{holds(graph.vector_frames[i].bounds, seenFrom(told, graph.vector_motions[i]))}
        << i;
  }
  return set;
}

FieldSet without(const FieldSet& all, const FieldSet& less) {
  return {all.scalars & ~less.scalars, all.vectors & ~less.vectors};
}

/// Reports whether one field was read, and why.
OrderedJson fieldReport(const Told& told, const std::string& name, const FieldFrame& frame,
                        int motion, const FieldSet& field, bool inside) {
  const bool around = holds(frame.bounds, seenFrom(told, motion));
  const bool sampled = fieldsAt(told.graph(), told.place(), told.state.bodies()).holds(field);
  OrderedJson json;
  json["field"] = name;
  json["sampled"] = sampled;
  json["inside"] = inside;
  if (!around) {
    json["because"] = "the proxy is outside its bounds";
  } else if (!sampled) {
    json["because"] = "what reads it acts only in the bounds of other fields";
  } else {
    json["because"] = inside ? "it has data here" : "it is read, but has no data here";
  }
  json["bounds"] = {toJson(frame.bounds.lower), toJson(frame.bounds.upper)};
  json["for"] = readersOf(told.graph(), field);
  return json;
}

OrderedJson fieldsReport(const Told& told) {
  const Graph& graph = told.graph();
  OrderedJson json = OrderedJson::array();
  for (const ScalarRead& read : graph.scalar_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    const int vector = std::max(read.gradient, read.cell_gradient);
    const bool inside =
        read.value >= 0 ? scalarOf(told, read.value).inside : vectorOf(told, vector).inside;
    json.push_back(fieldReport(told, graph.scalar_names[i], graph.scalar_frames[i],
                               graph.scalar_motions[i], {std::uint64_t{1} << i, 0}, inside));
  }
  for (const VectorRead& read : graph.vector_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    const int vector = std::max(read.value, read.curl);
    const int scalar = std::max({read.divergence, read.q, read.lambda2});
    const bool inside = vector >= 0 ? vectorOf(told, vector).inside : scalarOf(told, scalar).inside;
    json.push_back(fieldReport(told, graph.vector_names[i], graph.vector_frames[i],
                               graph.vector_motions[i], {0, std::uint64_t{1} << i}, inside));
  }
  return json;
}

OrderedJson propertiesReport(const Told& told) {
  OrderedJson json = OrderedJson::array();
  for (std::size_t i = 0; i < told.graph().scalar_properties.size(); ++i) {
    const Properties::Scalar& scalar = told.properties().scalars[i];
    json.push_back({{"property", told.graph().scalar_properties[i]},
                    {"value", scalar.value},
                    {"inside", scalar.inside}});
  }
  for (std::size_t i = 0; i < told.graph().vector_properties.size(); ++i) {
    const Properties::Vector& vector = told.properties().vectors[i];
    json.push_back({{"property", told.graph().vector_properties[i]},
                    {"value", toJson(vector.value)},
                    {"inside", vector.inside}});
  }
  return json;
}

/// Explains why an isosurface with data, a normal and a strength placed no primitive.
std::string whyIdle(const Told& told, const IsosurfaceMode& iso, const ModeMemory& memory) {
  const double value = scalarOf(told, iso.skin.value).value;
  const std::string is =
      fmt::format("the value here is {}, the surface is at {}", shown(value), shown(iso.level));
  if (sideOf(memory) == Side::kInside) {
    return "not in contact: the proxy is on the solid side, free to move and to leave; " + is;
  }
  return "not in contact: the proxy is on the free side and has not come to the surface; " + is;
}

std::string whyIdle(const Told& told, const Mode& mode, const ModeMemory& memory) {
  if (const auto* iso = std::get_if<IsosurfaceMode>(&mode)) return whyIdle(told, *iso, memory);
  if (const auto* guide = std::get_if<GuideMode>(&mode)) {
    return fmt::format("the proxy is {} m from it, farther than its snap of {} m",
                       shown(distanceTo(primitiveOf(told, *guide), told.proxy())),
                       shown(guide->snap));
  }
  const auto* front = std::get_if<FrontShapeMemory>(&memory.of);
  if (front != nullptr && front->let_go) {
    return "it has let go of its front, and takes the next where the proxy comes to rest";
  }
  if (std::holds_alternative<VortexTubeMode>(mode)) {
    return "the flow does not turn here, or by no more than rounding";
  }
  return "it placed nothing";
}

bool outOfReach(const Told& told, const Mode& mode) {
  const auto* guide = std::get_if<GuideMode>(&mode);
  return guide != nullptr && !(distanceTo(primitiveOf(told, *guide), told.proxy()) <= guide->snap);
}

/// Explains why mode i placed no primitive: its first condition that is not met.
std::string whySilent(const Told& told, std::size_t i, const Parts& parts, const OrderedJson& of) {
  const Graph& graph = told.graph();
  const FieldSet missing = without(graph.mode_fields[i].support, fieldsAround(told));
  if (missing.scalars != 0 || missing.vectors != 0) {
    return "the proxy is outside the bounds of " + joined(namesOf(graph, missing));
  }
  if (parts.scalar >= 0 && !scalarOf(told, parts.scalar).inside) {
    return scalarName(told, parts.scalar) + " has no data here";
  }
  if (parts.vector >= 0 && !vectorOf(told, parts.vector).inside) {
    return vectorName(told, parts.vector) + " has no data here";
  }
  if (parts.vector >= 0 && !(vectorOf(told, parts.vector).value.norm() > 1e-300)) {
    return vectorName(told, parts.vector) + " is zero here and has no direction";
  }
  if (!outOfReach(told, graph.modes[i]) && of.contains("strength") &&
      of["strength"]["value"].get<double>() == 0.0) {
    return "its strength is zero here: " + whyZero(of["strength"]);
  }
  return whyIdle(told, graph.modes[i], told.state.memory(i));
}

/// Returns the role of a mode's primitive.
const char* roleOf(const Mode& mode, const Load& load) {
  if (load.friction) return "friction";
  const bool body =
      std::holds_alternative<SurfaceMode>(mode) || std::holds_alternative<IsosurfaceMode>(mode);
  if (!body) return wordFor(load.primitive.kind);
  return load.primitive.kind == PrimitiveKind::kPoint ? "viscosity" : "surface";
}

OrderedJson report(const Mode& mode, const Load& load) {
  const Primitive& primitive = load.primitive;
  const double size = load.force.norm();
  OrderedJson json;
  json["role"] = roleOf(mode, load);
  json["kind"] = wordFor(primitive.kind);
  if (primitive.kind != PrimitiveKind::kForce) json["position"] = toJson(primitive.position);
  if (primitive.kind != PrimitiveKind::kPoint) json["direction"] = toJson(primitive.direction);
  json["strength"] = primitive.strength;
  if (load.friction) json["coefficient"] = load.coefficient;
  json["load"] = toJson(load.force);
  json["size"] = size;
  json["share"] = primitive.strength > 0.0 ? OrderedJson(size / primitive.strength) : OrderedJson();
  json["state"] = wordFor(load.hold, load.friction);
  return json;
}

/// Returns text such as "holds with 0.5 of 3 N".
std::string words(Hold hold, bool friction, double size, double strength) {
  const std::string state = wordFor(hold, friction);
  if (hold == Hold::kHolds) {
    return fmt::format("{} with {} of {} N", state, shown(size), shown(strength));
  }
  return fmt::format("{} {} {} N", state, hold == Hold::kPushes ? "with" : "at", shown(size));
}
std::string words(const Load& load) {
  return words(load.hold, load.friction, load.force.norm(), load.primitive.strength);
}

/// Returns the direction of a primitive's force, in words.
const char* whither(PrimitiveKind kind) {
  switch (kind) {
    case PrimitiveKind::kPlane:
      return " along its normal";
    case PrimitiveKind::kLine:
      return " across its direction";
    case PrimitiveKind::kForce:
      return " along its direction";
    case PrimitiveKind::kPoint:
      break;
  }
  return "";
}

/// Returns true for two planes that hold in both directions.
bool isSlab(const std::vector<Load>& loads) {
  return loads.size() == 2 && loads[0].primitive.kind == PrimitiveKind::kPlane &&
         loads[1].primitive.kind == PrimitiveKind::kPlane &&
         loads[0].primitive.direction == -loads[1].primitive.direction;
}

/// Returns text such as "bone holds with 1.2 of 3 N along its normal, its friction sticks with 0.2
/// of 0.36 N"; empty if the mode carries no load.
std::string loadsInWords(const std::string& name, const Mode& mode,
                         const std::vector<Load>& loads) {
  if (isSlab(loads)) {
    const Hold hold = holdOf(loads);
    if (hold == Hold::kIdle) return "";
    return name + " " + words(hold, false, totalOf(loads).norm(), loads[0].primitive.strength) +
           whither(PrimitiveKind::kPlane);
  }
  std::string text;
  for (const Load& load : loads) {
    if (load.hold == Hold::kIdle) continue;
    const std::string role = roleOf(mode, load);
    const bool aside = role == "friction" || role == "viscosity";
    if (text.empty()) {
      text = aside ? fmt::format("{}'s {}", name, role) : name;
    } else {
      text += aside ? ", its " + role : ", and";
    }
    text += " " + words(load) + (aside ? "" : whither(load.primitive.kind));
  }
  return text;
}

OrderedJson modeReport(const Told& told, std::size_t i) {
  const Mode& mode = told.graph().modes[i];
  const ModeSpec& spec = told.opened.told.graph.modes[told.graph().mode_sources[i]];
  const Parts parts = std::visit([&](const auto& m) { return partsOf(told, m); }, mode);
  const std::vector<Load> loads = loadsOf(told.state, told.report, i);
  OrderedJson json;
  json["name"] = told.graph().mode_names[i];
  json["mode"] = wordFor(spec.kind);
  json["of"] = spec.of.empty() ? OrderedJson() : OrderedJson(spec.of);
  json["active"] = !loads.empty();
  json["because"] = "";  // placed here for reading order; set at the end
  json["contact"] = std::holds_alternative<IsosurfaceMode>(mode)
                        ? OrderedJson(wordFor(sideOf(told.state.memory(i))))
                        : OrderedJson();
  json["state"] = wordFor(holdOf(loads));
  json["load"] = toJson(totalOf(loads));
  if (parts.strength != nullptr) json["strength"] = report(told, *parts.strength, parts.own);
  if (parts.friction != nullptr && !parts.friction->factors.empty()) {
    json["friction"] = report(told, *parts.friction, parts.own);
  }
  if (parts.viscosity != nullptr && !parts.viscosity->factors.empty()) {
    json["viscosity"] = report(told, *parts.viscosity, parts.own);
  }
  json["primitives"] = OrderedJson::array();
  for (const Load& load : loads) json["primitives"].push_back(report(mode, load));
  const std::string carries = loadsInWords(told.graph().mode_names[i], mode, loads);
  if (loads.empty()) {
    json["because"] = whySilent(told, i, parts, json);
  } else {
    json["because"] = carries.empty() ? "it is there, but nothing presses on it" : carries;
  }
  return json;
}

/// Reports the balance of the spring and the loads.
OrderedJson balanceReport(const Told& told) {
  const StepReport& r = told.report;
  const Vec3 spring = r.stiffness * (r.proxy - told.hand);
  Vec3 sum = Vec3::Zero();
  for (std::size_t i = 0; i < told.modes(); ++i) {
    sum += totalOf(loadsOf(told.state, r, i));
  }
  OrderedJson json;
  json["status"] = wordFor(r.status);
  json["solver"] = wordFor(r.solver);
  json["iterations"] = r.iterations;
  json["substeps"] = r.substeps;
  json["error_bound"] = r.error_bound;
  json["stiffness"] = r.stiffness;
  if (!told.graph().stiffness.factors.empty()) {
    json["stiffness_by"] = report(told, told.graph().stiffness, 0.0);
    json["stiffness_by"]["value"] = told.graph().stiffness.anywhere(told.properties());
  }
  json["proxy"] = toJson(r.proxy);
  json["spring"] = toJson(spring);
  json["loads"] = toJson(sum);
  const Vec3 waiting = r.stiffness * r.waiting;
  json["waiting"] = toJson(waiting);
  json["left_over"] = (sum + waiting - spring).norm();
  json["injected_energy"] = r.injected;
  return json;
}

/// Reports the force from the spring to the output.
OrderedJson forceReport(const Told& told) {
  const StepReport& r = told.report;
  const Vec3 spring = r.stiffness * (r.proxy - told.hand);
  OrderedJson json;
  json["spring"] = toJson(spring);
  json["damper"] =
      toJson(told.scene.coupling.damping > 0.0 ? Vec3(r.wanted - spring) : Vec3(Vec3::Zero()));
  json["wanted"] = toJson(r.wanted);
  json["limiter"] = {{"acted", r.limited},
                     {"peaked", told.limited.peaked},
                     {"slewed", told.limited.slewed},
                     {"peak", told.limits.peak},
                     {"growth", told.limits.slew * told.dt}};
  json["sent"] = toJson(r.force);
  json["size"] = r.force.norm();
  return json;
}

/// Explains the limiter's action; empty if there was no action.
std::string limiterWords(const Told& told) {
  if (told.limited.slewed) {
    return fmt::format("the limiter lets it grow by {} N a tick",
                       shown(told.limits.slew * told.dt));
  }
  if (told.limited.peaked)
    return fmt::format("the limiter's peak is {} N", shown(told.limits.peak));
  return "";
}

/// Describes the modes' loads, one after the other.
std::string whoHolds(const Told& told) {
  std::string who;
  for (std::size_t i = 0; i < told.modes(); ++i) {
    const std::string carries = loadsInWords(told.graph().mode_names[i], told.graph().modes[i],
                                             loadsOf(told.state, told.report, i));
    if (!carries.empty()) who += (who.empty() ? "" : "; ") + carries;
  }
  return who.empty() ? "Nothing holds the proxy." : who + ".";
}

/// Describes the force from the spring to the output.
std::string whatIsSent(const Told& told) {
  const StepReport& r = told.report;
  const double length = (r.proxy - told.hand).norm();
  const double spring = r.stiffness * length;
  constexpr double kNothing = 1e-9;  // [N]
  if (spring < kNothing) return "The proxy goes with the hand: there is no force.";
  std::string text =
      fmt::format("The proxy is {} m from the hand, and the spring of {} N/m pulls with {} N",
                  shown(length), shown(r.stiffness), shown(spring));
  if (told.scene.coupling.damping > 0.0) {
    const double damper = r.wanted.norm() - spring;
    text += fmt::format(", its damper with {} N", shown(damper));
    if (damper > 0.999 * spring) text += " (its most: the whole push is made in one tick)";
  }
  const std::string limiter = limiterWords(told);
  if (!limiter.empty()) text += fmt::format("; {}: {} N is sent", limiter, shown(r.force.norm()));
  return text + ".";
}

/// Explains the force in a sentence or two.
OrderedJson because(const Told& told) {
  const StepStatus status = told.report.status;
  OrderedJson json = OrderedJson::array();
  if (status == StepStatus::kFault) {
    json.push_back("A number was not finite: the force is cut.");
    return json;
  }
  json.push_back(whoHolds(told));
  json.push_back(whatIsSent(told));
  if (status == StepStatus::kSubstepLimit) {
    json.push_back(
        "The proxy has not arrived: the push is longer than the sub-steps of one tick allow, and "
        "the rest of the way waits.");
  } else if (status == StepStatus::kHairpin) {
    json.push_back(
        "A stream turns about a place that is nearer than the hand: the proxy may jump along it.");
  } else if (status == StepStatus::kDropped) {
    json.push_back("There were more primitives than fit: some were left out.");
  }
  return json;
}

/// Reports one balance of the tick, and how far the proxy, or the next reading, went from it.
OrderedJson stepReport(const Told& told, const StepTrace::Step& step) {
  OrderedJson json;
  json["foreseen"] = step.foreseen;
  json["at"] = toJson(step.at);
  json["proxy"] = toJson(step.proxy);
  json["balance"] = toJson(step.balance);
  json["newton"] = toJson(step.newton);
  json["end"] = wordFor(step.end);
  json["went"] = toJson(step.went);
  json["yields"] = OrderedJson::array();
  for (std::size_t i = 0; i < told.modes(); ++i) {
    if (step.yields.test(i)) json["yields"].push_back(told.graph().mode_names[i]);
  }
  return json;
}

OrderedJson report(const Told& told) {
  OrderedJson json;
  json["scene"] = told.opened.spec.source;
  json["at"] = toJson(told.at);
  json["hand"] = toJson(told.hand);
  json["rate"] = 1.0 / told.dt;
  json["rest"] = {{"proxy", toJson(told.rest.report.proxy)},
                  {"moved", (told.rest.report.proxy - told.at).norm()},
                  {"force", toJson(told.rest.report.force)},
                  {"ticks", told.rest.ticks}};
  json["read_at"] = OrderedJson::array();
  for (const StepTrace::Step& step : told.trace.steps()) {
    if (!step.foreseen) json["read_at"].push_back(toJson(step.at));
  }
  json["steps"] = OrderedJson::array();
  for (const StepTrace::Step& step : told.trace.steps())
    json["steps"].push_back(stepReport(told, step));
  json["fields"] = fieldsReport(told);
  json["left_out"] = told.graph().unused;
  json["properties"] = propertiesReport(told);
  json["modes"] = OrderedJson::array();
  for (std::size_t i = 0; i < told.modes(); ++i) json["modes"].push_back(modeReport(told, i));
  json["silent"] = told.graph().silent;
  json["balance"] = balanceReport(told);
  json["force"] = forceReport(told);
  json["because"] = because(told);
  return json;
}

}  // namespace

Explained explainTick(SceneSpec spec, const Vec3& at, const Vec3& push, double rate,
                      const Progress& progress, const Say& say) {
  checkRate("rate", rate);
  checkReach("at", at);
  const Vec3 hand = at + push;
  checkReach("push", hand);
  const double dt = 1.0 / rate;
  const ForceLimits limits = pathLimits();
  const auto trial = [&](const BuiltScene& built) {
    Near near;
    Reader reader;
    ProxyState state(limits);
    near.add(state, restAt(*built.scene, reader, state, at, dt).report);
    near.add(state, hapticStep(*built.scene, reader, {hand}, state, dt));
    return near;
  };
  const Opened opened = openFor(std::move(spec), trial, progress, say);
  const Scene& scene = *opened.built.scene;

  Reader reader;
  ProxyState state(limits);
  const Rest rest = restAt(scene, reader, state, at, dt);
  StepTrace trace;
  const StepReport report = hapticStep(scene, reader, {hand}, state, dt, &trace);
  LimiterState limiter;
  limiter.sent = rest.report.force;
  const LimitedForce limited = limitForce(report.wanted, hand, dt, limits, limiter);
  const Told told{opened, scene, at, hand, rest, report, limited, limits, dt, trace, state};
  return {cli::report(told), report.status == StepStatus::kFault};
}

}  // namespace palpate::cli
