#include "palpate/samplers/grid/openvdb_grids.h"

template class openvdb::tree::Tree<openvdb::DoubleTree::RootNodeType>;
template class openvdb::Grid<openvdb::DoubleTree>;
