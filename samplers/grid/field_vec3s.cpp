#include "palpate/samplers/grid/grid_field.h"

namespace palpate::detail {

template FieldPtr makeField<openvdb::Vec3SGrid>(const std::shared_ptr<const Volume>&,
                                                const Placement&, const Sampling&);

}  // namespace palpate::detail
