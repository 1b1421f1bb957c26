/// Private to the importer: joins several DICOM series that are the time steps of one volume, such
/// as the phases of a 4-D CT.
#pragma once

#include <string>
#include <vector>

#include "palpate/scenes/apps/import/dicom_stack.h"

namespace palpate::importer {

/// Time steps in several series. The order follows the first of these that at least two series
/// state: a time or a number of the step, which is the same in all images of a series (kTimeTags);
/// a percentage in SeriesDescription, such as "Gated, 30%". Otherwise it follows AcquisitionTime,
/// which all images must state.
struct Phases {
  /// Copies of the files. All have the UID of the first series. Of kTimeTags, their images state
  /// only the time [s], or the number of the step.
  std::vector<File> files;
  std::vector<std::string> notes;  ///< One line for each series or kind of files left out.
  /// The reason why the series are not the steps of one volume; empty if they are. Then `files` and
  /// `notes` are empty.
  std::string problem;
};

/// Joins the series that can be volumes. If at least two series state a time, number or percentage,
/// leaves out those that do not. Series of one volume have equal modality, frame of reference,
/// positions, orientation, pixel spacing and size.
[[nodiscard]] Phases phasesOf(const std::vector<Series>& all);

}  // namespace palpate::importer
