/// Runs VTK's readers and filters, and forwards their errors and progress.
#pragma once

#include <string>

#include <vtkAlgorithm.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Calls Update(). The first error that VTK reports, also from readers inside this one, is thrown
/// as VolumeError(what, why, remedy). `why` is VTK's message, shortened.
void run(
    vtkAlgorithm* algorithm, const std::string& what, const Progress& progress = nullptr,
    const std::string& remedy = "the file may be truncated or damaged: copy or export it again");

}  // namespace palpate::importer
