#include "palpate/engine/tick/bodies.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace palpate {

namespace {

/// Largest accepted error of a predicted warp [voxels].
constexpr double kForeseenSure = 0.25;

/// Returns true if the path from `Body::from` to b, in the resting frame, comes near a field's
/// data.
bool meets(const Body& body, const Vec3& b, const FieldFrame& frame) noexcept {
  const Vec3 end = body.pose.toRest(b);
  return meets({body.from.cwiseMin(end), body.from.cwiseMax(end)}, frame);
}

}  // namespace

void Bodies::place(const Graph& graph, double time, const Vec3& proxy) noexcept {
  posed_at_ = time_ = now_ = time;
  count_ = graph.motions.size();
  for (Body& body : all()) body.sure = std::numeric_limits<double>::infinity();
  const auto look = [&](const std::vector<FieldFrame>& frames, const std::vector<int>& motions) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (motions[i] < 0) continue;
      double& sure = bodies_[static_cast<std::size_t>(motions[i])].sure;
      sure = std::min(sure, kForeseenSure * frames[i].voxel);
    }
  };
  look(graph.scalar_frames, graph.scalar_motions);
  look(graph.vector_frames, graph.vector_motions);
  for (std::size_t i = 0; i < count_; ++i) {
    const Motion& motion = *graph.motions[i];
    bodies_[i].about = motion.deformationAt(proxy, time);
    bodies_[i].pose = motion.poseAt(time, bodies_[i].about);
  }
}

int Bodies::foresee(const Motion& motion, double time, const Vec3& rest, double sure,
                    Deformation& about, Pose& pose) noexcept {
  pose = motion.poseAt(time, about);
  if (motion.warp() == nullptr) return 0;
  const Vec3 x = about.back * (rest - about.origin - (time - about.time) * about.rate);
  if (about.errorAt(x, time, motion.warp()->topAcceleration()) <= sure) return 0;
  about = motion.deformationAt(pose(rest), time);
  pose = motion.poseAt(time, about);
  return 1;
}

int Bodies::readAt(const Graph& graph, const Vec3& p) noexcept {
  int warps = 0;
  for (std::size_t i = 0; i < count_; ++i) {
    Body& body = bodies_[i];
    body.seen = body.pose.toRest(p);
    const Motion& motion = *graph.motions[i];
    if (motion.warp() == nullptr) continue;
    ++warps;
    const Vec3 ended = body.seen;
    body.about = motion.deformationAt(p, now_);
    body.pose = motion.poseAt(now_, body.about);
    body.seen = body.pose.toRest(p);
    body.swept = ended - body.seen;
    if (body.moved) body.carried = body.pose(body.from);
  }
  return warps;
}

int Bodies::plan(std::span<const Felt> felt, double time, const Vec3& proxy, const Vec3& probe,
                 int most, StepReport& report) noexcept {
  time_ = time;
  const Graph& graph = felt[0].graph();
  for (std::size_t i = 0; i < count_; ++i) {
    Body& body = bodies_[i];
    body.ahead = body.about;
    report.samples += foresee(*graph.motions[i], time, body.pose.toRest(proxy), body.sure,
                              body.ahead, body.target);
  }
  double parts = 1.0;
  eachField(felt, [&](const FieldFrame& frame, int motion) {
    if (motion < 0) return;
    const Body& body = bodies_[static_cast<std::size_t>(motion)];
    const Vec3 seen = body.pose.toRest(proxy);
    const double way = (body.target(seen) - proxy).norm();
    if (!(way > 0.5 * frame.voxel)) return;
    Box near;
    for (const Vec3& x : {proxy, probe}) {
      near.extend(body.pose.toRest(x));
      near.extend(body.target.toRest(x));
    }
    if (meets(near, frame)) parts = std::max(parts, std::ceil(way / (0.5 * frame.voxel)));
  });
  if (parts > most) worsen(report, StepStatus::kSubstepLimit);
  return static_cast<int>(std::min<double>(parts, most));
}

int Bodies::move(const Graph& graph, int part, int parts, const Vec3& proxy) noexcept {
  int warps = 0;
  const double share = static_cast<double>(part) / parts;
  now_ = part < parts ? posed_at_ + share * (time_ - posed_at_) : time_;
  for (std::size_t i = 0; i < count_; ++i) {
    Body& body = bodies_[i];
    const Pose last = body.pose;
    body.from = last.toRest(proxy);
    if (parts == 1) {
      body.pose = body.target;
      body.about = body.ahead;
    } else {
      warps += foresee(*graph.motions[i], now_, body.from, body.sure, body.about, body.pose);
    }
    body.moved = !(body.pose == last);
    body.carried = body.moved ? body.pose(body.from) : proxy;
    if (!body.moved) continue;
    body.carry.linear = body.pose.linear * last.back;
    body.carry.back = last.linear * body.pose.back;
    body.carry.translate = body.pose.translate - body.carry.linear * last.translate;
  }
  return warps;
}

double Bodies::reachFrom(std::span<const Felt> felt, const Vec3& a, const Vec3& b,
                         bool onward) const noexcept {
  const Box way{a.cwiseMin(b), a.cwiseMax(b)};
  double reach = std::numeric_limits<double>::infinity();
  eachField(felt, [&](const FieldFrame& frame, int motion) {
    const Body* body = of(motion);
    if (body == nullptr) {
      if (meets(way, frame)) reach = std::min(reach, frame.voxel);
      return;
    }
    const double carried = onward ? 0.0 : (body->carried - a).norm();
    const bool far = onward || (b - body->carried).norm() > frame.voxel;
    if (far && meets(*body, b, frame)) {
      reach = std::min(reach, std::max(frame.voxel - carried, 0.5 * frame.voxel));
    }
  });
  return reach;
}

bool Bodies::follow(std::span<const Felt> felt, const Vec3& proxy, const Vec3& b,
                    Vec3& end) const noexcept {
  const Body* holder = nullptr;
  double share = 1.0;
  eachField(felt, [&](const FieldFrame& frame, int motion) {
    const Body* body = of(motion);
    if (body == nullptr || !body->moved || !meets(*body, b, frame)) return;
    const double part = frame.voxel / (b - body->carried).norm();
    if (part >= share) return;
    share = part;
    holder = body;
  });
  if (holder == nullptr) return false;
  const Vec3 to = holder->carried + share * (b - holder->carried);
  bool trusted = true;
  eachField(felt, [&](const FieldFrame& frame, int motion) {
    const Body* body = of(motion);
    if (body == holder) return;
    const Vec3& from = body == nullptr ? proxy : body->carried;
    if ((to - from).norm() <= frame.voxel) return;
    const Box way{from.cwiseMin(to), from.cwiseMax(to)};
    trusted = trusted && !(body == nullptr ? meets(way, frame) : meets(*body, to, frame));
  });
  if (trusted) end = to;
  return trusted;
}

}  // namespace palpate
