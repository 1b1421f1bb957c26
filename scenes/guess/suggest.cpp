#include "palpate/scenes/guess/suggest.h"

#include <cctype>
#include <map>
#include <utility>

#include <fmt/format.h>

#include "palpate/samplers/grid/data_ends.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/scenes/guess/choose_grids.h"
#include "palpate/scenes/guess/metadata.h"

namespace palpate::guess {

std::string volumeNameOf(const std::string& grid) {
  std::string plain;
  for (const char c : grid) {
    const bool usable = std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '-';
    if (usable || (!plain.empty() && plain.back() != '_')) plain += usable ? c : '_';
  }
  while (!plain.empty() && plain.back() == '_') plain.pop_back();
  return plain.empty() ? "volume" : plain;
}

namespace {

std::vector<Candidate> nameGrids(const std::vector<SuggestInput>& grids, Draft& draft) {
  std::map<std::string, int> count;
  for (const SuggestInput& input : grids) ++count[input.name()];
  std::map<std::string, int> next;
  std::vector<Candidate> candidates;
  candidates.reserve(grids.size());
  for (const SuggestInput& input : grids) {
    Candidate candidate;
    candidate.input = &input;
    candidate.grid = input.name();
    if (count[candidate.grid] > 1) {
      candidate.grid += fmt::format("[{}]", next[candidate.grid]++);
    }
    candidate.name = draft.uniqueName(volumeNameOf(input.name()));
    candidates.push_back(std::move(candidate));
  }
  return candidates;
}

/// Returns the input for the analysis. Sets `apart` if the transforms of the components differ,
/// because the analysis reads them by voxel.
SuggestInput inputFrom(const GuessVolume& given) {
  // Above this fraction of active voxels, a grid is a block of data up to the faces of its box.
  constexpr double kFull = 0.98;
  SuggestInput input;
  const std::vector<Volume::Grid::Part>& parts = given.volume->grid().parts;
  const auto base = [&](std::size_t i) {
    return std::visit([](const auto& grid) { return openvdb::GridBase::ConstPtr(grid); },
                      parts[i].data);
  };
  input.called = given.grid;
  input.bricks = given.bricks;
  input.grid = base(0);
  if (parts.size() == 3) {
    input.y = base(1);
    input.z = base(2);
    const auto& transform = input.grid->transform();
    input.apart = input.y->transform() != transform || input.z->transform() != transform;
  }
  const auto text = [&](const char* key) {
    const auto meta = input.grid->getMetadata<openvdb::StringMetadata>(key);
    return meta ? meta->value() : std::string();
  };
  input.value_unit = text(kMetaValueUnit);
  if (text(kMetaModality) == "CT") input.modality = Modality::kCt;
  if (text(kMetaModality) == "MR") input.modality = Modality::kMr;
  if (const auto axial = input.grid->getMetadata<openvdb::BoolMetadata>(kMetaAxial)) {
    input.axial = axial->value();
  }
  const auto missing = input.grid->getMetadata<openvdb::BoolMetadata>(kMetaInactiveIsMissing);
  input.inactive_is_data =
      inactiveVoxels(text(kMetaImportedFrom), missing && missing->value()) == Inactive::kBackground;
  const openvdb::CoordBBox box = input.grid->evalActiveVoxelBoundingBox();
  if (const auto size = input.grid->getMetadata<openvdb::Vec3IMetadata>(kMetaImageSize)) {
    const openvdb::Vec3i voxels = size->value();
    input.extent = openvdb::CoordBBox(0, 0, 0, voxels[0] - 1, voxels[1] - 1, voxels[2] - 1);
  } else if (static_cast<double>(input.grid->activeVoxelCount()) >=
             kFull * static_cast<double>(box.volume())) {
    input.extent = box;
  }
  return input;
}

}  // namespace

bool SuggestInput::isVector() const {
  return (y && z) || grid->isType<openvdb::Vec3SGrid>() || grid->isType<openvdb::Vec3DGrid>();
}

bool SuggestInput::isScalar() const {
  return !isVector() && (grid->isType<openvdb::FloatGrid>() || grid->isType<openvdb::DoubleGrid>());
}

Guess suggest(const GuessNames& names, const std::vector<SuggestInput>& grids, GuessFor what) {
  Draft draft(names);
  std::vector<Candidate> candidates = nameGrids(grids, draft);
  for (Candidate& candidate : candidates) classify(candidate, what);
  chooseGrids(candidates, what, draft);
  return draft.write();
}

std::string suggestScene(const std::string& vdb_file, const std::vector<SuggestInput>& grids) {
  return suggest({vdb_file, "", ""}, grids).scene;
}

}  // namespace palpate::guess

namespace palpate {

Guess guessScene(const GuessNames& names, const std::vector<GuessVolume>& volumes, GuessFor what) {
  std::vector<guess::SuggestInput> inputs;
  inputs.reserve(volumes.size());
  for (const GuessVolume& volume : volumes) inputs.push_back(guess::inputFrom(volume));
  return guess::suggest(names, inputs, what);
}

}  // namespace palpate
