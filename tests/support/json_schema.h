/// Checks a value against a JSON Schema, by valijson.
#pragma once

#include <optional>
#include <string>

#include <nlohmann/json_fwd.hpp>

namespace palpate {

/// Why a schema rejects a value.
struct SchemaComplaint {
  std::string path;  ///< Path of the rejected part.
  std::string what;
};

/// Returns the schema's first complaint, or std::nullopt if the schema accepts the value. Slow.
///
/// @param schema  A JSON Schema, as text; throws nlohmann::json::exception if the text is not JSON.
[[nodiscard]] std::optional<SchemaComplaint> schemaComplaint(const nlohmann::json& json,
                                                             const std::string& schema);

}  // namespace palpate
