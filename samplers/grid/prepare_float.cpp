#include "palpate/samplers/grid/prepare_values.h"

namespace palpate::detail {

template openvdb::CoordBBox prepareValues(openvdb::FloatGrid&, const LoadOptions&, bool, GridInfo&);

}  // namespace palpate::detail
