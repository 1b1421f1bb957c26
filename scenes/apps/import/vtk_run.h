/// Runs VTK's readers and filters. Converts their errors to exceptions and reports their progress.
#pragma once

#include <functional>
#include <string>

#include <vtkAlgorithm.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Calls Update(). If VTK reports an error, throws VolumeError(what, why, remedy) for the first
/// one, even if a reader inside this one reports it. `why` is VTK's message, shortened.
void run(
    vtkAlgorithm* algorithm, const std::string& what, const Progress& progress = nullptr,
    const std::string& remedy = "the file may be truncated or damaged: copy or export it again");

/// Calls a task, and discards VTK's messages.
void runQuietly(const std::function<void()>& task);

}  // namespace palpate::importer
