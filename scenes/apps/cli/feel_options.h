/// Checks the options of `palpate feel` and `palpate view`.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "palpate/engine/safety/device.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/cli/session.h"

namespace palpate::cli {

inline constexpr double kFeelSeconds = 10.0;     ///< Default duration of a run [s].
inline constexpr double kMostFeelSeconds = 1e6;  ///< Longest duration of a run [s].

/// Returns true if the value of --device is a path from a file: path:FILE.csv.
[[nodiscard]] bool isPath(const std::string& device);
/// Returns true if the value of --device replays a recording: replay:FILE[@SECONDS].
[[nodiscard]] bool isReplay(const std::string& device);
/// Returns true if the value of --device is a simulated arm, with or without a simulated failure.
[[nodiscard]] bool isSimulated(const std::string& device);

/// Returns the name of a device in results: its own name, or "mouse" or "igtl" for a simulated arm
/// that a mouse or a client leads. `option` is the value of --device.
[[nodiscard]] std::string deviceName(const std::string& option, const DeviceInfo& device);

/// Returns the output file of a hand: for `asked` = "T.csv", T.csv, T.2.csv, T.3.csv and so on.
[[nodiscard]] std::string placeOf(const std::string& asked, std::size_t hand);

/// Throws Error if a value is out of range, or options cannot be combined. Prints a note about a
/// low rate.
void checkFeelOptions(const FeelOptions& options);
/// Throws Error if two outputs are the same, or an output is also an input of the run.
void checkFeelOutputs(const FeelOptions& options, const SceneInput& scene);
/// Returns the tick rate of ReplayDevices [Hz]. Throws Error if their rates differ from each other
/// or from the --rate that the user has set.
[[nodiscard]] double rateOfReplays(const std::vector<std::unique_ptr<Device>>& devices,
                                   const FeelOptions& options);

}  // namespace palpate::cli
