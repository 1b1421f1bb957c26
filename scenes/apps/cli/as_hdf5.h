/// Writes a recording as HDF5, if this program was built with it.
#pragma once

#include <string>

#include "palpate/devices/recording/recording.h"

namespace palpate::cli {

/// Throws Error if this program was built without the library.
void checkHdf5(const std::string& path);

/// Writes the whole recording; leaves no file on failure. Throws Error if writing fails, and
/// Interrupted.
///
/// `ticks` is a dataset of one dimension: a compound of recordedFields() without `zero`. Vectors
/// are arrays, in compressed blocks. `scenes` is a dataset of `id` and `text`. The file's
/// attributes are `rate` [Hz] and, as JSON, the fields of the recording's header: `units`,
/// `device`, `about`. The same recording gives the same bytes.
///
/// Calls the library only from this thread: the library does not support several.
void writeHdf5(const Recording& recording, const std::string& path);

}  // namespace palpate::cli
