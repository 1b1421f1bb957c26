/// Private to code that uses OpenVDB: include it, in place of openvdb.h, in .cpp files and private
/// headers only. A source that instantiates a tree or a grid compiles all its virtual functions,
/// which takes much time and memory. Only grid_*.cpp compile those of the types below.
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
