/// Private to devices and scenes: tables of the keys and values that a JSON file may have. A table
/// reads and checks a file, and generates the file's JSON Schema. Slow: not for a tick.
#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <cstddef>
#include <functional>
#include <initializer_list>
#include <limits>
#include <map>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "palpate/devices/json/json_node.h"

namespace palpate {

/// A JSON Schema, draft 7; keeps its keys in the order of insertion.
using JsonSchema = nlohmann::ordered_json;

/// A value's schema and reader. `read` rejects every value that the schema rejects.
template <class T>
struct JsonType {
  JsonSchema schema;
  std::function<T(const JsonNode&)> read;

  [[nodiscard]] JsonType says(const char* description) const {
    JsonType type = *this;
    type.schema["description"] = description;
    return type;
  }
  [[nodiscard]] JsonType also(const JsonSchema& more) const {
    JsonType type = *this;
    type.schema.update(more);
    return type;
  }
  template <class U, class Make>
  [[nodiscard]] JsonType<U> as(Make make) const {
    return {schema, [read = read, make](const JsonNode& node) -> U { return make(read(node)); }};
  }
  /// Returns a type that also rejects values for which `good` is false. The schema omits this
  /// condition.
  template <class Good>
  [[nodiscard]] JsonType where(Good good, const char* why, const char* remedy) const {
    return {schema, [read = read, good, why, remedy](const JsonNode& node) {
              T value = read(node);
              if (!good(value)) node.fail(why, remedy);
              return value;
            }};
  }
  /// Adds the schema to `definitions`. The returned type's schema refers to this definition by
  /// `name`.
  [[nodiscard]] JsonType defined(const char* name, JsonSchema& definitions) const {
    definitions[name] = schema;
    return {{{"$ref", std::string("#/definitions/") + name}}, read};
  }
};

// Types of single values. Types with Positive in their name exclude 0; all other ranges include
// both ends.

[[nodiscard]] JsonType<double> jsonNumber();
[[nodiscard]] JsonType<double> jsonPositive();
[[nodiscard]] JsonType<double> jsonNotNegative();
[[nodiscard]] JsonType<int> jsonWhole(int least, int most);
[[nodiscard]] JsonType<bool> jsonFlag();
[[nodiscard]] JsonType<std::string> jsonText();
[[nodiscard]] JsonType<std::string> jsonName();  ///< A text with at least one character.

/// A number > 0 and at most `most`. If it is larger, `why` and `remedy` are the error.
[[nodiscard]] JsonType<double> jsonPositiveUpTo(double most, const char* why, const char* remedy);
/// A number > 0 and at most `most` [`unit`]. A larger number is probably in a wrong unit.
[[nodiscard]] JsonType<double> jsonPositiveUpTo(double most, const char* unit);
/// A number >= 0 and at most `most` [`unit`].
[[nodiscard]] JsonType<double> jsonNotNegativeUpTo(double most, const char* unit);
/// A number from -`most` to `most` [`unit`].
[[nodiscard]] JsonType<double> jsonUpTo(double most, const char* unit);
/// A text that matches `pattern`, an ECMAScript regular expression whose repetitions are bounded.
[[nodiscard]] JsonType<std::string> jsonMatching(const char* pattern, const char* why,
                                                 const char* remedy);

template <std::size_t N>
[[nodiscard]] JsonType<std::array<double, N>> jsonNumbers(
    const std::array<JsonType<double>, N>& each) {
  JsonSchema items = JsonSchema::array();
  for (const JsonType<double>& number : each) items.push_back(number.schema);
  return {{{"type", "array"}, {"items", items}, {"minItems", N}, {"maxItems", N}},
          [each](const JsonNode& node) {
            std::array<double, N> values = node.numbers<N>();
            for (std::size_t i = 0; i < N; ++i) values[i] = each[i].read(node.element(i));
            return values;
          }};
}
template <std::size_t N>
[[nodiscard]] JsonType<std::array<double, N>> jsonNumbers(
    const JsonType<double>& number = jsonNumber()) {
  std::array<JsonType<double>, N> each;
  each.fill(number);
  JsonType<std::array<double, N>> type = jsonNumbers(each);
  type.schema["items"] = number.schema;
  return type;
}

/// A text that is one of `words`. The reader returns the value that is paired with the word.
template <class T>
[[nodiscard]] JsonType<T> jsonWord(std::vector<std::pair<const char*, T>> words) {
  JsonSchema names = JsonSchema::array();
  for (const auto& [name, value] : words) names.push_back(name);
  return {{{"enum", names}},
          [words = std::move(words)](const JsonNode& node) { return node.word<T>(words); }};
}
/// A value of the enum T. The file contains the word that wordFor() returns for the value.
template <class T>
[[nodiscard]] JsonType<T> jsonWordOf(std::initializer_list<T> values) {
  std::vector<std::pair<const char*, T>> words;
  for (const T value : values) words.emplace_back(wordFor(value), value);
  return jsonWord<T>(std::move(words));
}

/// A list of `least` to `most` elements. `why` and `remedy`: the error for another length or type.
template <class T>
[[nodiscard]] JsonType<std::vector<T>> jsonList(const JsonType<T>& element, std::size_t least,
                                                std::size_t most, const char* why,
                                                const char* remedy) {
  return {{{"type", "array"}, {"minItems", least}, {"maxItems", most}, {"items", element.schema}},
          [read = element.read, least, most, why, remedy](const JsonNode& node) {
            const std::size_t size = node.json().is_array() ? node.json().size() : most + 1;
            if (size < least || size > most) node.fail(why, remedy);
            std::vector<T> values;
            values.reserve(size);
            for (std::size_t i = 0; i < size; ++i) values.push_back(read(node.element(i)));
            return values;
          }};
}
template <class T>
[[nodiscard]] JsonType<std::vector<T>> jsonList(const JsonType<T>& element, const char* why,
                                                const char* remedy) {
  JsonType<std::vector<T>> list =
      jsonList(element, 1, std::numeric_limits<std::size_t>::max() - 1, why, remedy);
  list.schema.erase("maxItems");
  return list;
}

/// An object with at least `least` keys, whose names are free. `why` and `remedy`: the error for
/// fewer keys or another type.
template <class T>
[[nodiscard]] JsonType<std::map<std::string, T>> jsonMap(const JsonType<T>& value,
                                                         std::size_t least, const char* why,
                                                         const char* remedy) {
  return {{{"type", "object"}, {"minProperties", least}, {"additionalProperties", value.schema}},
          [read = value.read, least, why, remedy](const JsonNode& node) {
            if (!node.json().is_object() || node.json().size() < least) node.fail(why, remedy);
            std::map<std::string, T> values;
            for (const auto& [name, ignored] : node.json().items())
              values[name] = read(node.child(name));
            return values;
          }};
}

template <class T>
[[nodiscard]] JsonType<T> jsonNumberOr(const JsonType<T>& number, const JsonType<T>& other) {
  return {{{"oneOf", JsonSchema::array({number.schema, other.schema})}},
          [number = number.read, other = other.read](const JsonNode& node) {
            if (node.json().is_number()) return number(node);
            if (node.json().is_object()) return other(node);
            node.fail(node.json().dump() + " is neither a number nor an object",
                      "write a number or { ... }");
          }};
}

[[nodiscard]] JsonSchema jsonFileSchema(const char* title, const char* description,
                                        const JsonSchema& object, const JsonSchema& definitions);

/// A table of rows. A row has a key, the type of its value, and the member of Spec or the function
/// that receives the value. Rows are read in order, the rows of a choice last.
template <class Spec>
class JsonObject {
 public:
  /// Adds a required (need) or optional (may) key. `put`: a pointer to a member of Spec, or a
  /// function that receives the Spec and the value.
  template <class T, class Put>
  JsonObject& need(const char* key, const JsonType<T>& type, Put put) {
    return add(key, type, put, true);
  }
  template <class T, class Put>
  JsonObject& may(const char* key, const JsonType<T>& type, Put put) {
    return add(key, type, put, false);
  }
  /// Adds an optional key whose text the program ignores.
  JsonObject& remark(const char* key) {
    return may(key, jsonText(), [](Spec&, const std::string&) {});
  }
  JsonObject& version(const char* key, int number, const char* description) {
    rows_.push_back({key,
                     {{"const", number}, {"description", description}},
                     true,
                     [number](const JsonNode& node, Spec&) {
                       if (node.number() == number) return;
                       node.fail(
                           node.json().dump() + " is a version that this program does not support",
                           "write " + std::to_string(number));
                     }});
    return *this;
  }
  /// Adds a required (mustHold) or optional (mayHold) inner object whose rows fill the same Spec.
  JsonObject& mayHold(const char* key, const JsonObject& object, const char* description) {
    return hold(key, object, description, false);
  }
  JsonObject& mustHold(const char* key, const JsonObject& object, const char* description) {
    return hold(key, object, description, true);
  }
  /// Rejects `keys`, which are likely mistakes, with the error `why` and `remedy`.
  JsonObject& refuse(std::vector<const char*> keys, const char* why, const char* remedy) {
    for (const char* key : keys) refusals_.push_back({key, why, remedy});
    return *this;
  }
  /// Rejects an object with `key` but without `other`.
  JsonObject& needs(const char* key, const char* other, const char* why, const char* remedy) {
    relations_.push_back({key, other, true, why, remedy});
    return *this;
  }
  /// Rejects an object with both `key` and `other`.
  JsonObject& either(const char* key, const char* other, const char* why, const char* remedy) {
    relations_.push_back({key, other, false, why, remedy});
    return *this;
  }
  /// Adds a function that read() calls with the Spec before it reads the rows of this object.
  JsonObject& always(std::function<void(Spec&)> set) {
    set_.push_back(std::move(set));
    return *this;
  }

  /// Adds alternative sets of rows. The value of `key` selects the set.
  JsonObject& choose(const char* key, std::vector<std::pair<const char*, JsonObject>> objects) {
    key_ = key;
    for (auto& [word, object] : objects) choices_.push_back({word, std::move(object)});
    return *this;
  }
  /// Adds alternative sets of rows. The file selects the set whose first key it has; it must have
  /// exactly one of these keys.
  JsonObject& chooseByKey(std::vector<JsonObject> objects) {
    for (JsonObject& object : objects) {
      std::string first = object.rows_.front().key;
      choices_.push_back({std::move(first), std::move(object)});
    }
    return *this;
  }

  /// Adds all rows of another object, which must have no choices.
  JsonObject& with(const JsonObject& other) {
    assert(other.choices_.empty());
    rows_.insert(rows_.end(), other.rows_.begin(), other.rows_.end());
    refusals_.insert(refusals_.end(), other.refusals_.begin(), other.refusals_.end());
    set_.insert(set_.end(), other.set_.begin(), other.set_.end());
    relations_.insert(relations_.end(), other.relations_.begin(), other.relations_.end());
    return *this;
  }

  void read(const JsonNode& node, Spec& spec) const {
    std::vector<std::string> all;
    addKeys(all);
    node.object(all, refused());
    std::vector<const JsonObject*> chosen{this};
    std::string words;
    refuseKeys(node);
    while (const Choice* choice = chosen.back()->choiceOf(node)) {
      words += (words.empty() ? "" : ", ") + chosen.back()->named(*choice);
      chosen.push_back(&choice->object);
      choice->object.refuseKeys(node);
    }
    for (const auto& [key, value] : node.json().items()) {
      const bool known =
          std::any_of(chosen.begin(), chosen.end(),
                      [&key = key](const auto* object) { return object->holds(key); });
      if (!known) node.child(key).fail(words + " does not have this key", "remove it");
    }
    for (const JsonObject* object : chosen) object->readRows(node, spec);
  }
  /// Returns a type that reads a Spec. Members without a key in the file keep their defaults.
  [[nodiscard]] JsonType<Spec> type() const {
    return {schema(), [object = *this](const JsonNode& node) {
              Spec spec;
              object.read(node, spec);
              return spec;
            }};
  }
  /// Returns the schema. It has one object for each choice, which permits only the common keys and
  /// the choice's keys.
  [[nodiscard]] JsonSchema schema() const {
    std::vector<JsonSchema> closed;
    addSchemas({{"type", "object"},
                {"required", JsonSchema::array()},
                {"additionalProperties", false},
                {"properties", JsonSchema::object()}},
               closed);
    if (closed.size() == 1) return closed.front();
    return {{"oneOf", closed}};
  }

 private:
  struct Row {
    std::string key;
    JsonSchema schema;
    bool needed = false;
    std::function<void(const JsonNode&, Spec&)> read;
  };
  struct Refusal {
    std::string key;
    const char* why;
    const char* remedy;
  };
  struct Relation {
    std::string key;
    std::string other;
    bool needed;  ///< If `key` is present, `other` is required (true) or forbidden (false).
    const char* why;
    const char* remedy;
  };
  struct Choice;

  template <class T, class Put>
  JsonObject& add(const char* key, const JsonType<T>& type, Put put, bool needed) {
    rows_.push_back(
        {key, type.schema, needed, [read = type.read, put](const JsonNode& node, Spec& spec) {
           if constexpr (std::is_member_object_pointer_v<Put>) {
             spec.*put = read(node);
           } else {
             put(spec, read(node));
           }
         }});
    return *this;
  }

  JsonObject& hold(const char* key, const JsonObject& object, const char* description,
                   bool needed) {
    JsonSchema schema = object.schema();
    schema["description"] = description;
    rows_.push_back({key, std::move(schema), needed,
                     [object](const JsonNode& node, Spec& spec) { object.read(node, spec); }});
    return *this;
  }

  [[nodiscard]] bool holds(const std::string& key) const {
    return key == key_ ||
           std::any_of(rows_.begin(), rows_.end(), [&](const Row& row) { return row.key == key; });
  }

  void addKeys(std::vector<std::string>& all) const {
    const auto add = [&](const std::string& key) {
      if (std::find(all.begin(), all.end(), key) == all.end()) all.push_back(key);
    };
    for (const Row& row : rows_) add(row.key);
    if (!key_.empty()) add(key_);
    for (const Choice& choice : choices_) choice.object.addKeys(all);
  }
  [[nodiscard]] std::vector<std::string> refused() const {
    std::vector<std::string> keys;
    for (const Refusal& refusal : refusals_) keys.push_back(refusal.key);
    for (const Choice& choice : choices_) {
      const std::vector<std::string> more = choice.object.refused();
      keys.insert(keys.end(), more.begin(), more.end());
    }
    return keys;
  }

  /// Returns the choice that the file selects; null if the object has no choices.
  [[nodiscard]] const Choice* choiceOf(const JsonNode& node) const {
    if (choices_.empty()) return nullptr;
    std::vector<std::string> words;
    for (const Choice& choice : choices_) words.push_back(choice.word);
    if (!key_.empty()) return &choices_[node.need(key_).wordAmong(words)];
    const Choice* found = nullptr;
    std::size_t count = 0;
    std::string listed;
    for (const Choice& choice : choices_) {
      listed += (listed.empty() ? "" : ", ") + choice.word;
      if (!node.has(choice.word)) continue;
      found = &choice;
      ++count;
    }
    if (count != 1) node.fail("it has none or several of the keys " + listed, "give one of them");
    return found;
  }
  [[nodiscard]] std::string named(const Choice& choice) const {
    return key_.empty() ? "\"" + choice.word + "\"" : key_ + " " + choice.word;
  }

  void refuseKeys(const JsonNode& node) const {
    for (const Refusal& refusal : refusals_) {
      if (node.has(refusal.key)) node.child(refusal.key).fail(refusal.why, refusal.remedy);
    }
  }

  void readRows(const JsonNode& node, Spec& spec) const {
    for (const Row& row : rows_) {
      if (row.needed) (void)node.need(row.key);
    }
    for (const Relation& relation : relations_) {
      if (!node.has(relation.key) || node.has(relation.other) == relation.needed) continue;
      node.child(relation.key).fail(relation.why, relation.remedy);
    }
    for (const auto& set : set_) set(spec);
    for (const Row& row : rows_) {
      if (node.has(row.key)) row.read(node.child(row.key), spec);
    }
  }

  void addSchemas(JsonSchema schema, std::vector<JsonSchema>& closed) const {
    for (const Row& row : rows_) {
      schema["properties"][row.key] = row.schema;
      if (row.needed) schema["required"].push_back(row.key);
    }
    for (const Relation& relation : relations_) {
      if (relation.needed) {
        schema["dependencies"][relation.key].push_back(relation.other);
      } else {
        schema["allOf"].push_back({{"not", {{"required", {relation.key, relation.other}}}}});
      }
    }
    if (choices_.empty()) closed.push_back(schema);
    for (const Choice& choice : choices_) {
      JsonSchema one = schema;
      if (!key_.empty()) {
        one["properties"][key_] = {{"const", choice.word}};
        one["required"].push_back(key_);
      }
      choice.object.addSchemas(std::move(one), closed);
    }
  }

  std::vector<Row> rows_;
  std::vector<Refusal> refusals_;
  std::vector<Relation> relations_;
  std::vector<std::function<void(Spec&)>> set_;
  /// Key that selects a choice by its value; empty: the first key of a choice selects it.
  std::string key_;
  std::vector<Choice> choices_;
};

template <class Spec>
struct JsonObject<Spec>::Choice {
  std::string word;
  JsonObject object;
};

}  // namespace palpate
