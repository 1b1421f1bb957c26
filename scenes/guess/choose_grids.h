/// Private to the scene guess: chooses the grids of a file that the scene uses.
#pragma once

#include <vector>

#include "palpate/scenes/guess/draft.h"

namespace palpate::guess {

/// Adds volumes and modes of the best candidates to a draft, and notes about the other candidates.
void chooseGrids(std::vector<Candidate>& candidates, GuessFor stated, Draft& draft);

}  // namespace palpate::guess
