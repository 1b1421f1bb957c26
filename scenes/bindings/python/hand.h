#pragma once

#include <memory>
#include <optional>
#include <string>
#include <tuple>

#include "palpate/engine/loop/play_clock.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/tick/step.h"
#include "palpate/scenes/bindings/python/python_module.h"

namespace palpate::python {

/// Returns the description of the device `path`. Its limits apply to every hand of a script.
[[nodiscard]] DeviceInfo pathInfo();

/// The hand of a script in a scene. Each call of step() runs one tick.
class Hand {
 public:
  Hand(std::shared_ptr<const Scene> scene, const PlayParams& play, double rate);

  /// Runs a tick with the probe at x, y, z [m], and returns the force [N]. `play` is the play time
  /// [s]; if unset, the scene's playback advances by one tick. Throws DeviceError.
  std::tuple<double, double, double> step(double x, double y, double z, std::optional<double> play);
  /// Moves the playback of sequences to a time [s]. The next step() without `play` continues from
  /// this time. The data fade in, as after each jump of play. Throws DeviceError.
  void seek(double seconds);
  void clear() { state_.clearFault(); }

  [[nodiscard]] py::tuple proxy() const;
  [[nodiscard]] std::string fault() const;
  [[nodiscard]] py::dict report() const;

 private:
  std::shared_ptr<const Scene> scene_;
  double dt_;
  PlayClock clock_;    ///< Clock for ticks if the script does not set the play time.
  PlayHead head_;      ///< State of `clock_` after the last tick.
  double play_ = 0.0;  ///< Play time of the last tick [s].
  Reader reader_;
  ProxyState state_;
  StepReport report_;
};

}  // namespace palpate::python
