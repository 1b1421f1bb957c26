#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Prepares the arrays of a content for grids. Names become valid and unique; arrays with two
/// components get a third one, which is 0; tensors of images become scalars and vectors. Adds notes
/// about omitted arrays. Moves the pieces out of `content`. Throws VolumeError if no array is left,
/// or if an image has only one layer of voxels.
[[nodiscard]] std::vector<Piece> makeReady(Content& content, const std::string& file,
                                           std::vector<std::string>& notes);

/// Removes arrays that were not requested; keeps all if `fields` is empty. If a requested array is
/// missing, throws VolumeError with a list of the available arrays.
void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file);

/// Joins arrays that are the components of a vector by their names (components.h) and units, and
/// adds a note. If `fields` is not empty, makes only the vectors that it names.
void joinComponents(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
                    std::vector<std::string>& notes);

}  // namespace palpate::importer
