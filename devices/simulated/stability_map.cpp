#include "palpate/devices/simulated/stability_map.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>
#include <utility>

#include <Eigen/Geometry>
#include <tbb/parallel_for.h>

#include "palpate/devices/simulated/stability.h"
#include "palpate/engine/balance/coupling.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/tick/step.h"

namespace palpate {
namespace {

// [m]: a larger swing counts as MapOutcome::kLeaves. Beyond 5 times this distance, the arm has run
// away.
constexpr double kFar = 0.02;
constexpr double kMade = 1e-5;      // [J]: a cell is active if the hand gains more energy than this
constexpr std::size_t kCoarse = 8;  // spacing of the cells that are computed first
constexpr double kLastly = 0.75;    // share of the time after which the final behaviour is judged
// A swing decays if the ratio of its sizes in the last and the third quarter is below this value.
constexpr double kDying = 0.8;

Primitive plane(const Vec3& normal, double strength) {
  return {PrimitiveKind::kPlane, Vec3::Zero(), normal, strength};
}

}  // namespace

MapContact wallContact(double strength) {
  MapContact contact;
  contact.primitives = {plane(Vec3::UnitZ(), strength)};
  return contact;
}

MapContact troughContact(double degrees, double strength) {
  const double half = 0.5 * degrees * M_PI / 180.0;
  MapContact contact;
  contact.primitives = {plane(Vec3(std::sin(half), 0, std::cos(half)), strength),
                        plane(Vec3(-std::sin(half), 0, std::cos(half)), strength)};
  return contact;
}

MapMethod wrapBalance(const MapContact& contact, const std::string& name,
                      const MapBalance& balance) {
  const auto make = [contact, balance](double stiffness, double damping, double period) -> MapFeel {
    const CouplingParams coupling{stiffness, damping};
    return
        [=, start = std::optional<Vec3>(), rate = LengthRate()](const Vec3& probe) mutable -> Vec3 {
          const Vec3 offset = balance(probe, stiffness, contact.primitives, start.value_or(probe));
          start = probe + offset;
          return couplingForce(coupling, offset, rate.next(offset.norm(), period));
        };
  };
  return {name, make};
}

MapMethod solverOver(const MapContact& contact) {
  const auto solver = [](const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                         const Vec3& start) {
    return solveProxy(probe, stiffness, primitives, start, SolverParams{}).offset;
  };
  return wrapBalance(contact, "palpate", solver);
}

MapMethod wholeTick(const std::shared_ptr<const Scene>& scene, const Vec3& start) {
  const auto make = [scene, start](double stiffness, double damping, double period) -> MapFeel {
    struct Hand {
      Scene scene;
      Reader reader;
      ProxyState state;
    };
    const auto hand = std::make_shared<Hand>();
    hand->scene = *scene;
    hand->scene.coupling = {stiffness, damping};
    // Starts outside of the contact, as a hand does.
    (void)hapticStep(hand->scene, hand->reader, {start}, hand->state, period);
    return [=](const Vec3& probe) -> Vec3 {
      return hapticStep(hand->scene, hand->reader, {probe}, hand->state, period).wanted;
    };
  };
  return {"whole tick", make};
}

MapCell tryCoupling(const MapSetting& setting, const MapContact& contact, const MapFeel& feel) {
  // When the arm is at the contact, the hand's spring to this target presses with the load.
  const Vec3 aim = contact.place - setting.load / setting.grip.stiffness * contact.outwards;
  const Vec3 start =
      contact.place + setting.kick * (contact.outwards + contact.outwards.unitOrthogonal());
  const auto target = [=](double t) -> Vec3 { return t > 0.0 ? aim : start; };
  ArmParams arm = setting.arm;
  arm.tank = TankUse::kOff;
  SimulatedDevice device(arm, setting.grip, {target, 1e9}, setting.rate);
  const auto ticks = static_cast<long>(setting.seconds * setting.rate);
  const double dt = 1.0 / setting.rate;
  MapCell cell;
  double energy = 0.0;
  double least = 0.0;
  // The force that acts was sent `whole` ticks ago. For the fraction `part` of the tick, the
  // previous force still acts.
  const DelayInPeriods delay = inPeriods(setting.arm.delay, setting.rate);
  const auto whole = static_cast<std::size_t>(delay.whole);
  const double part = delay.part;
  std::vector<Vec3> sent(whole + 2, Vec3::Zero());
  Eigen::AlignedBox3d early;
  Eigen::AlignedBox3d lastly;
  double force = 0.0;
  long counted = 0;
  for (long i = 0; i < ticks; ++i) {
    Vec3 wanted = feel(device.read().position);
    if (!wanted.allFinite()) wanted.setZero();
    if (wanted.norm() > setting.peak) wanted *= setting.peak / wanted.norm();
    std::rotate(sent.begin(), sent.end() - 1, sent.end());
    sent[0] = wanted;
    const Vec3 before = device.position();
    device.write(wanted);
    const Vec3 moved = device.position() - before;
    const Vec3 acted = (1.0 - part) * sent[whole] + part * sent[whole + 1];
    energy +=
        -acted.dot(moved) + arm.viscous * moved.squaredNorm() / dt + arm.coulomb * moved.norm();
    least = std::min(least, energy);
    const auto share = static_cast<double>(i) / static_cast<double>(ticks);
    // Assumes that the effects of the first contact are over after half of the time.
    if (share > 0.5 && share <= kLastly) early.extend(device.position());
    if (share > kLastly) {
      lastly.extend(device.position());
      force += wanted.norm();
      ++counted;
    }
    if ((device.position() - contact.place).norm() > 5.0 * kFar) {
      cell.outcome = MapOutcome::kLeaves;
      cell.active = least < -kMade;
      cell.swing = (device.position() - contact.place).norm();
      return cell;
    }
  }
  cell.active = least < -kMade;
  cell.force = force / static_cast<double>(counted);
  cell.swing = 0.5 * lastly.diagonal().norm();
  const double first = 0.5 * early.diagonal().norm();
  // A swing of at most 2.5 encoder steps counts as rest, and so does a decaying swing.
  if (cell.swing <= 2.5 * std::max(arm.encoder, 1e-7) || cell.swing < kDying * first) {
    cell.outcome = MapOutcome::kRests;
  } else {
    cell.outcome = cell.swing > kFar ? MapOutcome::kLeaves : MapOutcome::kCycles;
  }
  return cell;
}

StabilityMap drawMap(const MapSetting& setting, const MapContact& contact, const MapMethod& method,
                     int size, double least_stiffness, double most_stiffness, double most_damping) {
  StabilityMap map;
  map.method = method.name;
  const auto n = static_cast<std::size_t>(size);
  for (std::size_t i = 0; i < n; ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(n - 1);
    map.stiffness.push_back(least_stiffness * std::pow(most_stiffness / least_stiffness, share));
    map.damping.push_back(i == 0 ? 0.0 : most_damping * std::pow(1e-3, 1.0 - share));
  }
  std::vector<std::optional<MapCell>> cells(n * n);
  std::vector<std::size_t> wanted;
  const auto draw = [&] {
    tbb::parallel_for(std::size_t{0}, wanted.size(), [&](std::size_t w) {
      const std::size_t at = wanted[w];
      const double k = map.stiffness[at % n];
      const double b = map.damping[at / n];
      cells[at] = tryCoupling(setting, contact, method.make(k, b, 1.0 / setting.rate));
    });
    map.tried += static_cast<long>(wanted.size());
    wanted.clear();
  };
  const auto alike = [](const MapCell& a, const MapCell& b) {
    return a.outcome == b.outcome && a.active == b.active;
  };
  std::size_t step = kCoarse;
  for (std::size_t row = 0; row < n; row += step) {
    for (std::size_t column = 0; column < n; column += step) wanted.push_back(row * n + column);
  }
  draw();
  for (; step > 1; step /= 2) {
    const std::size_t half = step / 2;
    std::vector<std::pair<std::size_t, MapCell>> same;
    for (std::size_t row = 0; row < n; row += half) {
      for (std::size_t column = 0; column < n; column += half) {
        if (cells[row * n + column]) continue;
        // Compares the coarse cells around this cell, or the two coarse cells between which this
        // cell lies.
        const MapCell& one = *cells[row / step * step * n + column / step * step];
        bool all = true;
        for (const std::size_t r : {row / step * step, (row + step - 1) / step * step}) {
          for (const std::size_t c : {column / step * step, (column + step - 1) / step * step}) {
            all = all && alike(one, *cells[r * n + c]);
          }
        }
        if (all) {
          same.emplace_back(row * n + column, one);
        } else {
          wanted.push_back(row * n + column);
        }
      }
    }
    draw();
    for (const auto& [at, cell] : same) cells[at] = cell;
  }
  for (const auto& cell : cells) map.cells.push_back(*cell);
  return map;
}

}  // namespace palpate
