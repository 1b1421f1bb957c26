#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/apps/cli/bricks_told.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/brick_places.h"

namespace palpate::cli {
namespace {

/// Returns the key "label" of a mode for the first label: with the label's name, or with its value
/// if the name is empty or another label has the same name.
std::string firstLabelled(const std::vector<Label>& labels) {
  const Label& first = labels.front();
  const bool by_name =
      !first.name.empty() && std::none_of(labels.begin(), labels.end(), [&](const Label& label) {
        return label.name == first.name && label.value != first.value;
      });
  const OrderedJson key =
      by_name ? OrderedJson(first.name) : OrderedJson(static_cast<std::int64_t>(first.value));
  return "\"label\": " + key.dump(-1, ' ', false, OrderedJson::error_handler_t::replace);
}

OrderedJson describe(const Label& label) {
  OrderedJson json{{"label", static_cast<std::int64_t>(label.value)}, {"name", label.name}};
  if (label.colour) json["colour"] = toJson(*label.colour);
  return json;
}

std::string feelOf(const GridInfo& grid) {
  if (!grid.refusal.empty()) return "not possible: " + grid.refusal;
  if (grid.vector) return "follow its lines; force along its vectors; viscosity by its magnitude";
  if (grid.grid_class == GridClass::kLevelSet) return "isosurface at 0, solid below";
  if (!grid.labels.empty()) return "isosurface of a label, such as " + firstLabelled(grid.labels);
  return "surface and viscosity by its value; isosurface at a value you choose";
}

OrderedJson describe(const GridInfo& grid) {
  OrderedJson json;
  json["name"] = grid.name;
  json["type"] = grid.type;
  json["class"] = wordFor(grid.grid_class);
  json["half"] = grid.half;
  json["voxel_size"] = toJson(grid.voxel);
  json["active_voxels"] = grid.active_voxels;
  json["bounds"] = grid.bounds.empty()
                       ? OrderedJson(nullptr)
                       : OrderedJson::array({toJson(grid.bounds.lower), toJson(grid.bounds.upper)});
  json["memory_bytes"] = grid.memory;
  json[grid.vector ? "magnitude_range" : "value_range"] = {grid.lowest, grid.highest};
  json["mean"] = grid.mean;
  json["background"] = grid.background;
  json["non_finite"] = grid.non_finite;
  for (const Label& label : grid.labels) json["labels"].push_back(describe(label));
  if (!grid.source.empty()) json["source"] = grid.source;
  if (!grid.description.empty()) json["description"] = grid.description;
  json["can_be_felt"] = grid.refusal.empty();
  json["feel"] = feelOf(grid);
  return json;
}

std::string line(const Vec3& v) {
  return fmt::format("{} x {} x {}", rounded(v.x()), rounded(v.y()), rounded(v.z()));
}

void print(const GridInfo& grid) {
  say("{}\n", grid.name.empty() ? "(no name)" : grid.name);
  const bool known = grid.grid_class != GridClass::kUnknown;
  say("  type      {}{}{}{}\n", grid.type, grid.half ? " (stored as half)" : "", known ? ", " : "",
      known ? wordFor(grid.grid_class) : "");
  say("  voxels    {} active, edges {} along i, j, k, {} MB in memory\n", grid.active_voxels,
      line(grid.voxel), rounded(static_cast<double>(grid.memory) / 1e6));
  if (!grid.bounds.empty()) {
    const Vec3& a = grid.bounds.lower;
    const Vec3& b = grid.bounds.upper;
    say("  bounds    {} .. {}, {} .. {}, {} .. {}\n", rounded(a.x()), rounded(b.x()),
        rounded(a.y()), rounded(b.y()), rounded(a.z()), rounded(b.z()));
  }
  if (!std::isnan(grid.lowest)) {
    say("  {} {} .. {}, mean {}, background {}\n", grid.vector ? "magnitude" : "values   ",
        rounded(grid.lowest), rounded(grid.highest), rounded(grid.mean), rounded(grid.background));
  }
  for (const Label& label : grid.labels) say("  label     {} {}\n", label.value, label.name);
  if (grid.grid_class == GridClass::kStaggered) {
    say("  note      staggered: each component is read on its face of the voxel\n");
  }
  if (grid.was_local)
    say("  note      vectors are stored in index space and converted to world space\n");
  if (!grid.source.empty()) say("  from      {}\n", grid.source);
  if (!grid.description.empty()) say("  about     {}\n", sentence(grid.description));
  say("  feel      {}\n", sentence(feelOf(grid)));
}

int infoOfBricks(const std::string& place, bool json) {
  const std::unique_ptr<BrickSource> source = openBricks(place);
  const BrickManifest& manifest = source->manifest();
  if (json) {
    OrderedJson grid = describe(manifest.info());
    grid["bricks"] = bricksJson(manifest);
    sayJson(OrderedJson{{"file", place}, {"grids", OrderedJson::array({grid})}});
    return kDone;
  }
  print(manifest.info());
  sayBricks(manifest);
  return kDone;
}

}  // namespace

void addInfo(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("info", "Prints the content of a .vdb and the modes that suit it");
  auto file = std::make_shared<std::string>();
  auto json = std::make_shared<bool>(false);
  verb->add_option("FILE", *file, "A .vdb file, or the folder or URL of a volume in bricks")
      ->required();
  verb->add_flag("--json", *json, "Print JSON");
  verb->footer("Example:\n  palpate info head.vdb");
  verb->callback([=, &body] {
    body = [=] {
      if (isBrickPlace(*file)) return infoOfBricks(*file, *json);
      refuseRecording(*file);
      const std::vector<GridInfo> grids = describeGrids(*file);
      if (*json) {
        OrderedJson out;
        out["file"] = *file;
        out["grids"] = OrderedJson::array();
        for (const GridInfo& grid : grids) out["grids"].push_back(describe(grid));
        sayJson(out);
      } else {
        for (const GridInfo& grid : grids) print(grid);
      }
      return kDone;
    };
  });
}

}  // namespace palpate::cli
