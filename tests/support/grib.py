"""Writes GRIB with ecCodes, from its own samples."""
import ctypes
import ctypes.util


def library():
    """Returns ecCodes, or None if it is not installed."""
    found = ctypes.util.find_library("eccodes")
    return ctypes.CDLL(found) if found else None


def write(path, messages):
    """messages: (sample, {key: number or text}, values). Without values (None) the sample's own are written."""
    lib = library()
    lib.codes_grib_handle_new_from_samples.restype = ctypes.c_void_p
    for index, (sample, keys, values) in enumerate(messages):
        handle = ctypes.c_void_p(lib.codes_grib_handle_new_from_samples(None, sample.encode()))
        if not handle:
            raise OSError(f"no sample {sample}")

        def call(name, *words):
            status = getattr(lib, name)(handle, *words)
            if status != 0:
                raise OSError(f"{name} {words[:1]}: {status}")

        for key, value in keys.items():
            if isinstance(value, str):
                length = ctypes.c_size_t(len(value) + 1)
                call("codes_set_string", key.encode(), value.encode(), ctypes.byref(length))
            elif isinstance(value, float):
                call("codes_set_double", key.encode(), ctypes.c_double(value))
            else:
                call("codes_set_long", key.encode(), ctypes.c_long(value))
        if values is not None:
            array = (ctypes.c_double * len(values))(*values)
            call("codes_set_double_array", b"values", array, ctypes.c_size_t(len(values)))
        call("codes_write_message", str(path).encode(), b"a" if index else b"w")
        lib.codes_handle_delete(handle)
    return path
