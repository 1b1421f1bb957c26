/// Writes the grids of a step as .vdb or as bricks.
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <malloc.h>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_grid.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/descriptor.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/apps/import/importer.h"
#include "palpate/scenes/library/new_file.h"
#include "palpate/scenes/library/write_grids.h"

namespace palpate::importer {

void writeVdb(const std::filesystem::path& file, Step& step, const std::string& in) {
  const std::size_t count = step.grids.size();
  {
    openvdb::GridCPtrVec grids;
    for (const Imported& imported : step.grids) {
      // If voxels are missing, the background is active (grids.h). Replaces leaves of one value by
      // tiles.
      if (imported.image && !imported.level_set && imported.made.holes > 0) {
        imported.made.grid->pruneGrid();
      }
      grids.push_back(imported.made.grid);
    }
    const Descriptor descriptor(createNewFile(file));
    if (descriptor.get() < 0) {
      throw Error(wholeOf(file).string(),
                  fmt::format("the file cannot be written ({})", std::strerror(errno)),
                  "choose another path, or free space on the disk");
    }
    writeGrids(nameOfOpen(descriptor.get(), file), grids);
  }
  const bool is_empty = std::any_of(
      step.grids.begin(), step.grids.end(),
      [](const Imported& imported) { return imported.level_set && imported.made.active == 0; });
  step.grids.clear();
  if (is_empty || count == 0) return;  // a scene plays this frame as background
  const auto refused = [&](const std::string& what, const std::string& refusal) {
    throw VolumeError(
        in, fmt::format("{} cannot be used in a scene ({})", what, refusal),
        "check the sizes, positions and values in the file, or choose arrays with --field");
  };
  malloc_trim(0);  // returns free memory to the system: describeGrids needs memory for one grid
  std::vector<GridInfo> read;
  try {
    read = describeGrids(file);
  } catch (const VolumeError& e) {
    const std::string_view why = e.what();
    refused("the result", std::string(why.substr(std::min(why.size(), file.string().size() + 2))));
  }
  // After the grids, describeGrids lists components of vectors, which are ignored here.
  for (std::size_t i = 0; i < std::min(read.size(), count); ++i) {
    if (!read[i].refusal.empty()) refused("array \"" + read[i].name + "\"", read[i].refusal);
  }
}

void writeAsBricks(const std::filesystem::path& folder, Step& step, const Progress& progress,
                   ProcessGroup& processes) {
  BrickOptions options;
  options.progress = progress;
  options.group = &processes;
  openvdb::GridBase::Ptr grid = step.grids.front().made.grid;
  const std::optional<GridParts> parts = std::move(step.grids.front().parts);
  step.grids.clear();
  if (parts) {
    (void)writeBricks(folder, brickInput(*parts, processes), options);
    return;
  }
  BrickInput input = brickInput(makeVolume(*grid));
  grid.reset();
  // Numbers in the metadata may differ in the last digit between machines, so all ranks use the
  // metadata of rank 0.
  const ProcessGroup::Bytes text =
      processes.gather(std::as_bytes(std::span(input.metadata))).front();
  input.metadata.assign(reinterpret_cast<const char*>(text.data()), text.size());
  (void)writeBricks(folder, input, options);
}

}  // namespace palpate::importer
