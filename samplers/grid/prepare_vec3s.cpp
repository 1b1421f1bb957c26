#include "palpate/samplers/grid/prepare_values.h"

namespace palpate::detail {

template openvdb::CoordBBox prepareValues(openvdb::Vec3SGrid&, const LoadOptions&, bool, GridInfo&);
template openvdb::FloatGrid::Ptr componentGrid(const openvdb::Vec3SGrid&, int);

}  // namespace palpate::detail
