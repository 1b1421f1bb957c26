#include "palpate/engine/tick/step_report.h"

#include "palpate/engine/tick/step_trace.h"

namespace palpate {

const char* wordFor(StepStatus status) noexcept {
  switch (status) {
    case StepStatus::kConverged:
      return "converged";
    case StepStatus::kHairpin:
      return "hairpin";
    case StepStatus::kSubstepLimit:
      return "substep-limit";
    case StepStatus::kIterationLimit:
      return "iteration-limit";
    case StepStatus::kDropped:
      return "dropped";
    case StepStatus::kFault:
      return "fault";
  }
  return "";
}

const char* wordFor(StepEnd end) noexcept {
  switch (end) {
    case StepEnd::kFree:
      return "free";
    case StepEnd::kVoxel:
      return "voxel";
    case StepEnd::kTrusted:
      return "trusted";
    case StepEnd::kSurface:
      return "surface";
    case StepEnd::kParts:
      return "parts";
  }
  return "";
}

}  // namespace palpate
