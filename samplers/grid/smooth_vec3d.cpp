#include "palpate/samplers/grid/smooth.h"

namespace palpate::detail {

template Smoothing smooth(openvdb::Vec3DGrid&, int);

}  // namespace palpate::detail
