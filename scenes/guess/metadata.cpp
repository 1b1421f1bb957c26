#include "palpate/scenes/guess/metadata.h"

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
        Metadata said;
        said.value_unit = text(kMetaValueUnit);
        said.length_unit = text(kMetaLengthUnit);
        said.ras = text(kMetaSpace) == "RAS";
        said.mesh = text(guess::kMetaFrom) == "mesh";
        const auto axial = grid->template getMetadata<openvdb::BoolMetadata>(guess::kMetaAxial);
        said.axial = axial && axial->value();
        return said;
      },
      volume.grid().parts.front().data);
}

}  // namespace palpate
