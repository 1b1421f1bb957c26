/// Checks JSON against a JSON Schema with valijson.
#pragma once

#include <optional>
#include <string>

#include <nlohmann/json_fwd.hpp>

namespace palpate {

/// The reason why a schema rejects a value.
struct SchemaComplaint {
  std::string path;  ///< JSON path of the rejected part.
  std::string what;
};

/// Returns the schema's first complaint, or std::nullopt if the schema accepts the value. Slow.
/// @param schema  JSON Schema as text. Throws nlohmann::json::exception if it is not JSON.
[[nodiscard]] std::optional<SchemaComplaint> schemaComplaint(const nlohmann::json& json,
                                                             const std::string& schema);

}  // namespace palpate
