/// Private to the importer: makes a scene play the time steps of a file.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace palpate::importer {

/// Time steps, each of which has its own .vdb.
struct PlayedSteps {
  std::vector<double> times;   ///< Time of each step [`unit`]; at least two.
  std::optional<double> unit;  ///< Unit of `times` [s]; no value: not stated, or unknown.
  std::uint64_t largest = 0;   ///< Memory of the largest grid of a step [bytes].
  std::string file_of_guess;   ///< The step's .vdb for which the scene was guessed.
};

/// Returns `scene`, whose volumes have the pattern of all steps' files as "file", with the times of
/// the steps ("frames") and the settings of playback ("play"). Play begins at 0 with the first
/// step. Times at equal distances become a rate. Volumes of axial vectors cannot play: they get the
/// file `file_of_guess`. Adds notes about assumptions.
[[nodiscard]] std::string playScene(const std::string& scene, const PlayedSteps& steps,
                                    std::vector<std::string>& notes);

}  // namespace palpate::importer
