#include "tests/support/rubbing.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <utility>
#include <variant>
#include <vector>

#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/buzz.h"
#include "tests/support/motion_problems.h"

namespace palpate::bench {

namespace {

constexpr double kPressed = 1e-3;     // depth below the skin [m]
constexpr double kArc = 0.05;         // length of a slide [m]
constexpr double kHandFollows = 5.0;  // fastest change that a hand follows [Hz]
constexpr double kBetween = 0.012;    // distance of two slices [m]
constexpr int kArcs = 4;
constexpr int kRays = 5000;     // number of rays around a slice
constexpr double kFar = 0.14;   // distance from the axis at which rays start [m]
constexpr double kNear = 0.02;  // distance from the axis at which rays end [m]
constexpr double kHolds = 5.0;  // strength of the surface [N]

/// Distance of the skin from an axis along z, as a function of the angle.
class Outline {
 public:
  /// @param window  Path length over which distances are averaged [m].
  Outline(const ScalarField& field, double z, double level, double window)
      : z_(z), radius_(kRays, 0.0) {
    auto cache = std::make_unique<FieldCache>();
    field.reset(*cache);
    std::vector<double> found(kRays, 0.0);
    for (int i = 0; i < kRays; ++i) {
      found[static_cast<std::size_t>(i)] =
          skinRadius(field, level, -1.0, {0.0, 0.0, z_}, angle(i), kFar, kNear, *cache);
    }
    constexpr double kTypical = 0.08;  // radius of a head [m]
    const int half =
        std::max(1, static_cast<int>(window / kTypical / (4.0 * std::numbers::pi) * kRays));
    for (int i = 0; i < kRays; ++i) {
      double sum = 0.0;
      int count = 0;
      for (int k = -half; k <= half; ++k) {
        const double r = found[static_cast<std::size_t>((i + k + kRays) % kRays)];
        if (r <= 0.0) continue;
        sum += r;
        ++count;
      }
      radius_[static_cast<std::size_t>(i)] = count > 0 ? sum / count : kTypical;
    }
  }

  [[nodiscard]] double radius(double a) const {
    const double at = a / (2.0 * std::numbers::pi) * kRays;
    const auto i = static_cast<long>(std::floor(at));
    const double f = at - static_cast<double>(i);
    const auto r = [&](long n) {
      return radius_[static_cast<std::size_t>(((n % kRays) + kRays) % kRays)];
    };
    return (1.0 - f) * r(i) + f * r(i + 1);
  }
  /// Returns the point at an angle and a depth below the skin.
  [[nodiscard]] Vec3 at(double a, double depth) const {
    const double r = radius(a) - depth;
    return {r * std::cos(a), r * std::sin(a), z_};
  }

 private:
  static double angle(int i) { return 2.0 * std::numbers::pi * i / kRays; }

  double z_;
  std::vector<double> radius_;
};

constexpr int kComing = 300;  // number of ticks of the approach, which begins 4 mm outside

/// Returns the hand's positions on a slide, `parts` per tick: an approach of kComing ticks, then
/// the arc.
std::vector<Vec3> slideAlong(const Outline& skin, int arc, double speed, int parts) {
  double a = 2.0 * std::numbers::pi * arc / kArcs;
  std::vector<Vec3> hands;
  for (int i = 0; i <= kComing * parts; ++i) {
    hands.push_back(skin.at(a, -4e-3 + (4e-3 + kPressed) * i / (kComing * parts)));
  }
  const auto ticks = static_cast<long>(kArc / speed / kMotionTick);
  for (long t = 0; t < ticks * parts; ++t) {
    a += speed * kMotionTick / parts / skin.radius(a);
    hands.push_back(skin.at(a, kPressed));
  }
  return hands;
}

SurfaceMotion onScan(const std::shared_ptr<const ScalarField>& field, double level) {
  SurfaceMotion motion;
  motion.field = field;
  motion.level = level;
  motion.solid = Solid::kAbove;
  return motion;
}

Outline outlineOf(const ScalarField& field, int slice, int slices, double level, double speed) {
  return {field, kBetween * (slice - 0.5 * (slices - 1)), level, speed / kHandFollows};
}

/// Returns the changes of the force from tick to tick [N]. `parts` is the number of positions per
/// tick.
std::vector<double> changesOf(const std::vector<Vec3>& hands, const Stepper& tick, int parts) {
  std::vector<double> changes;
  Vec3 before = Vec3::Zero();
  for (std::size_t i = 0; i < hands.size(); ++i) {
    const Vec3 force = kMotionStiffness * (tick(hands[i]).proxy - hands[i]);
    if (i % static_cast<std::size_t>(parts) != 0) continue;
    changes.push_back((force - before).norm());
    before = force;
  }
  return changes;
}

/// Sums over slides: squared noise of the force, its number of ticks, and energy added to the
/// spring.
struct Sums {
  double noise = 0.0;
  long noisy = 0;
  double given = 0.0;

  /// Adds the growth of the spring's energy when the proxy moves. Arguments: lengths of the spring
  /// before and after [m].
  void give(double before, double after) {
    given += 0.5 * kMotionStiffness * std::max(0.0, after * after - before * before);
  }
  void add(const std::vector<Vec3>& forces) {
    constexpr std::size_t kHalf = 5;  // half the number of ticks in a mean
    for (std::size_t i = kHalf; i + kHalf < forces.size(); ++i) {
      Vec3 mean = Vec3::Zero();
      for (std::size_t k = i - kHalf; k < i + kHalf; ++k) mean += forces[k] / (2.0 * kHalf);
      noise += (forces[i] - mean).squaredNorm();
      ++noisy;
    }
  }
};

}  // namespace

std::shared_ptr<const ScalarField> scanField(const std::string& file, double scale) {
  const auto volume = loadVolume(file, "");
  Placement placement;
  placement.scale = scale;
  placement.translate = -scale * volume->info().bounds.centre();
  const FieldPtr any = makeVdbField(volume, placement);
  const auto* field = std::get_if<std::shared_ptr<const ScalarField>>(&any);
  if (field == nullptr) throw std::runtime_error(file + ": its first grid holds no scalars");
  return *field;
}

Rubbing rub(const std::string& file, double level, double scale, double speed, int slices) {
  const std::shared_ptr<const ScalarField> field = scanField(file, scale);
  const SurfaceMotion motion = onScan(field, level);
  Rubbing out;
  Sums engine;
  Sums held;
  for (int slice = 0; slice < slices; ++slice) {
    const Outline skin = outlineOf(*field, slice, slices, level, speed);
    for (int arc = 0; arc < kArcs; ++arc) {
      const Stepper tick = engineOn(motion, ModeKind::kIsosurface, {}, kHolds);
      const std::vector<Vec3> hands = slideAlong(skin, arc, speed, 1);
      Vec3 proxy;
      for (int i = 0; i <= kComing; ++i) proxy = tick(hands[static_cast<std::size_t>(i)]).proxy;
      Vec3 back = proxy;  // the proxy of the comparison, which is held back
      std::vector<Vec3> ours;
      std::vector<Vec3> theirs;
      for (std::size_t t = kComing + 1; t < hands.size(); ++t) {
        const Vec3& hand = hands[t];
        const double before = (proxy - hand).norm();
        const double reach = (back - hand).norm();
        const Ticked r = tick(hand);
        proxy = r.proxy;
        const double asked = (proxy - hand).norm();
        back = asked <= reach ? proxy : Vec3(hand + reach / asked * (proxy - hand));
        engine.give(before, asked);
        held.give(reach, (back - hand).norm());
        ours.push_back(kMotionStiffness * (proxy - hand));
        theirs.push_back(kMotionStiffness * (back - hand));
        out.force += ours.back().norm();
        out.injected += r.injected;
        out.samples += r.samples;
        out.unfinished += r.capped ? 1.0 : 0.0;
      }
      engine.add(ours);
      held.add(theirs);
      ++out.slides;
      out.ticks += static_cast<long>(hands.size()) - kComing - 1;
    }
  }
  const auto ticks = static_cast<double>(out.ticks);
  out.metres = ticks * kMotionTick * speed;
  out.force /= ticks;
  out.samples /= ticks;
  out.unfinished /= ticks;
  out.injected /= out.metres;
  const auto of = [&](const Sums& sums) {
    return Felt{std::sqrt(sums.noise / static_cast<double>(sums.noisy)), sums.given / out.metres};
  };
  out.engine = of(engine);
  out.held = of(held);
  return out;
}

Rattling rattle(const std::string& file, double level, double scale, double speed, int slices) {
  const std::shared_ptr<const ScalarField> field = scanField(file, scale);
  const SurfaceMotion motion = onScan(field, level);
  constexpr int kParts = 16;  // number of the reference's steps per tick
  constexpr std::size_t kBeside = 20;
  StepParams exact;
  exact.tolerance_voxels = 1e-4;
  exact.max_substeps = 64;
  Rattling out;
  for (int slice = 0; slice < slices; ++slice) {
    const Outline skin = outlineOf(*field, slice, slices, level, speed);
    for (int arc = 0; arc < kArcs; ++arc) {
      const auto ours = changesOf(slideAlong(skin, arc, speed, 1),
                                  engineOn(motion, ModeKind::kIsosurface, {}, kHolds), 1);
      const auto theirs = changesOf(slideAlong(skin, arc, speed, kParts),
                                    engineOn(motion, ModeKind::kIsosurface, exact, kHolds), kParts);
      ++out.sites;
      for (std::size_t i = kComing + 1; i < ours.size(); ++i) {
        ++out.ticks;
        if (ours[i] <= Rattling::kLeap) continue;
        ++out.leaps;
        const std::size_t from = i > kBeside ? i - kBeside : 0;
        const std::size_t to = std::min(theirs.size(), i + kBeside);
        const double most = *std::max_element(theirs.begin() + static_cast<std::ptrdiff_t>(from),
                                              theirs.begin() + static_cast<std::ptrdiff_t>(to));
        if (2.0 * most >= ours[i]) continue;
        ++out.alone;
        out.largest = std::max(out.largest, ours[i]);
      }
    }
  }
  return out;
}

}  // namespace palpate::bench
