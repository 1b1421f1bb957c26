#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/brick_places.h"
#include "palpate/scenes/library/scene_file.h"

namespace palpate::cli {

void addScene(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "scene", "Prints a first scene for a .vdb; prints the reasons for its choices to stderr");
  auto file = std::make_shared<std::string>();
  auto what = std::make_shared<GuessFor>(GuessFor::kAnything);
  const std::map<std::string, GuessFor> words{{"ct", GuessFor::kCt},
                                              {"mri", GuessFor::kMri},
                                              {"cfd", GuessFor::kCfd},
                                              {"fibres", GuessFor::kFibres},
                                              {"labels", GuessFor::kLabels}};
  verb->add_option("FILE", *file, "A .vdb file, or a folder of bricks")->required();
  const auto choose = [=](const std::string& word) {
    const auto found = words.find(CLI::detail::to_lower(word));
    if (found == words.end()) {
      throw CLI::ValidationError(
          "--for",
          '"' + Legible(word).text() + "\" is not a kind: use ct, mri, cfd, fibres or labels");
    }
    *what = found->second;
  };
  verb->add_option_function<std::string>("--for", choose,
                                         "Kind of data; replaces the automatic choice")
      ->type_name("KIND:{ct,mri,cfd,fibres,labels}");
  verb->footer(
      "Examples:\n  palpate scene head.vdb > head.json\n"
      "  palpate scene atlas.vdb --for labels > atlas.json");
  verb->callback([=, &body] {
    body = [=] {
      // The files in a scene are relative to its folder, which is unknown until the user saves the
      // scene.
      std::filesystem::path place(*file);
      if (place.has_parent_path()) place = absolutePlace(place);
      refuseRecording(*file);
      const Guess guess = guessVdb(place, *what, showProgress("loading"));
      for (const std::string& line : guess.seen) complain("found: " + line);
      for (const std::string& line : guess.made) complain("added: " + line);
      for (const std::string& line : guess.left) complain("skipped: " + line);
      sayRaw(guess.scene);
      return kDone;
    };
  });
}

}  // namespace palpate::cli
