/// A hand that slides along a scan's skin: how much of the force is above 100 Hz, where nothing but
/// shape and noise of the data makes it. Penalty forces beside the engine.
#pragma once

#include <memory>
#include <vector>

#include "palpate/engine/field.h"

namespace palpate::bench {

/// How far out the skin is from an axis along z, coming from `far` to `near` [m]; 0: nowhere.
///
/// @param sign  As of ScalarField::firstFall: -1 where the solid's values are above the level.
[[nodiscard]] double skinRadius(const ScalarField& field, double level, double sign,
                                const Vec3& axis, double angle, double far, double near,
                                FieldCache& cache);

/// How the hand goes.
enum class BuzzHand {
  kLed,      ///< Along a path, whatever the force.
  kEncoder,  ///< The same, read in steps of 25 um.
  kHeld,     ///< On an arm of 0.15 kg and 0.5 N s/m, by a grip of 300 N/m and 4 N s/m, which goes
             ///< along the path 1 mm deeper.
};

/// Of one force.
struct Buzz {
  double force = 0.0;  ///< Mean [N].
  double power = 0.0;  ///< Above 100 Hz [N^2].
};
/// Power of forces at `rate` [Hz] above `least` [Hz], less their mean [N^2]; the first 500 do not
/// count.
[[nodiscard]] double powerAbove(const std::vector<Vec3>& forces, double least, double rate);
/// By how much `one` is quieter than `other`, at the same mean force [dB].
[[nodiscard]] double quieter(const Buzz& one, const Buzz& other);

/// Of a slice.
struct Buzzes {
  int clicks = 0;   ///< Ticks in which the engine's proxy went much farther than the hand: a groove
                    ///< had held it, or a ridge. They are of the shape, and heard above 100 Hz.
  Buzz polynomial;  ///< Penalty: depth by value and slope at the hand, pushed along the slope of
                    ///< the trilinear polynomial, which jumps at the faces of cells.
  Buzz continuous;  ///< The same with the engine's gradient.
  Buzz engine;      ///< The whole tick, an isosurface.
};

/// How a hand goes over a skin.
struct SkinWay {
  double level = 0.0;   ///< Of the skin.
  bool above = true;    ///< The solid's values are above it.
  double far = 0.12;    ///< From where the skin is looked for, from the axis [m].
  double raise = 0.0;   ///< Of the middle slice over the middle of the data [m].
  double apart = 4e-3;  ///< Slices [m].
  int slices = 7;
  double speed = 0.02;  ///< [m/s]
  BuzzHand hand = BuzzHand::kLed;
};

/// Goes about the axis along z through the middle of the data, 5 s in each slice, 2 mm below the
/// skin as a hand finds it that cannot follow what comes oftener than five times a second. 500 N/m,
/// at most 3 N, 1 kHz.
[[nodiscard]] std::vector<Buzzes> feelBuzz(const std::shared_ptr<const ScalarField>& field,
                                           const SkinWay& way);

}  // namespace palpate::bench
