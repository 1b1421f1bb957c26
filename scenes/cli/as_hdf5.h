/// A recording as HDF5, where this program was built with it.
#pragma once

#include <string>

#include "palpate/devices/recording.h"

namespace palpate::cli {

/// Throws Error where this program was built without the library.
void checkHdf5(const std::string& path);

/// Writes all of it, or nothing. Throws Error where that cannot be done, and Interrupted.
///
/// `ticks` is a dataset of one dimension: a compound of recordedFields() without `zero`, vectors as
/// arrays, in blocks that are compressed. `scenes` is one of `id` and `text`. The file's attributes
/// are `rate` [Hz] and, as JSON, what the recording's header says: `units`, `device`, `about`.
/// The same recording gives the same bytes.
///
/// The library is asked from this thread alone: it is not made for several.
void writeHdf5(const Recording& recording, const std::string& path);

}  // namespace palpate::cli
