#include "palpate/samplers/grid/derive.h"

#include <string>
#include <utility>
#include <variant>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/derive_grid.h"
#include "palpate/samplers/grid/prepare.h"

namespace palpate {
namespace {

void place(const Volume::Grid::Part& part, Prepared& prepared) {
  prepared.info.bounds =
      boxAbout(prepared.info.bounds, [&](const Vec3& p_I) { return part.toFile(p_I); });
  prepared.info.voxel = part.linear.colwise().norm().transpose();
  prepared.grid->parts.front().linear = part.linear;
  prepared.grid->parts.front().origin = part.origin;
  prepared.grid->parts.front().ends.inactive = part.ends.inactive;
}

}  // namespace

std::shared_ptr<const Volume> deriveVolume(const std::shared_ptr<const Volume>& volume,
                                           Derivation what) {
  const GridInfo& from = volume->info();
  const std::string where = "grid \"" + from.name + "\"";
  if (kindOf(what).of_vector != from.vector) {
    throw VolumeError(where, std::string("it is a ") + (from.vector ? "vector" : "scalar"),
                      std::string("for ") + wordFor(what) + " give a " +
                          (from.vector ? "scalar" : "vector") + " grid");
  }
  const Volume::Grid::Part& part = volume->grid().parts.front();
  const openvdb::GridBase::Ptr grid = std::visit(
      [&](const auto& data) { return detail::derivedGrid(volume, *data, what); }, part.data);
  // Data of a level set end at the border of its band, and so do those of the derived grid.
  if (from.grid_class == GridClass::kLevelSet) grid->setGridClass(openvdb::GRID_LEVEL_SET);
  if (from.grid_class == GridClass::kFog) grid->setGridClass(openvdb::GRID_FOG_VOLUME);

  Prepared out = prepare(std::string(wordFor(what)) + " of " + from.name, grid, {});
  if (out.info.non_finite > 0) {
    throw VolumeError(where,
                      std::string("its ") + wordFor(what) + " is outside the range of " +
                          out.info.type + " at " + std::to_string(out.info.non_finite) + " voxels",
                      "scale its values down");
  }
  if (!out.info.refusal.empty()) {
    throw VolumeError(where,
                      std::string("its ") + wordFor(what) + " has no data (" +
                          out.info.refusal.substr(0, out.info.refusal.find(": ")) + ")",
                      "give a grid whose components are active at the same voxels");
  }
  place(part, out);
  return std::make_shared<Volume>(std::move(out.info), std::move(out.grid));
}

}  // namespace palpate
