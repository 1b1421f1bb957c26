/// Private to the importer: finds the numbers by which solvers mark points without data, such as
/// -9999 or 1e20.
#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/values.h"

namespace palpate::importer {

/// Returns the values with NaN at the points that a sentinel marks, so that nothing is interpolated
/// from a sentinel. If there is no sentinel, returns the values themselves. Adds a note for each
/// sentinel.
///
/// A sentinel is the lowest or the highest value of a component. It occurs at two points or more,
/// and differs from all other values by more than ten times their range (guess::noDataOf). Either
/// it is negative and no other value is, or its magnitude exceeds that of all others: ten times if
/// it is negative, a thousand times if it is positive. A component with at most 64 different values
/// has no sentinel, because the values may be labels.
/// @param name  Name of the array, for the notes.
[[nodiscard]] Values withoutSentinels(const Values& values, const std::string& name,
                                      std::vector<std::string>& notes);

}  // namespace palpate::importer
