#include "palpate/samplers/grid/derive_grid.h"

namespace palpate::detail {

template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                            const openvdb::FloatGrid&, Derivation);
template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                            const openvdb::Vec3SGrid&, Derivation);

}  // namespace palpate::detail
