#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// Replaces the fill values of an array by NaN, and adds a note about each. Returns false if it has
/// none.
///
/// A fill value satisfies two conditions. First, programs write this number for missing data
/// (isFillNumber), or the number is the lowest stored integer (Values::lowestCode) or the negative
/// of another fill value. Second, the number is isolated: its distance to the data is at least the
/// range of the data. The data are the values of the same component that are not fill values. They
/// must differ, so an array of two labels stays unchanged; a note says so if one of them looks like
/// a fill value. A component has at most two fill values at each end of its range. Changes floats
/// and doubles in place. Converts whole numbers to floats or doubles, and may subtract an offset
/// from them (wholeOffset).
/// @param shared  Process group; all ranks find the same fill values.
bool hideFillValues(Array& array, std::vector<std::string>& notes, const Shared& shared);

/// Returns true for numbers that programs write for missing data: negative numbers from -999 down
/// whose digits begin with 999; powers of ten, and numbers whose digits begin with 999, if the
/// magnitude is at least 1e10 and at least 1e4 times `others`; the lowest integers of 16, 32 and 64
/// bits, and these integers plus one; all magnitudes above 1e30.
/// @param others  Largest magnitude of the other values.
[[nodiscard]] bool isFillNumber(double value, double others);

}  // namespace palpate::importer
