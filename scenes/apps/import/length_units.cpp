#include "palpate/scenes/apps/import/length_units.h"

#include <algorithm>
#include <array>

#include "palpate/scenes/library/length_units.h"

namespace palpate::importer {
namespace {

constexpr std::array kWords{
    LengthUnit{"m", "m", 1.0},
    LengthUnit{"meter", "m", 1.0},
    LengthUnit{"cm", "cm", 1e-2},
    LengthUnit{"centimeter", "cm", 1e-2},
    LengthUnit{"mm", "mm", 1e-3},
    LengthUnit{"millimeter", "mm", 1e-3},
    LengthUnit{"um", "um", 1e-6},
    LengthUnit{"micrometer", "um", 1e-6},
    LengthUnit{"micron", "um", 1e-6},
    LengthUnit{"microns", "um", 1e-6},
    LengthUnit{"\xb5m", "um", 1e-6},      // Latin-1
    LengthUnit{"\xc2\xb5m", "um", 1e-6},  // UTF-8, the sign micro
    LengthUnit{"\xce\xbcm", "um", 1e-6},  // UTF-8, the letter mu
    LengthUnit{"\\u00B5m", "um", 1e-6},   // ImageJ's escape
    LengthUnit{"&#181;m", "um", 1e-6},    // XML
    LengthUnit{"&#xB5;m", "um", 1e-6},
    LengthUnit{"&#xb5;m", "um", 1e-6},
    LengthUnit{"nm", "nm", 1e-9},
    LengthUnit{"nanometer", "nm", 1e-9},
    LengthUnit{"angstrom", "angstrom", 1e-10},
    LengthUnit{"inch", "inch", 0.0254},
};

}  // namespace

const LengthUnit* lengthUnitOf(std::string_view word) noexcept {
  const auto* found = std::find_if(kWords.begin(), kWords.end(),
                                   [&](const LengthUnit& unit) { return unit.word == word; });
  return found == kWords.end() ? nullptr : found;
}

bool isSceneUnit(const LengthUnit& unit) noexcept {
  return std::any_of(kSceneUnits.begin(), kSceneUnits.end(), [&](const SceneUnit& known) {
    return std::string_view(known.name) == unit.unit;
  });
}

}  // namespace palpate::importer
