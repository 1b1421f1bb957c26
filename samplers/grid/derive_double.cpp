#include "palpate/samplers/grid/derive_grid.h"

namespace palpate::detail {

template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                            const openvdb::DoubleGrid&, Derivation);
template openvdb::GridBase::Ptr derivedGrid(const std::shared_ptr<const Volume>&,
                                            const openvdb::Vec3DGrid&, Derivation);

}  // namespace palpate::detail
