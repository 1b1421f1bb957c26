#include <optional>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/made.h"
#include "palpate/scenes/library/new_file.h"

namespace palpate::cli {
namespace {

struct MakeOptions {
  std::string name;
  std::string out;
  std::optional<double> voxel;
  bool json = false;
};

int make(const MakeOptions& options) {
  if (std::filesystem::path(options.out).extension() != ".vdb") {
    throw Error(options.out, "the name of the output does not end in .vdb",
                "choose a name that ends in .vdb");
  }
  checkReplaceable(options.out);
  std::function<void(double)> progress = showProgress("making");
  WholeFile file(options.out);
  const std::vector<MadeGrid> grids =
      writeMade(options.name, options.voxel, nameOfOpen(file.descriptor(), file.place()));
  progress = nullptr;
  file.commit();

  OrderedJson json;
  json["file"] = options.out;
  json["grids"] = OrderedJson::array();
  for (const MadeGrid& grid : grids) {
    json["grids"].push_back({{"name", grid.name},
                             {"what", grid.what},
                             {"unit", grid.value_unit},
                             {"frames", grid.frames},
                             {"voxel", grid.voxel},
                             {"active_voxels", grid.active_voxels}});
  }
  if (options.json) {
    sayJson(json);
    return kDone;
  }
  std::string unit;
  for (const MadeVolume& volume : madeVolumes()) {
    if (volume.name == options.name) unit = volume.length_unit;
  }
  say("{}:\n", options.out);
  for (const MadeGrid& grid : grids) {
    say("  {}{}: {}{}, {} active voxels{}, voxel size {} {}\n", grid.name,
        grid.frames > 1 ? fmt::format("[0] to [{}]", grid.frames - 1) : "", sentence(grid.what),
        grid.value_unit.empty() ? "" : " [" + grid.value_unit + "]", grid.active_voxels,
        grid.frames > 1 ? " each" : "", rounded(grid.voxel), unit);
  }
  return kDone;
}

}  // namespace

void addMake(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("make", "Writes an example .vdb that is computed from formulas");
  auto options = std::make_shared<MakeOptions>();
  std::string volumes = "Volumes:\n";
  for (const MadeVolume& volume : madeVolumes()) {
    volumes += fmt::format("  {:<12} {}; lengths in {}, voxel size {} ({} to {})\n", volume.name,
                           volume.what, volume.length_unit, volume.voxel, volume.least_voxel,
                           volume.most_voxel);
  }
  verb->add_option("NAME", options->name, "Name of the volume; see the list below")->required();
  verb->add_option("OUT", options->out, "The .vdb to write")->required();
  verb->add_option("--voxel", options->voxel,
                   "Edge of a voxel, in the volume's unit; default and range: see the list below");
  verb->add_flag("--json", options->json, "Print JSON");
  verb->footer(volumes + "Example:\n  palpate make wind-tunnel wind.vdb && palpate info wind.vdb");
  verb->callback([=, &body] { body = [=] { return make(*options); }; });
}

}  // namespace palpate::cli
