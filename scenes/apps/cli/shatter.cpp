/// palpate shatter: makes a large scene from one volume, for trials with many objects.
#include <filesystem>
#include <map>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/fragments.h"

namespace palpate::cli {
namespace {

struct ShatterOptions {
  std::string file;
  std::string out;
  std::string grid;
  std::string solid = "above";
  std::string unit = "mm";
  FragmentOrder order;
  bool json = false;
};

int shatter(const ShatterOptions& options) {
  noteInterrupts();
  static const std::map<std::string, double> units{
      {"m", 1.0}, {"cm", 1e-2}, {"mm", 1e-3}, {"um", 1e-6}};
  FragmentOrder order = options.order;
  order.metres_per_unit = units.at(options.unit);
  order.solid = options.solid == "above" ? Solid::kAbove : Solid::kBelow;
  WholeFolder folder(options.out);
  const auto stop = [](const std::function<void(double)>& told) {
    return [told](double done) {
      endIfInterrupted();
      if (told) told(done);
    };
  };
  LoadOptions load;
  load.progress = stop(showProgress("loading"));
  const auto volume = loadVolume(options.file, options.grid, load);
  const Fragments made =
      strewFragments(*volume, order, folder.place(), stop(showProgress("breaking")));
  folder.commit();
  const std::string scene = (std::filesystem::path(options.out) / "scene.json").string();
  if (options.json) {
    const OrderedJson json{{"scene", scene},         {"pieces", made.pieces},
                           {"places", made.places},  {"active_voxels", made.voxels},
                           {"mean_size", made.size}, {"mean_overlap", made.overlap}};
    sayJson(json);
    return kDone;
  }
  say("{}: {} places of {} pieces, {} active voxels\n", scene, made.places, made.pieces,
      made.voxels);
  say("pieces {} mm long in the mean; where the hand is, the boxes of {} meet in the mean\n",
      rounded(1e3 * made.size), rounded(made.overlap));
  return kDone;
}

}  // namespace

void addShatter(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "shatter",
      "Breaks a volume's solid into fragments and strews them: a large scene for trials");
  auto options = std::make_shared<ShatterOptions>();
  FragmentOrder& order = options->order;
  verb->add_option("FILE", options->file, "The .vdb to break")->required();
  verb->add_option("OUT", options->out, "The folder to make: scene.json and the pieces")
      ->required();
  verb->add_option("--value", order.value, "The solid's surface, as an isosurface has it")
      ->required();
  verb->add_option("--grid", options->grid, "Which grid; not needed where there is one");
  verb->add_option("--solid", options->solid, "Which side of the value it is on")
      ->capture_default_str()
      ->check(CLI::IsMember({"above", "below"}));
  verb->add_option("--unit", options->unit, "Of the file's lengths")
      ->capture_default_str()
      ->check(CLI::IsMember({"m", "cm", "mm", "um"}));
  verb->add_option("--pieces", order.pieces, "Files to break it into")->capture_default_str();
  verb->add_option("--count", order.places, "Fragments to strew")->capture_default_str();
  verb->add_option("--room", order.room, "Edge of the cube that they lie in [m]")
      ->capture_default_str();
  verb->add_option("--strength", order.strength, "Of their surfaces [N]")->capture_default_str();
  verb->add_option("--seed", order.seed, "Where it breaks and where they lie")
      ->capture_default_str();
  verb->add_flag("--json", options->json, "Print JSON");
  verb->footer(
      "Example:\n  palpate shatter head.vdb rubble --value 1150 && palpate feel rubble/scene.json "
      "--seconds 10");
  verb->callback([=, &body] { body = [=] { return shatter(*options); }; });
}

}  // namespace palpate::cli
