#include "palpate/engine/modes/mode.h"

#include <algorithm>
#include <limits>
#include <type_traits>

#include <Eigen/Geometry>

#include "palpate/engine/modes/mode_place.h"

namespace palpate {
namespace {

bool emit(const ForceMode& mode, const EmitContext& place, std::monostate&) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return true;
  return place.add(PrimitiveKind::kForce, mode.sign * q, mode.strength(place.at),
                   {mode.sign * turnOf(v.value, v.jacobian), mode.strength.slope(place.at)});
}

bool follows(const ForceMode& mode) noexcept {
  const auto& factors = mode.strength.factors;
  return std::any_of(factors.begin(), factors.end(), [](const Transfer::Factor& factor) {
    return factor.scalar >= 0 && !factor.curve.isConstant();
  });
}

bool emit(const ViscosityMode& mode, const EmitContext& place, std::monostate&) noexcept {
  if (!place.scalar(mode.scalar).inside) return true;
  return place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.strength(place.at));
}

bool emit(const GuideMode& mode, const EmitContext& place, std::monostate&) noexcept {
  Primitive guide{mode.shape, mode.position, mode.direction};
  if (const Pose* pose = place.stand.pose; pose != nullptr) {
    guide.position = (*pose)(mode.position);
    guide.direction = pose->vector(mode.direction);
  }
  if (!(distanceTo(guide, place.stand.proxy) <= mode.snap)) return true;
  const double distance = distanceTo(guide, place.stand.probe) / mode.metres_per_unit;
  const double strength = mode.strength(place.at, distance);
  return place.add(guide.kind, guide.position, guide.direction, strength);
}

bool emit(const UserMode& mode, const EmitContext& place, std::monostate&) noexcept {
  return mode.place(mode.state.get(),
                    {place.at, mode.reads, place.stand.proxy, place.stand.probe, place.stand.read,
                     place.stand.foreseen},
                    place.set);
}

}  // namespace

double Transfer::operator()(const Properties& properties, double own) const noexcept {
  double product = factors.empty() ? 0.0 : 1.0;
  for (const Factor& factor : factors) {
    if (factor.scalar < 0) {
      product *= factor.curve(own);
      continue;
    }
    const Properties::Scalar& input = properties.scalars[static_cast<std::size_t>(factor.scalar)];
    product *= input.inside ? factor.curve(input.value) : 0.0;
  }
  return product;
}

Vec3 Transfer::slope(const Properties& properties, double own) const noexcept {
  Vec3 sum = Vec3::Zero();
  for (const Factor& factor : factors) {
    if (factor.scalar < 0 || factor.curve.isConstant()) continue;
    const Properties::Scalar& input = properties.scalars[static_cast<std::size_t>(factor.scalar)];
    double rate = input.inside ? factor.curve.slope(input.value) : 0.0;
    if (rate == 0.0) continue;
    for (const Factor& other : factors) {
      if (&other == &factor) continue;
      if (other.scalar < 0) {
        rate *= other.curve(own);
        continue;
      }
      const Properties::Scalar& beside = properties.scalars[static_cast<std::size_t>(other.scalar)];
      rate *= beside.inside ? other.curve(beside.value) : 0.0;
    }
    sum += rate * input.slope;
  }
  return sum;
}

double Transfer::at(const Properties& properties, int index, double value) const noexcept {
  double product = factors.empty() ? 0.0 : 1.0;
  for (const Factor& factor : factors) {
    if (factor.scalar < 0 || factor.scalar == index) {
      product *= factor.curve(value);
      continue;
    }
    const Properties::Scalar& input = properties.scalars[static_cast<std::size_t>(factor.scalar)];
    product *= input.inside ? factor.curve(input.value) : 0.0;
  }
  return product;
}

double Transfer::anywhere(const Properties& properties) const noexcept {
  double product = factors.empty() ? 0.0 : 1.0;
  for (const Factor& factor : factors) {
    const bool reads = factor.scalar >= 0;
    product *= factor.curve(
        reads ? properties.scalars[static_cast<std::size_t>(factor.scalar)].value : 0.0);
  }
  return product;
}

ModeMemory memoryFor(const Mode& mode) noexcept {
  ModeMemory memory;
  std::visit([&](const auto& m) { memory.of = typename std::decay_t<decltype(m)>::Memory{}; },
             mode);
  return memory;
}

bool addPrimitives(const Mode& mode, const Properties& properties, const EvaluationPoint& stand,
                   ModeMemory& memory, PrimitiveSet& set) noexcept {
  const std::size_t before = set.size();
  const EmitContext place{properties, stand, set};
  const bool room =
      std::visit([&](const auto& m) { return emit(m, place, memoryOf(m, memory)); }, mode);
  memory.emitted = static_cast<int>(set.size() - before);
  return room;
}

void carry(const Pose& by, ModeMemory& memory) noexcept {
  std::visit(
      [&](auto& m) {
        if constexpr (requires { m.contact; }) carry(by, m.contact);
        if constexpr (requires { m.before; }) (void)unit(by.vector(m.before), m.before);
        if constexpr (requires { m.anchor; }) {
          m.anchor = by(m.anchor);
          (void)unit(by.gradient(m.normal), m.normal);
        }
      },
      memory.of);
}

ContactReference touchOf(const Mode& mode, ModeMemory& memory) noexcept {
  return std::visit(
      [&](const auto& m) -> ContactReference {
        if constexpr (requires { m.skin; }) {
          auto& of = memoryOf(m, memory);
          return {&m.skin, &of.contact, levelOf(m, of)};
        }
        return {};
      },
      mode);
}

Side sideOf(const ModeMemory& memory) noexcept {
  return std::visit(
      [](const auto& m) {
        if constexpr (requires { m.side; }) return m.side;
        return Side::kUnknown;
      },
      memory.of);
}

SurfaceAhead surfaceAhead(const Mode& mode, ModeMemory& memory) noexcept {
  return std::visit(
      [&](const auto& m) -> SurfaceAhead {
        if constexpr (requires { ahead(m, memoryOf(m, memory)); }) {
          return ahead(m, memoryOf(m, memory));
        }
        return {};
      },
      mode);
}

Curve curveOf(const Mode& mode, ModeMemory& memory) noexcept {
  return std::visit(
      [&](const auto& m) -> Curve {
        if constexpr (requires { memoryOf(m, memory).on; }) {
          return {&memoryOf(m, memory).on, m.field, m.voxel};
        }
        return {};
      },
      mode);
}

double sliceOf(const Mode& mode, ModeMemory& memory) noexcept {
  const Curve curve = curveOf(mode, memory);
  const bool held = curve.on != nullptr && curve.on->holds && memory.emitted > 0;
  return held ? curve.voxel : std::numeric_limits<double>::infinity();
}

bool followsValue(const Mode& mode) noexcept {
  return std::visit(
      [](const auto& m) {
        if constexpr (requires { follows(m); }) return follows(m);
        return false;
      },
      mode);
}

void readLoads(const Mode& mode, std::span<const Primitive> primitives,
               std::span<const Vec3> forces, ModeMemory& memory) noexcept {
  std::visit(
      [&](const auto& m) {
        auto& of = memoryOf(m, memory);
        if constexpr (requires { of.contact; }) readLoad(of.contact, primitives, forces);
        if constexpr (requires { of.contact, of.holds; }) {
          of.holds = of.contact.load == Load::kHeld;
        }
      },
      mode);
}

void followYielding(const Mode& mode, ModeMemory& memory) noexcept {
  const ContactReference touch = touchOf(mode, memory);
  if (touch.skin != nullptr && touch.contact->plane >= 0) touch.contact->load = Load::kYielding;
}

void settle(const Mode& mode, const Vec3& proxy, bool arrived, ModeMemory& memory) noexcept {
  std::visit(
      [&](const auto& m) {
        auto& of = memoryOf(m, memory);
        if constexpr (requires { of.contact; }) of.contact.touched = false;
        if constexpr (requires { settle(m, proxy, arrived, of); }) settle(m, proxy, arrived, of);
      },
      mode);
}

}  // namespace palpate
