/// What a JSON Schema says of a value, by valijson.
#pragma once

#include <optional>
#include <string>

#include <nlohmann/json_fwd.hpp>

namespace palpate {

/// What a schema has against a value.
struct SchemaComplaint {
  std::string path;  ///< Of the part that it does not accept.
  std::string what;
};

/// The schema's first complaint; nothing where it accepts the value. Slow: when files are read.
///
/// @param schema  A JSON Schema, as text; throws nlohmann::json::exception where it is no JSON.
[[nodiscard]] std::optional<SchemaComplaint> schemaComplaint(const nlohmann::json& json,
                                                             const std::string& schema);

}  // namespace palpate
