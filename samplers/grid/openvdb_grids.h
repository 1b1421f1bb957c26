/// Private to code that uses OpenVDB. Include it in place of openvdb.h, in .cpp files and private
/// headers only.
///
/// Trees and grids have virtual functions. So a source that instantiates one also compiles all of
/// its reading and writing, for each type: 20 to 60 s and up to 2.4 GB a source. The trees and
/// grids of the supported types are compiled once, in grid_*.cpp, and only declared here.
#pragma once

#include <openvdb/openvdb.h>

extern template class openvdb::tree::Tree<openvdb::FloatTree::RootNodeType>;
extern template class openvdb::tree::Tree<openvdb::DoubleTree::RootNodeType>;
extern template class openvdb::tree::Tree<openvdb::Vec3STree::RootNodeType>;
extern template class openvdb::tree::Tree<openvdb::Vec3DTree::RootNodeType>;
extern template class openvdb::Grid<openvdb::FloatTree>;
extern template class openvdb::Grid<openvdb::DoubleTree>;
extern template class openvdb::Grid<openvdb::Vec3STree>;
extern template class openvdb::Grid<openvdb::Vec3DTree>;
