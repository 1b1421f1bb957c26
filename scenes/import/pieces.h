/// What was read, made ready: arrays of one or three values, each with a name of its own.
#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Names become what grids can have, one each; two components get a third, which is 0; tensors of
/// images become what can be felt of them. What cannot be taken along is left out, and that is said
/// in `notes`. Takes the content's pieces. Throws VolumeError where there is nothing to feel: no
/// array, a flat image.
[[nodiscard]] std::vector<Piece> makeReady(Content& content, const std::string& file,
                                           std::vector<std::string>& notes);

/// Keeps the arrays that were asked for, all if none was. Throws VolumeError that lists what there
/// is.
void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file);

/// Arrays of one unit that are a vector's components by their names (components.h) become that
/// vector; a note tells of it. Where `fields` asks for arrays, only the vectors that it names.
void joinComponents(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
                    std::vector<std::string>& notes);

}  // namespace palpate::importer
