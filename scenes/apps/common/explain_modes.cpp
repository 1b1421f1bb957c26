#include <cstddef>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include <fmt/format.h>

#include "palpate/scenes/apps/common/explain_parts.h"

namespace palpate::cli {
namespace {

const std::string& scalarName(const ExplainedTick& tick, int i) {
  return tick.graph().scalar_properties[static_cast<std::size_t>(i)];
}
const std::string& vectorName(const ExplainedTick& tick, int i) {
  return tick.graph().vector_properties[static_cast<std::size_t>(i)];
}

/// Returns the primitive of a guide, at its pose in this tick.
Primitive primitiveOf(const ExplainedTick& tick, const GuideMode& guide) {
  Primitive primitive{guide.shape, guide.position, guide.direction};
  const std::vector<Mode>& modes = tick.graph().modes;
  for (std::size_t i = 0; i < modes.size(); ++i) {
    const int motion = tick.graph().mode_motions[i];
    if (std::get_if<GuideMode>(&modes[i]) != &guide || motion < 0) continue;
    const Pose& pose = tick.state.bodies()[static_cast<std::size_t>(motion)].pose;
    primitive.position = pose(guide.position);
    primitive.direction = pose.vector(guide.direction);
  }
  return primitive;
}

struct Parts {
  int scalar = -1;  ///< Scalar property that must have data; -1: none.
  int vector = -1;  ///< Vector property that must have a direction; -1: none.
  const Transfer* strength = nullptr;
  const Transfer* friction = nullptr;
  const Transfer* viscosity = nullptr;
  double own = 0.0;  ///< Input of factors without a property: a guide's distance to the hand [m].
};

template <class M>
Parts partsOf(const ExplainedTick& /*tick*/, const M& m) {
  static_assert(
      std::is_same_v<M, UserMode> || requires { m.strength, m.scalar; } ||
          requires { m.strength, m.vector; } || requires { m.strength, m.skin; },
      "partsOf() does not know the members of this mode: add an overload");
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
Parts partsOf(const ExplainedTick& tick, const GuideMode& m) {
  return {-1, -1, &m.strength, nullptr, nullptr, distanceTo(primitiveOf(tick, m), tick.hand)};
}

/// Names the first factor of a transfer function whose output is zero.
std::string whyZero(const OrderedJson& transfer) {
  for (const OrderedJson& factor : transfer["factors"]) {
    if (factor["output"].get<double>() != 0.0) continue;
    if (!factor.contains("reads")) return "a constant factor is 0";
    const auto reads = factor["reads"].get<std::string>();
    if (factor["input"].is_null()) return reads + " has no data here";
    return fmt::format("a factor is 0 where {} is {}", reads, shown(factor["input"].get<double>()));
  }
  return "the product of its factors is 0";
}

std::vector<std::string> fieldNames(const Graph& graph, const FieldSet& set) {
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

FieldSet without(const FieldSet& all, const FieldSet& less) {
  return {all.scalars & ~less.scalars, all.vectors & ~less.vectors};
}

/// Explains why an isosurface mode has no primitive although it has data, a normal and a strength.
std::string whyIdle(const ExplainedTick& tick, const IsosurfaceMode& iso,
                    const ModeMemory& memory) {
  const double value = scalarAt(tick, iso.skin.value).value;
  const std::string is =
      fmt::format("the value here is {}, the surface is at {}", shown(value), shown(iso.level));
  if (sideOf(memory) == Side::kInside) {
    return "not in contact: the proxy is on the solid side, where it moves freely and can leave; " +
           is;
  }
  return "not in contact: the proxy is on the free side and has not reached the surface; " + is;
}

std::string whyIdle(const ExplainedTick& tick, const Mode& mode, const ModeMemory& memory) {
  if (const auto* iso = std::get_if<IsosurfaceMode>(&mode)) return whyIdle(tick, *iso, memory);
  if (const auto* guide = std::get_if<GuideMode>(&mode)) {
    return fmt::format("the proxy is {} m from the guide, farther than the snap of {} m",
                       shown(distanceTo(primitiveOf(tick, *guide), tick.proxy())),
                       shown(guide->snap));
  }
  const auto* front = std::get_if<FrontShapeMemory>(&memory.of);
  if (front != nullptr && front->let_go) {
    return "the mode has released its front and takes the next one where the proxy comes to rest";
  }
  if (std::holds_alternative<VortexTubeMode>(mode)) {
    return "the flow does not rotate here, except for rounding errors";
  }
  return "the mode placed no primitive";
}

bool outOfReach(const ExplainedTick& tick, const Mode& mode) {
  const auto* guide = std::get_if<GuideMode>(&mode);
  return guide != nullptr && !(distanceTo(primitiveOf(tick, *guide), tick.proxy()) <= guide->snap);
}

/// Describes the first reason why mode i has no primitive.
std::string whySilent(const ExplainedTick& tick, std::size_t i, const Parts& parts,
                      const OrderedJson& of) {
  const Graph& graph = tick.graph();
  const FieldSet missing = without(graph.mode_fields[i].support, fieldsAround(tick));
  if (missing.scalars != 0 || missing.vectors != 0) {
    return "the proxy is outside the bounds of " + joined(fieldNames(graph, missing));
  }
  if (parts.scalar >= 0 && !scalarAt(tick, parts.scalar).inside) {
    return scalarName(tick, parts.scalar) + " has no data here";
  }
  if (parts.vector >= 0 && !vectorAt(tick, parts.vector).inside) {
    return vectorName(tick, parts.vector) + " has no data here";
  }
  if (parts.vector >= 0 && !(vectorAt(tick, parts.vector).value.norm() > 1e-300)) {
    return vectorName(tick, parts.vector) + " is zero here and has no direction";
  }
  if (!outOfReach(tick, graph.modes[i]) && of.contains("strength") &&
      of["strength"]["value"].get<double>() == 0.0) {
    return "its strength is zero here: " + whyZero(of["strength"]);
  }
  return whyIdle(tick, graph.modes[i], tick.state.memory(i));
}

const char* roleOf(const Mode& mode, const Load& load) {
  if (load.friction) return "friction";
  const bool body =
      std::holds_alternative<SurfaceMode>(mode) || std::holds_alternative<IsosurfaceMode>(mode);
  if (!body) return wordFor(load.primitive.kind);
  return load.primitive.kind == PrimitiveKind::kPoint ? "viscosity" : "surface";
}

OrderedJson loadReport(const Mode& mode, const Load& load) {
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

const char* directionWords(PrimitiveKind kind) {
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

/// Returns true for two opposed planes, which hold the proxy from both sides.
bool isSlab(const std::vector<Load>& loads) {
  return loads.size() == 2 && loads[0].primitive.kind == PrimitiveKind::kPlane &&
         loads[1].primitive.kind == PrimitiveKind::kPlane &&
         loads[0].primitive.direction == -loads[1].primitive.direction;
}

}  // namespace

OrderedJson transferReport(const ExplainedTick& tick, const Transfer& transfer, double own) {
  OrderedJson json;
  json["value"] = transfer(tick.properties(), own);
  json["factors"] = OrderedJson::array();
  for (const Transfer::Factor& factor : transfer.factors) {
    OrderedJson entry;
    if (factor.scalar >= 0) {
      const Properties::Scalar& input = scalarAt(tick, factor.scalar);
      entry["reads"] = scalarName(tick, factor.scalar);
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

std::string loadsInWords(const std::string& name, const Mode& mode,
                         const std::vector<Load>& loads) {
  if (isSlab(loads)) {
    const Hold hold = holdOf(loads);
    if (hold == Hold::kIdle) return "";
    return name + " " + words(hold, false, totalOf(loads).norm(), loads[0].primitive.strength) +
           directionWords(PrimitiveKind::kPlane);
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
    text += " " + words(load) + (aside ? "" : directionWords(load.primitive.kind));
  }
  return text;
}

OrderedJson modeReport(const ExplainedTick& tick, std::size_t i) {
  const Mode& mode = tick.graph().modes[i];
  const ModeSpec& spec = tick.opened.told.graph.modes[tick.graph().mode_sources[i]];
  const Parts parts = std::visit([&](const auto& m) { return partsOf(tick, m); }, mode);
  const std::vector<Load> loads = loadsOf(tick.state, tick.report, i);
  OrderedJson json;
  json["name"] = tick.graph().mode_names[i];
  json["mode"] = wordFor(spec.kind);
  json["of"] = spec.of.empty() ? OrderedJson() : OrderedJson(spec.of);
  json["active"] = !loads.empty();
  json["because"] = "";  // set below; inserted here for the order of the keys
  json["contact"] = std::holds_alternative<IsosurfaceMode>(mode)
                        ? OrderedJson(wordFor(sideOf(tick.state.memory(i))))
                        : OrderedJson();
  json["state"] = wordFor(holdOf(loads));
  json["load"] = toJson(totalOf(loads));
  if (parts.strength != nullptr)
    json["strength"] = transferReport(tick, *parts.strength, parts.own);
  if (parts.friction != nullptr && !parts.friction->factors.empty()) {
    json["friction"] = transferReport(tick, *parts.friction, parts.own);
  }
  if (parts.viscosity != nullptr && !parts.viscosity->factors.empty()) {
    json["viscosity"] = transferReport(tick, *parts.viscosity, parts.own);
  }
  json["primitives"] = OrderedJson::array();
  for (const Load& load : loads) json["primitives"].push_back(loadReport(mode, load));
  const std::string carries = loadsInWords(tick.graph().mode_names[i], mode, loads);
  if (loads.empty()) {
    json["because"] = whySilent(tick, i, parts, json);
  } else {
    json["because"] =
        carries.empty() ? "the mode placed primitives, but they carry no load" : carries;
  }
  return json;
}

}  // namespace palpate::cli
