#pragma once

#include <functional>
#include <string>

#include <vtkAlgorithm.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Calls Update(). Throws VolumeError(what, why, remedy) for the first error that VTK reports, also
/// in a nested reader. `why` has VTK's shortened message, or else its error code.
void run(
    vtkAlgorithm* algorithm, const std::string& what, const Progress& progress = nullptr,
    const std::string& remedy = "the file may be truncated or damaged: copy or export it again");

void runQuietly(const std::function<void()>& task);

}  // namespace palpate::importer
