#include "palpate/samplers/prepare_values.h"

namespace palpate::detail {

template void prepareValues(openvdb::FloatGrid&, const LoadOptions&, bool, GridInfo&);

}  // namespace palpate::detail
