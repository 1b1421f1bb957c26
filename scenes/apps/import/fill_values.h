#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// Replaces fill values of an array by NaN, and adds a note about each. Returns false if there are
/// none.
///
/// A fill value satisfies two conditions. First, programs write this number for missing data
/// (isFillNumber). Second, it stands alone: its distance to all other values of its component is at
/// least the range of these values. The other values must differ, so two labels stay unchanged. The
/// result is in the memory of the array if it has floats or doubles. From whole numbers it may
/// subtract an offset (wholeOffset).
/// @param shared  Process group. All ranks find the same fill values.
bool hideFillValues(Array& array, std::vector<std::string>& notes, const Shared& shared);

/// Returns true for numbers that programs write for missing data: -999, -9999 and more numbers
/// with 999 as their first digits; powers of ten from 1e10 on; the lowest integers of 16, 32 and 64
/// bits, and these plus one; all numbers beyond 1e30.
[[nodiscard]] bool isFillNumber(double value);

}  // namespace palpate::importer
