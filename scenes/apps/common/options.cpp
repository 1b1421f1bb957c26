#include "palpate/scenes/apps/common/options.h"

#include <sstream>

namespace palpate::cli {
namespace {

/// Returns the words of "TEXT:{vector,tensor}".
OrderedJson valuesIn(const std::string& type) {
  OrderedJson values = OrderedJson::array();
  const std::size_t open = type.find('{');
  if (open == std::string::npos) return values;
  std::istringstream list(type.substr(open + 1, type.find('}') - open - 1));
  for (std::string value; std::getline(list, value, ',');) values.push_back(value);
  return values;
}

}  // namespace

OrderedJson optionsOf(const CLI::App& app) {
  OrderedJson options = OrderedJson::array();
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;  // hidden
    OrderedJson names = OrderedJson::array();
    for (const std::string& name : option->get_snames()) names.push_back("-" + name);
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
    const std::string type = option->get_type_name();
    OrderedJson takes;
    if (names.empty()) {
      takes = option->get_name(/*positional=*/true);
    } else if (!type.empty()) {
      takes = type.substr(0, type.find(':'));
    }
    options.push_back({{"names", names},
                       {"what", option->get_description()},
                       {"takes", takes},
                       {"values", valuesIn(type)},
                       {"again", option->get_expected_max() > 1}});
  }
  return options;
}

}  // namespace palpate::cli
