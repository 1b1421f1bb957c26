#include "palpate/samplers/grid/component_grid.h"
#include "palpate/samplers/grid/prepare_values.h"

namespace palpate::detail {

template ActiveBoxes prepareValues(openvdb::Vec3DGrid&, const LoadOptions&, bool, GridInfo&);
template openvdb::DoubleGrid::Ptr componentGrid(const openvdb::Vec3DGrid&, int);

}  // namespace palpate::detail
