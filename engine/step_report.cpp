#include "engine/step_report.h"

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

}  // namespace palpate
