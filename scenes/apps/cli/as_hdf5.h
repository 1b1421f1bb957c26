/// Writes a recording as an HDF5 file, with the module palpate_hdf5.so.
#pragma once

#include <functional>
#include <string>

#include "palpate/devices/recording/recording.h"

namespace palpate::cli {

/// Loads the module. Throws Error about the output `path` if the module is missing.
void checkHdf5(const std::string& path);

/// Writes the whole recording. Throws Error if writing fails, and Interrupted after an interrupt.
/// If writeHdf5() throws, the file stays as it was.
///
/// Dataset `ticks`: one dimension, in compressed blocks. Its elements are compounds of all fields
/// of recordedFields() except `zero`; vectors are arrays. Dataset `scenes`: members `id` and
/// `text`. Attributes of the file: `rate` [Hz] and, as JSON, `units`, `device` and `about` of the
/// recording's header. Equal recordings give equal bytes.
///
/// The HDF5 library may not be thread-safe, so the calling thread makes all calls.
void writeHdf5(const Recording& recording, const std::string& path);

/// Type of the module's function. The function writes to `place`; its messages name the file
/// `name`. Before each block, the function calls `progress` with the finished part, 0 to 1;
/// `progress` may throw.
using Hdf5Writer = void(const Recording& recording, const std::string& place,
                        const std::string& name, const std::function<void(double)>& progress);

}  // namespace palpate::cli
