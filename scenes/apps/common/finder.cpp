#include "palpate/scenes/apps/common/finder.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "palpate/scenes/apps/common/ray_search.h"

namespace palpate::cli {
namespace {

constexpr double kTravel = 0.1;     // [m/s]: speed between two contacts
constexpr double kPressing = 0.05;  // [m/s]: speed along a ray, into the scene
constexpr double kStroking = 0.04;  // [m/s]: speed across a surface
constexpr double kStroke = 1.4;     // [s]: duration of a stroke
constexpr double kRest = 0.15;      // [s]: rest at the deepest point
constexpr double kCircle = 4e-3;    // [m]: radius of a stroke
constexpr double kFine = 2.5e-4;    // [m]: step of the probe near contacts
constexpr double kCoarse = 2e-3;    // [m]: step of the probe between contacts
constexpr double kFelt = 0.3;       // [N]: modes with a smaller force count less
constexpr double kPlan = 60.0;      // [s]: planned length of a path; a longer path repeats
constexpr std::size_t kMostStops = 3;

/// Depths along a ray [m] for one mode.
struct Stop {
  double stroke = 0.0;  ///< First depth with 70 % of the mode's largest force on the ray.
  double press = 0.0;   ///< First depth with 95 % of the mode's largest force on the ray.
};

/// Depth of the first contact on a ray [m], and the stops for the modes behind this contact.
struct Profile {
  double contact = 0.0;
  std::vector<Stop> stops;
};

Profile profileOf(SearchProbe& probe, const ProbeRay& ray, const std::vector<double>& top) {
  const int steps = std::max(1, static_cast<int>(std::ceil(ray.length / kFine)));
  std::vector<std::vector<float>> held;  // force of each mode at each step [N]
  held.resize(top.size());
  Profile profile;
  profile.contact = ray.length;
  probe.lift();
  const auto depth_at = [&](int k) { return ray.length * k / steps; };
  for (int k = 0; k <= steps; ++k) {
    probe.touch(ray.at(depth_at(k)), 0.0);
    if (-probe.force().dot(ray.along) > kHardestPress) break;
    if (probe.force().norm() > kLeastContact)
      profile.contact = std::min(profile.contact, depth_at(k));
    for (std::size_t i = 0; i < top.size(); ++i) {
      held[i].push_back(static_cast<float>(-probe.forces()[i].dot(ray.along)));
    }
  }
  std::vector<std::pair<double, Stop>> stops;  // each with the force of its mode [N]
  for (std::size_t i = 0; i < top.size(); ++i) {
    if (held[i].empty()) continue;
    const float most = *std::max_element(held[i].begin(), held[i].end());
    if (!(most > kLeastContact) || most < 0.5 * top[i]) continue;
    const auto reach = [&](double share) {
      const auto at =
          std::find_if(held[i].begin(), held[i].end(), [&](float h) { return h >= share * most; });
      return depth_at(static_cast<int>(at - held[i].begin()));
    };
    stops.push_back({most, {reach(0.7), reach(0.95)}});
  }
  // Keeps the stops with the largest forces, sorted by depth. Keeps only one of several stops
  // within 2 mm.
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

/// Plans the hand's path, along which a probe senses the forces.
class Plan {
 public:
  Plan(const Scene& scene, const HandRange& within)
      : scene_(scene), within_(within), probe_(scene), scout_(scene) {
    credit_.resize(probe_.forces().size());
    felt_.resize(credit_.size());
  }

  [[nodiscard]] double time() const { return path_.empty() ? 0.0 : path_.back().t; }
  [[nodiscard]] std::vector<PathPoint> take() { return std::move(path_); }
  [[nodiscard]] long reads() const { return probe_.reads() + scout_.reads(); }

  /// Returns the ray with the highest value, or null, and the mode that contributes most to it.
  [[nodiscard]] std::pair<const ProbeRay*, std::size_t> choose(const RaySearch& found) const {
    std::pair<const ProbeRay*, std::size_t> best{nullptr, 0};
    double most = 0.0;
    for (const ProbeRay& ray : found.rays) {
      double worth = 0.0;
      std::size_t main = 0;
      double mains = -1.0;
      for (std::size_t i = 0; i < credit_.size(); ++i) {
        if (!(found.top[i] > kLeastContact)) continue;
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

  /// Adds a visit: approaches, then strokes, presses and rests at each stop, then withdraws. If the
  /// volume of `mode` moves slowly, the path moves with the volume.
  void visit(const ProbeRay& ray, std::size_t mode, const std::vector<double>& top) {
    ride(mode);
    scout_.lift();
    if (ride_) scout_.touch(ray.from, time() - scout_.time());
    const Profile profile = profileOf(scout_, ray, top);
    const double clear = std::max(0.0, profile.contact - kClearance);
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
      if (top[i] > kLeastContact) credit_[i] += std::min(1.0, felt_[i] / top[i]);
    }
    constexpr std::size_t kRemembered = 6;
    visited_.emplace_back(ray.at(profile.stops.back().press), ray.along);
    if (visited_.size() > kRemembered) visited_.erase(visited_.begin());
    last_ = here(ray.from, time());
    at_ = here(at_, time());
    ride_ = nullptr;
  }

  void close() { travel(first_, first_clear_); }

 private:
  void ride(std::size_t mode) {
    constexpr double kRidden = 0.05;  // [m/s]: the path does not follow a faster volume
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
  /// Returns the force on the probe, rotated to the volume's pose at the start of the visit.
  [[nodiscard]] Vec3 force() const {
    if (!ride_) return probe_.force();
    return from_.linear * (ride_->poseOf(from_.toRest(at_), time()).back * probe_.force());
  }

  /// Moves the probe to `to` within dt [s]. Offsets the hand's target from `to`, so that the spring
  /// of the grip and the force on the probe cancel at `to`.
  void step(const Vec3& to, double dt) {
    const Vec3 place = here(to, time() + dt);
    probe_.touch(place, dt);
    at_ = to;
    for (std::size_t i = 0; i < felt_.size(); ++i) {
      felt_[i] = std::max(felt_[i], probe_.forces()[i].norm());
    }
    const double most = kHardestPress / std::max(kHardestPress, probe_.force().norm());
    const Vec3 target = place - most / GripParams{}.stiffness * probe_.force();
    // If a contact yields, the target jumps: a longer step keeps the hand's speed limit.
    const double longer = (target - path_.back().p).norm() / kTravel - dt;
    if (longer > 0.0) {
      probe_.touch(place, longer);
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

  /// Moves the probe in circles perpendicular to the force, and adapts the depth to keep the force
  /// constant. Reverses if the contact is lost, and ends after 0.4 s without contact.
  void stroke() {
    const double newtons = probe_.force().norm();
    if (!(newtons > kLeastContact)) return;
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
      const double now = probe_.force().norm();
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
      deep = std::clamp(deep + 0.3 * lack / probe_.stiffness(), -2.0 * kCircle, kCircle);
    }
  }

  /// Moves to a point before the contact of a ray: straight if all contacts on the way are light.
  /// Otherwise moves out along the last ray, around the scene, and in along the new ray.
  void travel(const ProbeRay& to, double clear) {
    const Vec3 place = to.at(clear);
    if (path_.empty()) {
      at_ = place;
      first_ = to;
      first_clear_ = clear;
      probe_.touch(at_, 0.0);
      path_.push_back({0.0, at_});
      return;
    }
    constexpr double kEasy = 1.0;  // [N]: largest force of a light contact
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
  HandRange within_;
  SearchProbe probe_;  ///< Follows the path; its ticks advance the scene's time.
  SearchProbe scout_;  ///< Probes rays and straight ways, during which its time stands still.
  std::vector<PathPoint> path_;
  Vec3 at_ = Vec3::Zero();
  MotionPtr ride_;            ///< Motion that the path follows, or null.
  Pose from_;                 ///< Pose of the motion `ride_` at the start of the visit.
  Vec3 last_ = Vec3::Zero();  ///< Start of the last ray [m].
  ProbeRay first_;
  double first_clear_ = 0.0;
  /// For each mode, the sum over all visits of the force divided by the mode's largest force.
  std::vector<double> credit_;
  std::vector<double> felt_;  ///< Largest force of each mode in the present visit [N].
  std::vector<std::pair<Vec3, Vec3>> visited_;
};

}  // namespace

HandTarget findingHand(const Scene& scene, const Box& bounds, double radius, double seconds,
                       Search* search) {
  const auto start = std::chrono::steady_clock::now();
  const HandRange within = handRangeOf(scene, bounds, radius);
  const bool moves = !scene.graph.motions.empty();
  constexpr double kShare = 0.125;  // share of the limits per visit in a moving scene
  Search did;
  Plan plan(scene, within);
  std::optional<RaySearch> found;
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
      // If no ray has a contact, the path leads through the middle of the range.
      ProbeRay through;
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
