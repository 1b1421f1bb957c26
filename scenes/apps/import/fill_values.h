#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// Replaces fill values of an array by NaN, and adds a note about each. A fill value is a number
/// that programs write for missing data (isFillNumber), at a distance of at least the range of all
/// other values. The other values must differ, so labels stay unchanged. Changes floats and doubles
/// in place. All ranks find the same fill values.
void hideFillValues(Array& array, std::vector<std::string>& notes, const Shared& shared);

/// Returns true for numbers that programs write for missing data: -999, -9999 and more numbers
/// with 999 as their first digits; powers of ten from 1e10 on; the lowest integers of 16, 32 and 64
/// bits, and these plus one; all numbers beyond 1e30.
[[nodiscard]] bool isFillNumber(double value);

}  // namespace palpate::importer
