#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "palpate/scenes/apps/common/explain_parts.h"

namespace palpate::cli {
namespace {

/// Returns the position at which fields with this motion were read, in their rest pose.
const Vec3& seenFrom(const ExplainedTick& tick, int motion) {
  return motion < 0 ? tick.place() : tick.state.bodies()[static_cast<std::size_t>(motion)].seen;
}

OrderedJson fieldReport(const ExplainedTick& tick, const std::string& name, const FieldFrame& frame,
                        int motion, const FieldSet& field, bool inside) {
  const bool around = holds(frame.bounds, seenFrom(tick, motion));
  const bool sampled = fieldsAt(tick.graph(), tick.place(), tick.state.bodies()).holds(field);
  OrderedJson json;
  json["field"] = name;
  json["sampled"] = sampled;
  json["inside"] = inside;
  if (!around) {
    json["because"] = "the proxy is outside the bounds of the field";
  } else if (!sampled) {
    json["because"] =
        "each mode that reads the field also needs a field whose bounds exclude the proxy";
  } else {
    json["because"] = inside ? "it has data here" : "it has no data here";
  }
  json["bounds"] = {toJson(frame.bounds.lower), toJson(frame.bounds.upper)};
  json["for"] = readersOf(tick.graph(), field);
  return json;
}

}  // namespace

FieldSet fieldsAround(const ExplainedTick& tick) {
  const Graph& graph = tick.graph();
  FieldSet set;
  for (std::size_t i = 0; i < graph.scalar_frames.size(); ++i) {
    set.scalars |=
        std::uint64_t{holds(graph.scalar_frames[i].bounds, seenFrom(tick, graph.scalar_motions[i]))}
        << i;
  }
  for (std::size_t i = 0; i < graph.vector_frames.size(); ++i) {
    set.vectors |=
        std::uint64_t{holds(graph.vector_frames[i].bounds, seenFrom(tick, graph.vector_motions[i]))}
        << i;
  }
  return set;
}

OrderedJson fieldsReport(const ExplainedTick& tick) {
  const Graph& graph = tick.graph();
  OrderedJson json = OrderedJson::array();
  for (const ScalarRead& read : graph.scalar_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    const int vector = std::max(read.gradient, read.cell_gradient);
    const bool inside =
        read.value >= 0 ? scalarAt(tick, read.value).inside : vectorAt(tick, vector).inside;
    json.push_back(fieldReport(tick, graph.scalar_names[i], graph.scalar_frames[i],
                               graph.scalar_motions[i], {std::uint64_t{1} << i, 0}, inside));
  }
  for (const VectorRead& read : graph.vector_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    const int vector = std::max(read.value, read.curl);
    const int scalar = std::max({read.divergence, read.q, read.lambda2});
    const bool inside = vector >= 0 ? vectorAt(tick, vector).inside : scalarAt(tick, scalar).inside;
    json.push_back(fieldReport(tick, graph.vector_names[i], graph.vector_frames[i],
                               graph.vector_motions[i], {0, std::uint64_t{1} << i}, inside));
  }
  return json;
}

OrderedJson propertiesReport(const ExplainedTick& tick) {
  OrderedJson json = OrderedJson::array();
  for (std::size_t i = 0; i < tick.graph().scalar_properties.size(); ++i) {
    const Properties::Scalar& scalar = tick.properties().scalars[i];
    json.push_back({{"property", tick.graph().scalar_properties[i]},
                    {"value", scalar.value},
                    {"inside", scalar.inside}});
  }
  for (std::size_t i = 0; i < tick.graph().vector_properties.size(); ++i) {
    const Properties::Vector& vector = tick.properties().vectors[i];
    json.push_back({{"property", tick.graph().vector_properties[i]},
                    {"value", toJson(vector.value)},
                    {"inside", vector.inside}});
  }
  return json;
}

}  // namespace palpate::cli
