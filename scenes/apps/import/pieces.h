/// Prepares arrays for grids: one or three values, each array with a unique name.
#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Makes the arrays ready. Names become valid and unique names of grids; two components get a
/// third, which is 0; tensors of images become scalars and vectors that can be felt. Omitted arrays
/// are listed in `notes`. Takes the content's pieces. Throws VolumeError if no array is
/// left or an image is flat.
[[nodiscard]] std::vector<Piece> makeReady(Content& content, const std::string& file,
                                           std::vector<std::string>& notes);

/// Keeps the requested arrays, or all if `fields` is empty. If a requested array is missing, throws
/// VolumeError with a list of the available arrays.
void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file);

/// Joins arrays of one unit that are components of a vector by their names (components.h), with a
/// note for each vector. If `fields` is not empty, joins only the vectors that it names.
void joinComponents(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
                    std::vector<std::string>& notes);

}  // namespace palpate::importer
