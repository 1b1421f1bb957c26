#include "palpate/scenes/guess/metadata.h"

#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/scenes/guess/suggest.h"

namespace palpate {

Metadata metadataOf(const Volume& volume) {
  return std::visit(
      [](const auto& grid) {
        const auto text = [&](const char* key) {
          const auto meta = grid->template getMetadata<openvdb::StringMetadata>(key);
          return meta ? meta->value() : std::string();
        };
        Metadata found;
        found.value_unit = text(kMetaValueUnit);
        found.length_unit = text(kMetaLengthUnit);
        found.ras = text(kMetaSpace) == "RAS";
        found.mesh = text(kMetaImportedFrom) == "mesh";
        const auto axial = grid->template getMetadata<openvdb::BoolMetadata>(guess::kMetaAxial);
        found.axial = axial && axial->value();
        return found;
      },
      volume.grid().parts.front().data);
}

}  // namespace palpate
