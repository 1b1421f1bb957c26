#include "palpate/samplers/grid/grid_field.h"

namespace palpate::detail {

template FieldPtr makeField<openvdb::DoubleGrid>(const std::shared_ptr<const Volume>&,
                                                 const Placement&, const Sampling&);

}  // namespace palpate::detail
