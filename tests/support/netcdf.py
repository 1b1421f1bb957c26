"""Writes netCDF files with the library netcdf."""
import ctypes
import ctypes.util

BYTE, CHAR, SHORT, INT, FLOAT, DOUBLE = 1, 2, 3, 4, 5, 6
NUMBERS = {BYTE: ctypes.c_byte, SHORT: ctypes.c_short, INT: ctypes.c_int,
           FLOAT: ctypes.c_float, DOUBLE: ctypes.c_double}
CLASSIC, NETCDF4 = 0, 0x1000


def write(path, dimensions, variables, title="", form=CLASSIC, packed=False, attributes=None):
    """Writes a file. `dimensions` is {name: length}, `variables` is {name: (type, dimensions, attributes, values)},
    `attributes` are those of the file. If `packed` is true, variables of three or more dimensions are compressed."""
    library = ctypes.CDLL(ctypes.util.find_library("netcdf"))

    def call(name, *words):
        status = getattr(library, name)(*words)
        if status != 0:
            raise OSError(f"{name}: {status}")

    size = ctypes.c_size_t
    file = ctypes.c_int()
    call("nc_create", str(path).encode(), form, ctypes.byref(file))

    def attribute(variable, name, value):
        if isinstance(value, str):
            call("nc_put_att_text", file, variable, name.encode(), size(len(value)),
                 value.encode())
            return
        kind, numbers = value
        call("nc_put_att", file, variable, name.encode(), kind, size(len(numbers)),
             (NUMBERS[kind] * len(numbers))(*numbers))

    ids = {}
    for name, length in dimensions.items():
        ids[name] = ctypes.c_int()
        call("nc_def_dim", file, name.encode(), size(length), ctypes.byref(ids[name]))
    if title:
        attribute(-1, "title", title)
    for key, value in (attributes or {}).items():
        attribute(-1, key, value)
    made = []
    for name, (kind, along, own, values) in variables.items():
        variable = ctypes.c_int()
        call("nc_def_var", file, name.encode(), kind, len(along),
             (ctypes.c_int * len(along))(*(ids[d].value for d in along)), ctypes.byref(variable))
        for key, value in own.items():
            attribute(variable, key, value)
        if packed and len(along) > 2:
            call("nc_def_var_deflate", file, variable, 0, 1, 9)
        made.append((variable, kind, values))
    call("nc_enddef", file)
    for variable, kind, values in made:
        if values is not None:
            call("nc_put_var", file, variable, (NUMBERS[kind] * len(values))(*values))
    call("nc_close", file)
    return path
