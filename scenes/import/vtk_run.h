/// Runs VTK's readers and filters: their trouble becomes an error, their progress ours.
#pragma once

#include <string>

#include <vtkAlgorithm.h>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Update()s. The first error that VTK speaks of, also of readers inside this one, is thrown as
/// VolumeError(what, why, remedy), shortened to what it says.
void run(vtkAlgorithm* algorithm, const std::string& what, const Progress& progress = nullptr,
         const std::string& remedy = "it may be truncated or damaged: copy or export it again");

}  // namespace palpate::importer
