#include "tests/support/json_schema.h"

#include <nlohmann/json.hpp>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validator.hpp>

namespace palpate {

std::optional<SchemaComplaint> schemaComplaint(const nlohmann::json& json,
                                               const std::string& schema) {
  const nlohmann::json text = nlohmann::json::parse(schema);
  valijson::Schema parsed;
  valijson::SchemaParser parser;
  parser.populateSchema(valijson::adapters::NlohmannJsonAdapter(text), parsed);
  valijson::Validator validator;
  valijson::ValidationResults results;
  if (validator.validate(parsed, valijson::adapters::NlohmannJsonAdapter(json), &results)) {
    return std::nullopt;
  }
  valijson::ValidationResults::Error error;
  results.popError(error);
  SchemaComplaint complaint{"", error.description};
  for (const std::string& part : error.context) complaint.path += part;
  return complaint;
}

}  // namespace palpate
