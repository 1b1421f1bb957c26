"""Writes CGNS files with the library hdf5_serial."""
import ctypes
import ctypes.util
import struct

IDENTITY = ctypes.c_int64


class Writer:
    """A file of nodes. A node is an HDF5 group with a name, a label and data."""

    def __init__(self, path):
        self.lib = ctypes.CDLL(ctypes.util.find_library("hdf5_serial"))
        self.lib.H5open()
        for name in ("H5Fcreate", "H5Gcreate2", "H5Screate_simple", "H5Screate", "H5Dcreate2",
                     "H5Acreate2", "H5Tcopy", "H5Pcreate"):
            getattr(self.lib, name).restype = IDENTITY
        create = IDENTITY(self.lib.H5Pcreate(self.known("H5P_CLS_FILE_CREATE_ID_g")))
        self.lib.H5Pset_link_creation_order(create, 3)
        self.groups = IDENTITY(self.lib.H5Pcreate(self.known("H5P_CLS_GROUP_CREATE_ID_g")))
        self.lib.H5Pset_link_creation_order(self.groups, 3)
        self.file = IDENTITY(self.lib.H5Fcreate(str(path).encode(), 2, create, IDENTITY(0)))
        root = self.file
        self.describe(root, "HDF5 MotherNode", "Root Node of HDF5 File", "MT")
        self.data(root, b" format", "C1", [15], b"IEEE_LITTLE_32\0")
        self.data(root, b" hdf5version", "C1", [33], b"HDF5 Version 1.10.8".ljust(33, b"\0"))
        self.node(root, "CGNSLibraryVersion", "CGNSLibraryVersion_t", "R4", [1],
                  struct.pack("<f", 3.3))

    def known(self, name):
        return IDENTITY(IDENTITY.in_dll(self.lib, name).value)

    def kind(self, kind):
        return self.known({"C1": "H5T_NATIVE_SCHAR_g", "I4": "H5T_NATIVE_INT_g",
                           "R4": "H5T_NATIVE_FLOAT_g", "R8": "H5T_NATIVE_DOUBLE_g"}[kind])

    def attribute(self, group, name, text, length):
        kind = IDENTITY(self.lib.H5Tcopy(self.known("H5T_C_S1_g")))
        self.lib.H5Tset_size(kind, ctypes.c_size_t(length))
        space = IDENTITY(self.lib.H5Screate(0))
        at = IDENTITY(self.lib.H5Acreate2(group, name, kind, space, IDENTITY(0), IDENTITY(0)))
        self.lib.H5Awrite(at, kind, text.encode().ljust(length, b"\0"))
        self.lib.H5Aclose(at)

    def describe(self, group, name, label, kind):
        self.attribute(group, b"name", name, 33)
        self.attribute(group, b"label", label, 33)
        self.attribute(group, b"type", kind, 3)
        space = IDENTITY(self.lib.H5Screate_simple(1, (ctypes.c_uint64 * 1)(1), None))
        at = IDENTITY(self.lib.H5Acreate2(group, b"flags", self.kind("I4"), space, IDENTITY(0),
                                          IDENTITY(0)))
        self.lib.H5Awrite(at, self.kind("I4"), struct.pack("<i", 1))
        self.lib.H5Aclose(at)

    def data(self, group, name, kind, size, values):
        # CGNS uses Fortran's order: the first index is fastest.
        space = IDENTITY(self.lib.H5Screate_simple(
            len(size), (ctypes.c_uint64 * len(size))(*reversed(size)), None))
        at = IDENTITY(self.lib.H5Dcreate2(group, name, self.kind(kind), space, IDENTITY(0),
                                          IDENTITY(0), IDENTITY(0)))
        self.lib.H5Dwrite(at, self.kind(kind), IDENTITY(0), IDENTITY(0), IDENTITY(0), values)
        self.lib.H5Dclose(at)

    def node(self, parent, name, label, kind="MT", size=(), values=b""):
        group = IDENTITY(self.lib.H5Gcreate2(parent, name.encode(), IDENTITY(0), self.groups,
                                             IDENTITY(0)))
        self.describe(group, name, label, kind)
        if kind != "MT":
            self.data(group, b" data", kind, list(size), values)
        return group

    def close(self):
        self.lib.H5close()


def structured(path, size, place, arrays):
    """Writes a structured zone of `size` points at `place(i, j, k)`. `arrays` is {name: value(x, y, z)}."""
    writer = Writer(path)
    base = writer.node(writer.file, "Base", "CGNSBase_t", "I4", [2], struct.pack("<2i", 3, 3))
    sizes = [*size, *(n - 1 for n in size), 0, 0, 0]
    zone = writer.node(base, "Zone", "Zone_t", "I4", [3, 3], struct.pack("<9i", *sizes))
    writer.node(zone, "ZoneType", "ZoneType_t", "C1", [10], b"Structured")
    points = [place(i, j, k) for k in range(size[2]) for j in range(size[1])
              for i in range(size[0])]
    grid = writer.node(zone, "GridCoordinates", "GridCoordinates_t")
    for axis in range(3):
        writer.node(grid, f"Coordinate{'XYZ'[axis]}", "DataArray_t", "R8", size,
                    struct.pack(f"<{len(points)}d", *(p[axis] for p in points)))
    solution = writer.node(zone, "Solution", "FlowSolution_t")
    writer.node(solution, "GridLocation", "GridLocation_t", "C1", [6], b"Vertex")
    for name, value in arrays.items():
        writer.node(solution, name, "DataArray_t", "R8", size,
                    struct.pack(f"<{len(points)}d", *(value(*p) for p in points)))
    writer.close()
    return path
