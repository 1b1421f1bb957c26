#include "palpate/scenes/apps/common/ray_search.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace palpate::cli {
namespace {

constexpr int kLeastRays = 256;
constexpr int kMostRays = 4096;
// After kLeastRays rays, the search ends once each mode acted on this number of rays.
constexpr int kEnough = 32;
constexpr int kSteps = 96;               // steps along a ray as long as the diagonal of the range
constexpr double kFiner = 32.0;          // quotient of the longest and the shortest step
constexpr long kMostReads = 1000000;     // about the largest number of field readings
constexpr std::size_t kMostBoxes = 512;  // largest number of boxes of parts

/// Returns boxes of fields, guides and parts, in which contacts are possible at `time` [s].
std::vector<Box> boxesOf(const Scene& scene, double time) {
  std::vector<Box> boxes;
  const auto add = [&](const Box& at_rest, int motion) {
    if (at_rest.empty() || !at_rest.lower.allFinite() || !at_rest.upper.allFinite()) return;
    if (motion < 0) return boxes.push_back(at_rest);
    const Motion& moves = *scene.graph.motions[static_cast<std::size_t>(motion)];
    const Box rest = moves.deformed(at_rest);
    const Pose pose = moves.poseAt(time);
    Box moved;
    for (int corner = 0; corner < 8; ++corner) {
      moved.extend(pose({(corner & 1) != 0 ? rest.upper.x() : rest.lower.x(),
                         (corner & 2) != 0 ? rest.upper.y() : rest.lower.y(),
                         (corner & 4) != 0 ? rest.upper.z() : rest.lower.z()}));
    }
    boxes.push_back(moved);
  };
  const Graph& graph = scene.graph;
  for (std::size_t i = 0; i < graph.scalar_frames.size(); ++i) {
    add(graph.scalar_frames[i].bounds, graph.scalar_motions[i]);
  }
  for (std::size_t i = 0; i < graph.vector_frames.size(); ++i) {
    add(graph.vector_frames[i].bounds, graph.vector_motions[i]);
  }
  // A guide has no volume: adds a box around the guide's position.
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    const auto* guide = std::get_if<GuideMode>(&graph.modes[i]);
    if (guide == nullptr) continue;
    const Vec3 about = Vec3::Constant(std::min(guide->snap, 0.01));
    add({guide->position - about, guide->position + about}, graph.mode_motions[i]);
  }
  const std::size_t stride = 1 + scene.parts.size() / kMostBoxes;
  for (std::size_t i = 0; i < scene.parts.size(); i += stride) add(scene.parts[i].bounds, -1);
  return boxes;
}

/// Returns the n-th element of a low-discrepancy sequence in [0, 1)^5 (additive recurrence).
std::array<double, 5> spread(int n) {
  constexpr double kRoot = 1.1347241384015194;  // positive root of x^6 = x + 1
  std::array<double, 5> out{};
  double step = 1.0;
  for (double& value : out) {
    step /= kRoot;
    double whole = 0.0;
    value = std::modf(0.5 + step * (n + 1), &whole);
  }
  return out;
}

/// Moves the probe along a ray, and ends the ray where the opposing force exceeds kHardestPress.
/// Near that place it goes back and halves the step: a stiff surface may need less than a step.
void cast(SearchProbe& probe, ProbeRay& ray, double step) {
  probe.lift();
  const auto modes = probe.forces().size();
  ray.held.assign(modes, 0.0F);
  ray.depth.assign(modes, 0.0F);
  double pace = ray.length / std::max(1.0, std::ceil(ray.length / step));
  const double finest = pace / kFiner;
  double depth = 0.0;
  for (double next = 0.0;;) {
    probe.touch(ray.at(next), 0.0);
    const double against = -probe.force().dot(ray.along);
    if (against > kHardestPress) {
      pace *= 0.5;
      if (pace < finest || next == 0.0) {
        ray.length = next;
        break;
      }
      probe.touch(ray.at(depth), 0.0);
      next = depth + pace;
      continue;
    }
    depth = next;
    ray.hardest = std::max(ray.hardest, against);
    for (std::size_t i = 0; i < modes; ++i) {
      const auto held = static_cast<float>(-probe.forces()[i].dot(ray.along));
      if (!(held > ray.held[i])) continue;
      ray.held[i] = held;
      ray.depth[i] = static_cast<float>(depth);
    }
    if (depth >= ray.length) break;
    next = std::min(depth + pace, ray.length);
  }
}

}  // namespace

SearchProbe::SearchProbe(const Scene& scene) : scene_(scene) {
  std::size_t modes = scene.graph.modes.size();
  std::map<std::vector<std::string>, std::size_t> known;
  first_of_part_.reserve(scene.parts.size());
  for (const Part& part : scene.parts) {
    const auto [place, fresh] = known.try_emplace(part.graph.mode_names, modes);
    first_of_part_.push_back(place->second);
    if (fresh) modes += place->first.size();
  }
  forces_.resize(modes);
}

void SearchProbe::lift() {
  if (state_.faulted()) {
    state_.clearFault();
  } else {
    state_.release();
  }
}

void SearchProbe::touch(const Vec3& at, double dt) {
  report_ = hapticStep(scene_, reader_, {at}, state_, dt);
  reads_ += 1 + report_.samples + report_.traced;
  std::fill(forces_.begin(), forces_.end(), Vec3::Zero());
  if (report_.status == StepStatus::kFault) {
    report_.wanted.setZero();
    return;
  }
  std::size_t next = 0;
  for (std::size_t i = 0; i < scene_.graph.modes.size(); ++i) add(i, state_.memory(i), next);
  for (const std::uint8_t slot : state_.near().order()) {
    const NearPart& near = state_.near()[slot];
    for (std::size_t i = 0; i < near.modes; ++i) {
      add(first_of_part_[near.part] + i, near.memories[i], next);
    }
  }
}

void SearchProbe::add(std::size_t mode, const ModeMemory& memory, std::size_t& next) {
  const auto forces = state_.forces();
  const std::size_t end = next + static_cast<std::size_t>(memory.emitted);
  for (; next < end && next < forces.size(); ++next) forces_[mode] += forces[next];
}

std::pair<double, double> HandRange::part(const Vec3& p, const Vec3& u) const {
  const double middle = -p.dot(u);
  const double half = radius * radius - (p + middle * u).squaredNorm();
  if (!(half > 0.0)) return {0.0, 0.0};
  double from = middle - std::sqrt(half);
  double to = middle + std::sqrt(half);
  for (int i = 0; i < 3; ++i) {
    if (u[i] == 0.0) {
      if (p[i] < box.lower[i] || p[i] > box.upper[i]) return {0.0, 0.0};
      continue;
    }
    const double a = (box.lower[i] - p[i]) / u[i];
    const double b = (box.upper[i] - p[i]) / u[i];
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  return {from, std::max(from, to)};
}

HandRange handRangeOf(const Scene& scene, const Box& bounds, double radius) {
  HandRange within;
  within.radius = 0.98 * radius;
  within.box = bounds;
  for (const Box& box : boxesOf(scene, 0.0)) {
    within.box.extend(box.lower);
    within.box.extend(box.upper);
  }
  const Vec3 reach = Vec3::Constant(within.radius);
  const double about = std::clamp(0.1 * within.box.size().maxCoeff(), 2e-3, kClearance);
  const Vec3 lower = (within.box.lower.array() - about).matrix().cwiseMax(-reach);
  const Vec3 upper = (within.box.upper.array() + about).matrix().cwiseMin(reach);
  within.box = {lower, upper};
  if (within.box.empty()) within.box = {-reach, reach};  // the scene is outside the workspace
  return within;
}

RaySearch::RaySearch(const Scene& scene, const HandRange& within, double time, double share) {
  SearchProbe probe(scene);
  if (time > 0.0) {
    probe.touch(Vec3::Zero(), 0.0);
    probe.touch(Vec3::Zero(), time);
  }
  std::vector<Box> boxes = boxesOf(scene, time);
  std::vector<int> met(probe.forces().size());
  const double step = within.box.size().norm() / kSteps;
  const auto most = static_cast<long>(share * static_cast<double>(kMostReads));
  for (; rays_cast < share * kMostRays && probe.reads() < most; ++rays_cast) {
    if (rays_cast >= share * kLeastRays &&
        std::all_of(met.begin(), met.end(), [](int n) { return n >= kEnough; })) {
      break;
    }
    // Aims every second ray at the whole range, and each of the others at one box.
    const std::array<double, 5> at = spread(rays_cast);
    const auto n = static_cast<std::size_t>(rays_cast);
    const Box& box = n % 2 == 0 || boxes.empty() ? within.box : boxes[n / 2 % boxes.size()];
    Vec3 aim = box.lower + Vec3(at[0], at[1], at[2]).cwiseProduct(box.size());
    const double z = 2.0 * at[3] - 1.0;
    const double across = std::sqrt(std::max(0.0, 1.0 - z * z));
    const double turn = 2.0 * M_PI * at[4];
    ProbeRay ray;
    ray.along = {across * std::cos(turn), across * std::sin(turn), z};
    const auto [from, to] = within.part(aim, ray.along);
    if (!(to > from)) continue;
    ray.from = aim + from * ray.along;
    ray.length = to - from;
    cast(probe, ray, step);
    if (!(ray.hardest > kLeastContact)) continue;
    for (std::size_t i = 0; i < met.size(); ++i) met[i] += ray.held[i] > kLeastContact ? 1 : 0;
    rays.push_back(std::move(ray));
  }
  top.resize(met.size());
  for (const ProbeRay& ray : rays) {
    for (std::size_t i = 0; i < top.size(); ++i) {
      top[i] = std::max(top[i], static_cast<double>(ray.held[i]));
    }
  }
  reads = probe.reads();
}

}  // namespace palpate::cli
