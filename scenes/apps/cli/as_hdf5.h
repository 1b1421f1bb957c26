/// Writes a recording as an HDF5 file, with the module palpate_hdf5.so.
#pragma once

#include <functional>
#include <string>

#include "palpate/devices/recording/recording.h"

namespace palpate::cli {

/// Loads the module. Throws Error if the module is missing.
void checkHdf5(const std::string& path);

/// Writes the whole recording. Throws Error if writing fails, and Interrupted if the user ends the
/// program; then leaves no file.
///
/// The file has two datasets. `ticks` has one dimension. Its elements are compounds of all fields
/// of recordedFields() except `zero`; vectors are arrays. The dataset is stored in compressed
/// blocks. `scenes` has the members `id` and `text`. The attributes of the file are `rate` [Hz]
/// and, as JSON, the fields `units`, `device` and `about` of the recording's header. Equal
/// recordings give equal bytes.
///
/// All calls of the HDF5 library come from the calling thread, because the library does not support
/// several threads.
void writeHdf5(const Recording& recording, const std::string& path);

/// The function of the module: writes to `place`, and names the file `name` in messages. Calls
/// `progress` before each block with the finished part, from 0 to 1; `progress` may throw.
using Hdf5Writer = void(const Recording& recording, const std::string& place,
                        const std::string& name, const std::function<void(double)>& progress);

}  // namespace palpate::cli
