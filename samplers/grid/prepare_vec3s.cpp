#include "palpate/samplers/grid/component_grid.h"
#include "palpate/samplers/grid/prepare_values.h"

namespace palpate::detail {

template ActiveBoxes prepareValues(openvdb::Vec3SGrid&, const LoadOptions&, bool, GridInfo&);
template openvdb::FloatGrid::Ptr componentGrid(const openvdb::Vec3SGrid&, int);

}  // namespace palpate::detail
