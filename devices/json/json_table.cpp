#include "palpate/devices/json/json_table.h"

#include <regex>

namespace palpate {
namespace {

JsonType<double> sizedUpTo(const JsonType<double>& number, double most, const char* unit) {
  JsonType<double> type{number.schema, [read = number.read, most, unit](const JsonNode& node) {
                          (void)read(node);
                          return node.sized(most, unit);
                        }};
  type.schema["maximum"] = most;
  return type;
}

}  // namespace

JsonType<double> jsonNumber() {
  return {{{"type", "number"}}, [](const JsonNode& node) { return node.number(); }};
}

JsonType<double> jsonPositive() {
  return {{{"type", "number"}, {"exclusiveMinimum", 0}},
          [](const JsonNode& node) { return node.positive(); }};
}

JsonType<double> jsonNotNegative() {
  return {{{"type", "number"}, {"minimum", 0}},
          [](const JsonNode& node) { return node.notNegative(); }};
}

JsonType<double> jsonPositiveUpTo(double most, const char* why, const char* remedy) {
  JsonType<double> type =
      jsonPositive().where([most](double value) { return value <= most; }, why, remedy);
  type.schema["maximum"] = most;
  return type;
}

JsonType<double> jsonPositiveUpTo(double most, const char* unit) {
  return sizedUpTo(jsonPositive(), most, unit);
}

JsonType<double> jsonNotNegativeUpTo(double most, const char* unit) {
  return sizedUpTo(jsonNotNegative(), most, unit);
}

JsonType<double> jsonUpTo(double most, const char* unit) {
  return {{{"type", "number"}, {"minimum", -most}, {"maximum", most}},
          [most, unit](const JsonNode& node) { return node.sized(most, unit); }};
}

JsonType<std::string> jsonMatching(const char* pattern, const char* why, const char* remedy) {
  JsonType<std::string> type =
      jsonText().where([expression = std::regex(pattern)](
                           const std::string& text) { return std::regex_match(text, expression); },
                       why, remedy);
  type.schema["pattern"] = pattern;
  return type;
}

JsonType<int> jsonWhole(int least, int most) {
  return {{{"type", "integer"}, {"minimum", least}, {"maximum", most}},
          [least, most](const JsonNode& node) { return node.whole(least, most); }};
}

JsonType<bool> jsonFlag() {
  return {{{"type", "boolean"}}, [](const JsonNode& node) { return node.flag(); }};
}

JsonType<std::string> jsonText() {
  return {{{"type", "string"}}, [](const JsonNode& node) { return node.text(); }};
}

JsonType<std::string> jsonName() {
  return {{{"type", "string"}, {"minLength", 1}}, [](const JsonNode& node) { return node.name(); }};
}

JsonSchema jsonFileSchema(const char* title, const char* description, const JsonSchema& object,
                          const JsonSchema& definitions) {
  JsonSchema schema{{"$schema", "http://json-schema.org/draft-07/schema#"},
                    {"title", title},
                    {"description", description}};
  schema.update(object);
  schema["definitions"] = definitions;
  return schema;
}

}  // namespace palpate
