#include "palpate/samplers/grid/smooth.h"

namespace palpate::detail {

template Smoothing smooth(openvdb::Vec3SGrid&, int);

}  // namespace palpate::detail
