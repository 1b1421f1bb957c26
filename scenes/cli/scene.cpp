/// palpate scene: a first scene for a .vdb, and why it is that one.
#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include <fmt/format.h>

#include "palpate/scenes/brick_places.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/scene_file.h"

namespace palpate::cli {

void addScene(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "scene", "Prints a first scene for a .vdb, and says why it is that one (to stderr)");
  auto file = std::make_shared<std::string>();
  auto what = std::make_shared<GuessFor>(GuessFor::kAnything);
  const std::map<std::string, GuessFor> words{{"ct", GuessFor::kCt},
                                              {"mri", GuessFor::kMri},
                                              {"cfd", GuessFor::kCfd},
                                              {"fibres", GuessFor::kFibres},
                                              {"labels", GuessFor::kLabels}};
  verb->add_option("FILE", *file, "A .vdb file, or a folder of bricks")->required();
  verb->add_option("--for", *what, "What it holds, whatever it looks like")
      ->transform(CLI::CheckedTransformer(words, CLI::ignore_case)
                      .description("{ct,mri,cfd,fibres,labels}"))
      ->type_name("KIND");
  verb->footer(
      "Examples:\n  palpate scene head.vdb > head.json\n"
      "  palpate scene atlas.vdb --for labels > atlas.json");
  verb->callback([=, &body] {
    body = [=] {
      // A scene's files are found from where it lies, which nobody knows yet.
      std::filesystem::path place(*file);
      if (place.has_parent_path()) place = absolutePlace(place);
      const Guess guess = guessVdb(place, *what, showProgress("loading"));
      for (const std::string& line : guess.seen) complain("saw: " + line);
      for (const std::string& line : guess.made) complain("made: " + line);
      for (const std::string& line : guess.left) complain("left out: " + line);
      sayRaw(guess.scene);
      return kDone;
    };
  });
}

}  // namespace palpate::cli
