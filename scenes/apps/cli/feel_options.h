/// Checks the options of `palpate feel` and `palpate view`.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/safety/device.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/cli/session.h"

namespace palpate::cli {

inline constexpr double kFeelSeconds = 10.0;     ///< Default length of a run [s].
inline constexpr double kMostFeelSeconds = 1e6;  ///< Largest length of a run [s].

/// Returns whether a --device is a path from a file: path:FILE.csv.
[[nodiscard]] bool isPath(const std::string& device);
/// Returns whether a --device replays a recording: replay:FILE[@SECONDS].
[[nodiscard]] bool isReplay(const std::string& device);
/// Returns whether a --device is simulated, with or without a trouble.
[[nodiscard]] bool isSimulated(const std::string& device);

/// Returns the file of one hand among several: T.csv, T.2.csv, ...
[[nodiscard]] std::string placeOf(const std::string& asked, std::size_t hand);

/// Throws Error for the first invalid option.
void checkFeelOptions(const FeelOptions& options);
/// Throws Error if two outputs have the same path, or if an output is also an input.
void checkFeelOutputs(const FeelOptions& options, const SceneInput& scene);
/// Returns the rate of recorded hands [Hz]. All devices must be ReplayDevices. Throws Error if
/// their rates differ, or if the user has given another rate.
[[nodiscard]] double rateOfReplays(const std::vector<std::unique_ptr<Device>>& devices,
                                   const FeelOptions& options);

}  // namespace palpate::cli
