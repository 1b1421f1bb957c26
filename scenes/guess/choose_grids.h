/// Private to the scene guess: which grids of a file a scene uses.
#pragma once

#include <vector>

#include "palpate/scenes/guess/draft.h"

namespace palpate::guess {

/// Adds the volumes and modes of the best candidates to a draft, and records the others as left
/// out. Scores the scalars, and changes the reason of grids that are fractions of materials.
void chooseGrids(std::vector<Candidate>& candidates, GuessFor stated, Draft& draft);

}  // namespace palpate::guess
