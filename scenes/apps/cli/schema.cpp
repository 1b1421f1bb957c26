#include <memory>

#include "palpate/devices/hid/hid_profile.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {

void addSchema(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "schema", "Prints the JSON Schema of scene files or of arms' profiles, for editors");
  auto of = std::make_shared<std::string>();
  verb->add_option("OF", *of, "scene or arm")->required()->check(CLI::IsMember({"scene", "arm"}));
  verb->footer("Example:\n  palpate schema scene > scene.schema.json");
  verb->callback([=, &body] {
    body = [=] {
      sayRaw(*of == "scene" ? sceneSchema() : hidProfileSchema());
      return kDone;
    };
  });
}

}  // namespace palpate::cli
