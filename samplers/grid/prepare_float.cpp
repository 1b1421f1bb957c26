#include "palpate/samplers/grid/prepare_values.h"

namespace palpate::detail {

template ActiveBoxes prepareValues(openvdb::FloatGrid&, const LoadOptions&, bool, GridInfo&);

}  // namespace palpate::detail
