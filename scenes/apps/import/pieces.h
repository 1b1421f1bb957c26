#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Prepares the arrays of `content` for grids, and moves the pieces out of it. Names become valid
/// and unique. Arrays with two components get a third one, which is 0. Tensors of images become
/// scalars and vectors. Adds notes about omitted and converted arrays. Throws VolumeError if no
/// array is left, or if an image has a single point along an axis. The centres of another image's
/// cells may have a single point.
[[nodiscard]] std::vector<Piece> makeReady(Content& content, const std::string& file,
                                           std::vector<std::string>& notes);

/// Removes arrays that are not in `fields`; keeps all if `fields` is empty. If an array of `fields`
/// is missing, throws VolumeError with a list of the arrays.
void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file);

/// Joins arrays that are the components of a vector, by names (components.h) and units, and adds a
/// note. If `fields` is not empty, makes only the vectors in it.
void joinComponents(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
                    std::vector<std::string>& notes);

}  // namespace palpate::importer
