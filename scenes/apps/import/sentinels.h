/// Private to the importer: finds numbers, such as -9999, by which solvers mark missing data.
#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/values.h"

namespace palpate::importer {

/// Returns the values with NaN instead of sentinels, and adds a note for each sentinel.
///
/// A sentinel is the lowest or highest value of a component. It occurs at two points or more, and
/// differs from all other values by more than ten times their range (guess::noDataOf). It is the
/// only negative value, or its magnitude is ten times (negative) or a thousand times (positive)
/// that of all others. At most 64 different values may be labels and have no sentinel.
[[nodiscard]] Values withoutSentinels(const Values& values, const std::string& name,
                                      std::vector<std::string>& notes);

}  // namespace palpate::importer
