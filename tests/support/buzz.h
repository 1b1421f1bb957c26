/// Measures the vibration of the force on a hand that slides along the skin of a scan. The path is
/// low-passed far below 100 Hz, so force above 100 Hz comes from the data, the method or the
/// encoder steps. Compares penalty forces with the engine's forces.
#pragma once

#include <memory>
#include <vector>

#include "palpate/engine/field/field.h"

namespace palpate::bench {

/// Returns the distance [m] from an axis along z, through the point `axis`, to the skin: the
/// surface at which the field has the value `level`. Searches in the direction `angle` [rad], from
/// the distance `far` to `near` [m]. Returns 0 if it finds no skin.
///
/// @param sign  See ScalarField::firstFall: -1 if values inside the solid are above the level.
[[nodiscard]] double skinRadius(const ScalarField& field, double level, double sign,
                                const Vec3& axis, double angle, double far, double near,
                                FieldCache& cache);

/// How the hand moves.
enum class BuzzHand {
  kLed,      ///< The hand follows a path, independent of the force.
  kEncoder,  ///< Like kLed, with positions rounded to encoder steps of 25 um.
  /// The hand moves an arm of 0.15 kg and 0.5 N s/m through a grip of 300 N/m and 4 N s/m. The
  /// target of the grip follows the path, 1 mm deeper than kLed.
  kHeld,
};

/// Measurement of one method.
struct Buzz {
  double force = 0.0;  ///< Mean force [N].
  double power = 0.0;  ///< Power of the force above 100 Hz [N^2].
};
/// Returns the power of forces that were sampled at `rate` [Hz], from the frequency `least` [Hz] on
/// and without their mean [N^2]. Skips the first 500 forces; returns 0 if fewer than 1,024 follow.
[[nodiscard]] double powerAbove(const std::vector<Vec3>& forces, double least, double rate);
/// Returns by how much `one` vibrates less than `other` [dB]: compares the power above 100 Hz,
/// divided by the square of the mean force.
[[nodiscard]] double quieter(const Buzz& one, const Buzz& other);

/// Measurements of all methods in one slice.
struct Buzzes {
  /// Number of ticks in which the engine's proxy moved more than 50 um plus 4 times the hand's
  /// path, as when it leaves a groove. The first 501 ticks do not count. Clicks add power above 100
  /// Hz.
  int clicks = 0;
  /// Penalty force along the gradient of the cell's polynomial, which jumps at faces of cells.
  Buzz polynomial;
  Buzz continuous;  ///< Penalty force along the engine's gradient, which does not jump.
  Buzz engine;      ///< The engine's tick with an isosurface.
};

/// Path of a hand over a skin.
struct SkinWay {
  double level = 0.0;   ///< Value at the skin.
  bool above = true;    ///< True if the solid's values are above the level.
  double far = 0.12;    ///< Distance from the axis at which searches for the skin begin [m].
  double raise = 0.0;   ///< Height of the middle slice above the centre of the data [m].
  double apart = 4e-3;  ///< Distance between two slices [m].
  int slices = 7;
  double speed = 0.02;  ///< [m/s]
  BuzzHand hand = BuzzHand::kLed;
};

/// Moves a hand around the z axis through the centre of the data, for 5 s in each slice. The path
/// is 2 mm below the skin (3 mm for kHeld). Its radius is low-passed at 5 Hz, because hands do not
/// move faster. The stiffness is 500 N/m, the strength 3 N, and the rate 1 kHz.
[[nodiscard]] std::vector<Buzzes> feelBuzz(const std::shared_ptr<const ScalarField>& field,
                                           const SkinWay& way);

}  // namespace palpate::bench
