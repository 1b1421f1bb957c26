#include "palpate/samplers/grid/openvdb_grids.h"

template class openvdb::tree::Tree<openvdb::Vec3STree::RootNodeType>;
template class openvdb::Grid<openvdb::Vec3STree>;
