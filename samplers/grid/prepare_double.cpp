#include "palpate/samplers/grid/prepare_values.h"

namespace palpate::detail {

template openvdb::CoordBBox prepareValues(openvdb::DoubleGrid&, const LoadOptions&, bool,
                                          GridInfo&);

}  // namespace palpate::detail
