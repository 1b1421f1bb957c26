#include "palpate/scenes/apps/common/finder.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "palpate/engine/tick/step.h"

namespace palpate::cli {
namespace {

// Motion of the hand.
constexpr double kHardest = 5.0;    // [N]: limit of the pressing force
constexpr double kTravel = 0.1;     // [m/s]: between places
constexpr double kPressing = 0.05;  // [m/s]
constexpr double kStroking = 0.04;  // [m/s]
constexpr double kStroke = 1.4;     // [s] at one place
constexpr double kRest = 0.15;      // [s] at the hardest press
constexpr double kCircle = 4e-3;    // [m]: radius of a stroke
constexpr double kClear = 8e-3;     // [m]: distance before the contact at start and end
constexpr double kFine = 2.5e-4;    // [m]: steps at contacts
constexpr double kCoarse = 2e-3;    // [m]: steps between contacts
constexpr double kTouch = 0.02;     // [N]: less is no contact
constexpr double kFelt = 0.3;       // [N]: modes that bear less are worth less
constexpr double kPlan = 60.0;      // [s]: then the path begins again
constexpr std::size_t kMostStops = 3;

// Limits of the search.
constexpr int kLeastRays = 256;
constexpr int kMostRays = 4096;
constexpr int kEnough = 32;              // rays that met a mode
constexpr int kSteps = 96;               // steps of a ray through the whole scene
constexpr long kMostReads = 1000000;     // of fields
constexpr std::size_t kMostBoxes = 512;  // boxes to aim at

/// A probe that moves exactly to given places, and the force of each mode on it there. Modes of
/// parts with equal names count as one.
class ProbeRay {
 public:
  explicit ProbeRay(const Scene& scene) : scene_(scene) {
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

  /// Moves the probe away from everything, without memory of contacts.
  void lift() {
    if (state_.faulted()) {
      state_.clearFault();
    } else {
      state_.release();
    }
  }
  /// Evaluates a tick at a place; with dt = 0 the scene's time stands still.
  void touch(const Vec3& at, double dt) {
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

  [[nodiscard]] double time() const { return state_.time(); }
  /// Returns the force on the probe [N].
  [[nodiscard]] const Vec3& force() const { return report_.wanted; }
  [[nodiscard]] double stiffness() const { return report_.stiffness; }
  /// Returns the force of each mode [N]; their sum is the force without the coupling's damping.
  [[nodiscard]] const std::vector<Vec3>& forces() const { return forces_; }
  [[nodiscard]] long reads() const { return reads_; }

 private:
  void add(std::size_t mode, const ModeMemory& memory, std::size_t& next) {
    const auto forces = state_.forces();
    const std::size_t end = next + static_cast<std::size_t>(memory.emitted);
    for (; next < end && next < forces.size(); ++next) forces_[mode] += forces[next];
  }

  const Scene& scene_;
  Reader reader_;
  ProxyState state_;
  StepReport report_;
  std::vector<std::size_t> first_of_part_;
  std::vector<Vec3> forces_;
  long reads_ = 0;
};

/// Range of the hand: the scene with a small margin, within the arm's workspace.
struct Within {
  Box box;
  double radius = 0.0;

  /// Returns the part of a line, p + t u with unit u, that lies in the range: empty if first >=
  /// second.
  [[nodiscard]] std::pair<double, double> part(const Vec3& p, const Vec3& u) const {
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
};

/// A straight path of the probe, and the modes that acted against it.
struct Ray {
  Vec3 from = Vec3::Zero();
  Vec3 along = Vec3::UnitX();
  double length = 0.0;       ///< Up to the place where the probe would press too hard [m].
  std::vector<float> held;   ///< Largest force of each mode [N],
  std::vector<float> depth;  ///< and its place [m].
  double hardest = 0.0;      ///< Largest sum of the forces [N].

  [[nodiscard]] Vec3 at(double t) const { return from + t * along; }
};

/// Places on a ray where the hand presses one mode.
struct Stop {
  double stroke = 0.0;  ///< The mode bears much of its force here [m],
  double press = 0.0;   ///< and nearly all of it here [m].
};

/// Returns boxes of possible contacts, moved to their places at a time.
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
  // Modes without a volume.
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

/// Returns evenly spread numbers in [0, 1): the n-th element of a sequence in five dimensions.
std::array<double, 5> spread(int n) {
  constexpr double kRoot = 1.1347241384015194;  // x^6 = x + 1
  std::array<double, 5> out{};
  double step = 1.0;
  for (double& value : out) {
    step /= kRoot;
    double whole = 0.0;
    value = std::modf(0.5 + step * (n + 1), &whole);
  }
  return out;
}

/// All findings of the search at one time.
class Found {
 public:
  Found(const Scene& scene, const Within& within, double time, double share) : within_(within) {
    ProbeRay finger(scene);
    if (time > 0.0) {
      finger.touch(Vec3::Zero(), 0.0);
      finger.touch(Vec3::Zero(), time);
    }
    std::vector<Box> boxes = boxesOf(scene, time);
    std::vector<int> met(finger.forces().size());
    const double step = within.box.size().norm() / kSteps;
    const auto most = static_cast<long>(share * static_cast<double>(kMostReads));
    for (; rays_cast < share * kMostRays && finger.reads() < most; ++rays_cast) {
      if (rays_cast >= share * kLeastRays &&
          std::all_of(met.begin(), met.end(), [](int n) { return n >= kEnough; })) {
        break;
      }
      // Aim every other ray at the whole scene.
      const std::array<double, 5> at = spread(rays_cast);
      const auto n = static_cast<std::size_t>(rays_cast);
      const Box& box = n % 2 == 0 || boxes.empty() ? within.box : boxes[n / 2 % boxes.size()];
      Vec3 aim = box.lower + Vec3(at[0], at[1], at[2]).cwiseProduct(box.size());
      const double z = 2.0 * at[3] - 1.0;
      const double across = std::sqrt(std::max(0.0, 1.0 - z * z));
      const double turn = 2.0 * M_PI * at[4];
      Ray ray;
      ray.along = {across * std::cos(turn), across * std::sin(turn), z};
      const auto [from, to] = within.part(aim, ray.along);
      if (!(to > from)) continue;
      ray.from = aim + from * ray.along;
      ray.length = to - from;
      cast(finger, ray, step);
      if (!(ray.hardest > kTouch)) continue;
      for (std::size_t i = 0; i < met.size(); ++i) met[i] += ray.held[i] > kTouch ? 1 : 0;
      rays.push_back(std::move(ray));
    }
    top.resize(met.size());
    for (const Ray& ray : rays) {
      for (std::size_t i = 0; i < top.size(); ++i) {
        top[i] = std::max(top[i], static_cast<double>(ray.held[i]));
      }
    }
    reads = finger.reads();
  }

  std::vector<Ray> rays;    ///< Rays on which a mode acted.
  std::vector<double> top;  ///< Largest force of each mode on any ray [N].
  int rays_cast = 0;
  long reads = 0;

 private:
  static void cast(ProbeRay& finger, Ray& ray, double step) {
    finger.lift();
    const auto modes = finger.forces().size();
    ray.held.assign(modes, 0.0F);
    ray.depth.assign(modes, 0.0F);
    const int steps = std::max(1, static_cast<int>(std::ceil(ray.length / step)));
    for (int k = 0; k <= steps; ++k) {
      const double depth = ray.length * k / steps;
      finger.touch(ray.at(depth), 0.0);
      const double against = -finger.force().dot(ray.along);
      if (against > kHardest) {
        ray.length = depth;
        break;
      }
      ray.hardest = std::max(ray.hardest, against);
      for (std::size_t i = 0; i < modes; ++i) {
        const auto held = static_cast<float>(-finger.forces()[i].dot(ray.along));
        if (!(held > ray.held[i])) continue;
        ray.held[i] = held;
        ray.depth[i] = static_cast<float>(depth);
      }
    }
  }

  Within within_;
};

/// The stops on a ray, and the first contact.
struct Profile {
  double contact = 0.0;
  std::vector<Stop> stops;
};

Profile profileOf(ProbeRay& finger, const Ray& ray, const std::vector<double>& top) {
  // Repeat the ray in small steps.
  const int steps = std::max(1, static_cast<int>(std::ceil(ray.length / kFine)));
  std::vector<std::vector<float>> held;  // by mode
  held.resize(top.size());
  Profile profile;
  profile.contact = ray.length;
  finger.lift();
  const auto depth_at = [&](int k) { return ray.length * k / steps; };
  for (int k = 0; k <= steps; ++k) {
    finger.touch(ray.at(depth_at(k)), 0.0);
    if (-finger.force().dot(ray.along) > kHardest) break;
    if (finger.force().norm() > kTouch) profile.contact = std::min(profile.contact, depth_at(k));
    for (std::size_t i = 0; i < top.size(); ++i) {
      held[i].push_back(static_cast<float>(-finger.forces()[i].dot(ray.along)));
    }
  }
  std::vector<std::pair<double, Stop>> stops;  // by what they are worth
  for (std::size_t i = 0; i < top.size(); ++i) {
    if (held[i].empty()) continue;
    const float most = *std::max_element(held[i].begin(), held[i].end());
    if (!(most > kTouch) || most < 0.5 * top[i]) continue;
    const auto reach = [&](double share) {
      const auto at =
          std::find_if(held[i].begin(), held[i].end(), [&](float h) { return h >= share * most; });
      return depth_at(static_cast<int>(at - held[i].begin()));
    };
    stops.push_back({most, {reach(0.7), reach(0.95)}});
  }
  // Keep the strongest stops, in the order of contact; modes at equal depth share one stop.
  std::stable_sort(stops.begin(), stops.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  for (const auto& [worth, stop] : stops) {
    const bool alone =
        std::all_of(profile.stops.begin(), profile.stops.end(),
                    [&, at = stop.press](const Stop& s) { return std::abs(s.press - at) > 2e-3; });
    if (alone && profile.stops.size() < kMostStops) profile.stops.push_back(stop);
  }
  std::sort(profile.stops.begin(), profile.stops.end(),
            [](const Stop& a, const Stop& b) { return a.press < b.press; });
  if (profile.stops.empty()) profile.stops.push_back({0.5 * ray.length, 0.5 * ray.length});
  return profile;
}

/// A path; the probe follows it first.
class Plan {
 public:
  Plan(const Scene& scene, const Within& within)
      : scene_(scene), within_(within), finger_(scene), scout_(scene) {
    credit_.resize(finger_.forces().size());
    felt_.resize(credit_.size());
  }

  [[nodiscard]] double time() const { return path_.empty() ? 0.0 : path_.back().t; }
  [[nodiscard]] std::vector<PathPoint> take() { return std::move(path_); }
  [[nodiscard]] long reads() const { return finger_.reads() + scout_.reads(); }

  /// Returns the ray that is worth most now, and its main mode; null if the search found no ray.
  [[nodiscard]] std::pair<const Ray*, std::size_t> choose(const Found& found) const {
    std::pair<const Ray*, std::size_t> best{nullptr, 0};
    double most = 0.0;
    for (const Ray& ray : found.rays) {
      double worth = 0.0;
      std::size_t main = 0;
      double mains = -1.0;
      for (std::size_t i = 0; i < credit_.size(); ++i) {
        if (!(found.top[i] > kTouch)) continue;
        const double seldom = 1.0 / ((1.0 + credit_[i]) * (1.0 + credit_[i]));
        const double share = ray.held[i] / found.top[i];
        const double w = seldom * std::min(1.0, found.top[i] / kFelt) * share * share;
        worth += w;
        if (w > mains) {
          mains = w;
          main = i;
        }
      }
      worth *= std::min(1.0, ray.hardest / kFelt);
      const Vec3 place = ray.at(ray.depth[main]);
      const double size = 0.2 * within_.box.size().maxCoeff();
      double crowded = 0.0;
      double same = 0.0;
      for (const auto& [there, along] : visited_) {
        crowded = std::max(crowded, std::exp(-(place - there).squaredNorm() / (size * size)));
        same = std::max(same, ray.along.dot(along));
      }
      worth *= (1.0 - 0.6 * crowded) * (1.0 - 0.3 * same);
      if (worth > most) {
        most = worth;
        best = {&ray, main};
      }
    }
    return best;
  }

  /// Approaches, presses, strokes, and withdraws; moves along with a volume that is slow enough.
  void visit(const Ray& ray, std::size_t mode, const std::vector<double>& top) {
    ride(mode);
    scout_.lift();
    if (ride_) scout_.touch(ray.from, time() - scout_.time());
    const Profile profile = profileOf(scout_, ray, top);
    const double clear = std::max(0.0, profile.contact - kClear);
    std::fill(felt_.begin(), felt_.end(), 0.0);
    travel(ray, clear);
    go(ray.at(std::max(clear, profile.contact - 1e-3)), kTravel);
    for (const Stop& stop : profile.stops) {
      go(ray.at(stop.stroke), kPressing);
      stroke();
      go(ray.at(stop.stroke), kPressing);
      go(ray.at(stop.press), kPressing);
      rest();
    }
    go(ray.at(clear), kTravel);
    for (std::size_t i = 0; i < credit_.size(); ++i) {
      if (top[i] > kTouch) credit_[i] += std::min(1.0, felt_[i] / top[i]);
    }
    constexpr std::size_t kRemembered = 6;
    visited_.emplace_back(ray.at(profile.stops.back().press), ray.along);
    if (visited_.size() > kRemembered) visited_.erase(visited_.begin());
    last_ = here(ray.from, time());
    at_ = here(at_, time());
    ride_ = nullptr;
  }

  /// Returns to the start of the path.
  void close() { travel(first_, first_clear_); }

 private:
  /// From now on, places are fixed to the volume that moves the mode, at its present pose.
  void ride(std::size_t mode) {
    constexpr double kRidden = 0.05;  // [m/s]: the hand follows no faster volume
    const Graph& graph = scene_.graph;
    const int motion = mode < graph.mode_motions.size() ? graph.mode_motions[mode] : -1;
    if (motion < 0) return;
    const MotionPtr& moves = graph.motions[static_cast<std::size_t>(motion)];
    if (moves->topSpeed(within_.box) > kRidden) return;
    ride_ = moves;
    from_ = moves->poseAbout(at_, time());
  }
  [[nodiscard]] Vec3 here(const Vec3& p, double time) const {
    if (!ride_) return p;
    const Vec3 rest = from_.toRest(p);
    const Vec3 moved = ride_->poseOf(rest, time)(rest);
    return moved * std::min(1.0, within_.radius / std::max(within_.radius, moved.norm()));
  }
  /// Returns the force on the probe, in the volume's frame at the start of the ride.
  [[nodiscard]] Vec3 force() const {
    if (!ride_) return finger_.force();
    return from_.linear * (ride_->poseOf(from_.toRest(at_), time()).back * finger_.force());
  }

  /// Moves the probe to `to` in the time dt. The hand's target is the place from which the force on
  /// the probe pulls it back there.
  void step(const Vec3& to, double dt) {
    const Vec3 place = here(to, time() + dt);
    finger_.touch(place, dt);
    at_ = to;
    for (std::size_t i = 0; i < felt_.size(); ++i) {
      felt_[i] = std::max(felt_[i], finger_.forces()[i].norm());
    }
    const double most = kHardest / std::max(kHardest, finger_.force().norm());
    const Vec3 target = place - most / GripParams{}.stiffness * finger_.force();
    // If a contact gives way at once, the hand slows down.
    const double longer = (target - path_.back().p).norm() / kTravel - dt;
    if (longer > 0.0) {
      finger_.touch(place, longer);
      dt += longer;
    }
    path_.push_back({time() + dt, target});
  }
  void go(const Vec3& to, double speed) {
    const Vec3 from = at_;
    const double way = (to - from).norm();
    const int steps = static_cast<int>(std::ceil(way / kFine));
    const double dt = steps > 0 ? way / speed / steps : 0.0;
    for (int k = 1; k <= steps; ++k) step(from + (to - from) * k / steps, dt);
  }
  void rest() {
    constexpr int kTimes = 15;
    for (int k = 0; k < kTimes; ++k) step(at_, kRest / kTimes);
  }

  /// Circles across the force and keeps the force constant: the probe goes deeper if the force
  /// falls. If the force is lost, the probe turns back, and gives up if the force does not return.
  void stroke() {
    const double newtons = finger_.force().norm();
    if (!(newtons > kTouch)) return;
    const Vec3 out = force() / newtons;
    const Vec3 u = out.unitOrthogonal();
    const Vec3 v = out.cross(u);
    const Vec3 centre = at_ - kCircle * u;
    double angle = 0.0;
    double sense = 1.0;
    double deep = 0.0;
    double kept = 0.0;
    constexpr double kLost = 0.4;  // [s]
    bool held = true;
    double since = time();
    const double end = time() + kStroke;
    while (time() < end) {
      angle += sense * kFine / kCircle;
      const Vec3 to = centre + kCircle * (std::cos(angle) * u + std::sin(angle) * v) - deep * out;
      step(to, std::max(kFine, (to - at_).norm()) / kStroking);
      const double now = finger_.force().norm();
      if (now < 0.3 * newtons) {
        if (held) {
          sense = -sense;
          deep = kept;
          since = time();
        }
        held = false;
        if (time() - since > kLost) break;
        continue;
      }
      held = true;
      kept = deep;
      const double lack = std::clamp(newtons - now, -1.0, 1.0);
      deep = std::clamp(deep + 0.3 * lack / finger_.stiffness(), -2.0 * kCircle, kCircle);
    }
  }

  /// Moves to a place before a ray's contact. Moves straight if contacts on the way are light, else
  /// back along the last ray, round the outside, and in along the next ray.
  void travel(const Ray& to, double clear) {
    const Vec3 place = to.at(clear);
    if (path_.empty()) {
      at_ = place;
      first_ = to;
      first_clear_ = clear;
      finger_.touch(at_, 0.0);
      path_.push_back({0.0, at_});
      return;
    }
    constexpr double kEasy = 1.0;  // [N]
    scout_.lift();
    const Vec3 from = at_;
    const int steps = static_cast<int>(std::ceil((place - from).norm() / kCoarse));
    bool easy = true;
    for (int k = 0; k <= steps && easy; ++k) {
      scout_.touch(from + (place - from) * k / std::max(1, steps), 0.0);
      easy = scout_.force().norm() <= kEasy;
    }
    if (!easy) {
      go(last_, kTravel);
      const Vec3 centre = within_.box.centre();
      const Vec3 a = (last_ - centre).normalized();
      const Vec3 b = (to.from - centre).normalized();
      const double angle = std::acos(std::clamp(a.dot(b), -1.0, 1.0));
      Vec3 across = b - a.dot(b) * a;
      across = across.norm() > 1e-6 ? across.normalized() : Vec3(a.unitOrthogonal());
      constexpr int kArc = 24;
      for (int k = 1; k < kArc; ++k) {
        const double turn = angle * k / kArc;
        const Vec3 out = std::cos(turn) * a + std::sin(turn) * across;
        go(centre + within_.part(centre, out).second * out, kTravel);
      }
      go(to.from, kTravel);
    }
    go(place, kTravel);
  }

  const Scene& scene_;
  Within within_;
  ProbeRay finger_;  ///< Goes along the path, and advances the scene's time.
  ProbeRay scout_;   ///< Looks ahead, while time stands still.
  std::vector<PathPoint> path_;
  Vec3 at_ = Vec3::Zero();
  MotionPtr ride_;            ///< Motion that the hand follows; null: the hand follows no motion.
  Pose from_;                 ///< Its pose at the start of the ride.
  Vec3 last_ = Vec3::Zero();  ///< Start of the last ray [m].
  Ray first_;
  double first_clear_ = 0.0;
  std::vector<double> credit_;  ///< Visits of each mode, weighted by force.
  std::vector<double> felt_;    ///< Largest force of each mode in this visit [N].
  std::vector<std::pair<Vec3, Vec3>> visited_;
};

Within withinOf(const Scene& scene, const Box& bounds, double radius) {
  Within within;
  within.radius = 0.98 * radius;
  within.box = bounds;
  for (const Box& box : boxesOf(scene, 0.0)) {
    within.box.extend(box.lower);
    within.box.extend(box.upper);
  }
  const Vec3 reach = Vec3::Constant(within.radius);
  const double about = std::clamp(0.1 * within.box.size().maxCoeff(), 2e-3, kClear);
  const Vec3 lower = (within.box.lower.array() - about).matrix().cwiseMax(-reach);
  const Vec3 upper = (within.box.upper.array() + about).matrix().cwiseMin(reach);
  within.box = {lower, upper};
  if (within.box.empty()) within.box = {-reach, reach};  // the scene is out of reach
  return within;
}

}  // namespace

HandTarget findingHand(const Scene& scene, const Box& bounds, double radius, double seconds,
                       Search* search) {
  const auto start = std::chrono::steady_clock::now();
  const Within within = withinOf(scene, bounds, radius);
  const bool moves = !scene.graph.motions.empty();
  constexpr double kShare = 0.125;  // of a search, for each visit in a moving scene
  Search did;
  Plan plan(scene, within);
  std::optional<Found> found;
  const double planned = std::min(seconds, kPlan);
  do {
    if (!found || moves) {
      found.emplace(scene, within, plan.time(), moves ? kShare : 1.0);
      did.rays += found->rays_cast;
      did.met += static_cast<int>(found->rays.size());
      did.reads += found->reads;
    }
    const auto [ray, mode] = plan.choose(*found);
    if (ray == nullptr) {
      // Pass through the middle and back.
      Ray through;
      const auto [from, to] = within.part(within.box.centre(), through.along);
      through.from = within.box.centre() + from * through.along;
      through.length = to - from;
      plan.visit(through, mode, found->top);
    } else {
      plan.visit(*ray, mode, found->top);
    }
    ++did.visits;
  } while (plan.time() < planned);
  if (seconds > kPlan) plan.close();
  did.reads += plan.reads();
  std::vector<PathPoint> path = plan.take();
  const double period = path.back().t;
  did.ms =
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  if (search != nullptr) *search = did;
  return {[path = std::move(path), period, hint = std::size_t{0}](double t) mutable {
            return positionAt(path, t <= period ? t : std::fmod(t, period), hint);
          },
          seconds};
}

}  // namespace palpate::cli
