#include "palpate/engine/scene/scene.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>
#include <variant>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

const Body* bodyOf(int motion, std::span<const Body> bodies) noexcept {
  return motion < 0 || bodies.empty() ? nullptr : &bodies[static_cast<std::size_t>(motion)];
}

/// Continues the hash `shape` (FNV-1a) over a graph's fields, modes and motions, and returns it.
std::uint64_t shapeOf(const Graph& graph, std::uint64_t shape) {
  const auto add = [&](std::uint64_t x) { shape = (shape ^ x) * 1099511628211ULL; };
  for (const auto& field : graph.scalar_fields) add(field->id());
  for (const auto& field : graph.vector_fields) add(field->id());
  for (const Mode& mode : graph.modes) add(mode.index());
  for (const MotionPtr& motion : graph.motions) add(motion->id());
  return shape;
}

/// Returns Scene::still.
bool isStill(const Scene& scene) noexcept {
  const auto acts_anywhere = [](const Mode& mode) {
    return std::holds_alternative<GuideMode>(mode) || std::holds_alternative<UserMode>(mode);
  };
  return scene.parts.empty() && scene.graph.motions.empty() &&
         std::none_of(scene.graph.modes.begin(), scene.graph.modes.end(), acts_anywhere);
}

}  // namespace

std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                       const std::map<std::string, FieldPtr>& fields,
                                       const CouplingParams& coupling, const StepParams& step,
                                       std::vector<Part> parts) {
  static std::atomic<std::uint64_t> next_id{1};
  if (!std::isfinite(coupling.stiffness) || coupling.stiffness <= 0.0) {
    throw SceneError("/coupling/stiffness", "the stiffness must be a finite number > 0",
                     "give N/m, such as 500");
  }
  if (!std::isfinite(coupling.damping) || coupling.damping < 0.0) {
    throw SceneError("/coupling/damping", "the damping must be a finite number >= 0",
                     "give N s/m, such as 0.5");
  }
  if (!(step.tolerance_voxels > 0.0) || !(step.tolerance_voxels <= kMostTolerance)) {
    throw SceneError("/accuracy/tolerance_voxels", "the tolerance must be > 0 and at most 1",
                     "give a fraction of a voxel, such as 0.01");
  }
  if (step.max_substeps < 1 || step.max_substeps > 64) {
    throw SceneError("/accuracy/max_substeps", "the limit must be 1 to 64",
                     "give a whole number, such as 16");
  }
  if (step.max_iterations < 1) {
    throw SceneError("/accuracy/max_iterations", "the limit must be at least 1",
                     "give a whole number, such as 130");
  }
  auto scene = std::make_unique<Scene>();
  if (parts.empty() || !spec.modes.empty()) scene->graph = compileGraph(spec, fields);
  scene->coupling = coupling;
  if (!scene->graph.stiffness.factors.empty()) {
    scene->coupling.stiffness = spec.stiffness->lowest();
  } else if (spec.stiffness) {
    scene->coupling.stiffness = spec.stiffness->highest();
  }
  scene->step = step;
  scene->id = next_id++;
  scene->shape = shapeOf(scene->graph, 14695981039346656037ULL);
  std::vector<Box> boxes;
  boxes.reserve(parts.size());
  for (const Part& part : parts) {
    boxes.push_back(part.bounds);
    scene->strongest_part = std::max(scene->strongest_part, part.most);
    scene->shape = shapeOf(part.graph, scene->shape);
  }
  scene->bounds = BroadPhase(boxes);
  scene->parts = std::move(parts);
  scene->still = isStill(*scene);
  return scene;
}

Part makePart(const GraphSpec& spec, const std::map<std::string, FieldPtr>& fields) {
  if (!spec.motions.empty()) {
    throw SceneError("/volumes", "a part has a volume that moves",
                     "put this volume into the scene itself");
  }
  if (spec.stiffness) {
    throw SceneError("/coupling", "the stiffness varies within a part",
                     "vary the stiffness in the scene itself");
  }
  const auto which = [&]() -> std::string {
    if (fields.empty()) return "volumes that share modes";
    return "\"" + fields.begin()->first + "\" and the volumes that share its modes";
  };
  if (spec.modes.size() > kMaxPartModes) {
    throw SceneError(
        "/modes",
        which() + " (a part of the scene) have " + std::to_string(spec.modes.size()) + " modes",
        "use at most " + std::to_string(kMaxPartModes));
  }
  Part part;
  part.graph = compileGraph(spec, fields);
  const Graph& graph = part.graph;
  if (graph.scalar_fields.size() + graph.vector_fields.size() > kMaxPartFields) {
    throw SceneError("/volumes",
                     "the modes of " + which() + " (a part of the scene) read more than " +
                         std::to_string(kMaxPartFields) + " volumes",
                     "use fewer volumes, or put them outside parts (without \"instances\")");
  }
  for (const auto* frames : {&graph.scalar_frames, &graph.vector_frames}) {
    for (const FieldFrame& frame : *frames) {
      const Vec3 margin = Vec3::Constant(kFrameMargin * frame.voxel);
      part.bounds.extend(frame.bounds.lower - margin);
      part.bounds.extend(frame.bounds.upper + margin);
    }
  }
  for (std::size_t i = 0; i < spec.modes.size(); ++i) {
    const ModeSpec& mode = spec.modes[i];
    if (mode.kind == ModeKind::kUser || mode.kind == ModeKind::kGuide) {
      const std::size_t number = spec.mode_numbers.empty() ? i : spec.mode_numbers.at(i);
      throw SceneError("/modes/" + std::to_string(number),
                       "a part has a guide or a user-defined mode",
                       "move this mode to the scene itself");
    }
    double friction = mode.friction.highest();
    const auto field = fields.find(mode.of);
    const bool grooves =
        mode.kind == ModeKind::kIsosurface && field != fields.end() &&
        std::visit([](const auto& of) { return of->frame().distance; }, field->second);
    if (grooves) friction = std::min(kMostWalls * friction, kMostFriction);
    part.most += mode.strength.highest() * (1.0 + friction) + mode.viscosity.highest();
  }
  return part;
}

BoundGraph Reader::bind(const Scene& scene) noexcept {
  const Graph& graph = scene.graph;
  if (scene.id != scene_id_) {
    scene_id_ = scene.id;
    std::fill(parts_.begin(), parts_.end(), kNone);
    ready(graph, 0, kMaxFields);
  }
  return {&graph, {caches_.data(), kMaxFields}};
}

BoundGraph Reader::bind(const Scene& scene, std::size_t part, std::size_t slot) noexcept {
  const Graph& graph = scene.parts[part].graph;
  const std::size_t first = kMaxFields + slot * kMaxPartFields;
  if (parts_[slot] != part) {
    parts_[slot] = part;
    ready(graph, first, kMaxPartFields);
  }
  return {&graph, {&caches_[first], kMaxPartFields}};
}

void Reader::ready(const Graph& graph, std::size_t first, std::size_t count) noexcept {
  const std::size_t end = first + count;
  const auto one = [&](const AnyField& field) {
    if (std::exchange(fields_[first], field.id()) != field.id()) field.reset(caches_[first]);
    ++first;
  };
  for (const auto& field : graph.scalar_fields) one(*field);
  for (const auto& field : graph.vector_fields) one(*field);
  // If a field is removed from the scene and returns later, its cache is reset.
  while (first < end) fields_[first++] = 0;
}

int BoundGraph::sample(const Vec3& p_W, Properties& out,
                       std::span<const Body> bodies) const noexcept {
  const auto scalar = [&](int index, double value, bool inside, const Vec3& slope) {
    if (index >= 0) out.scalars[static_cast<std::size_t>(index)] = {value, inside, slope};
  };
  const auto vector = [&](int index, const Vec3& value, bool inside, const Mat3& jacobian) {
    if (index >= 0) out.vectors[static_cast<std::size_t>(index)] = {value, inside, jacobian};
  };
  const Vec3 level = Vec3::Zero();     // for a slope that is unknown or not needed
  const Mat3 straight = Mat3::Zero();  // for a Jacobian that is unknown or not needed

  const FieldSet wanted = fieldsAt(*graph, p_W, bodies);
  int count = 0;
  out.coarse = false;
  for (const ScalarRead& read : graph->scalar_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    if ((wanted.scalars >> i & 1U) == 0) {
      scalar(read.value, graph->scalar_frames[i].background, false, level);
      vector(read.gradient, Vec3::Zero(), false, straight);
      vector(read.cell_gradient, Vec3::Zero(), false, straight);
      continue;
    }
    ++count;
    const ScalarField& field = *graph->scalar_fields[i];
    const Body* body = bodyOf(graph->scalar_motions[i], bodies);
    const Vec3& p = body == nullptr ? p_W : body->seen;
    const ScalarSample s = field.sample(p, caches[i]);
    out.coarse = out.coarse || s.coarse;
    const auto turned = [body](const Vec3& g) {
      return body == nullptr ? g : body->pose.gradient(g);
    };
    const bool own = read.cell_gradient >= 0 || read.slope;
    const Vec3 cell_gradient = own ? turned(field.cellGradient(p, caches[i])) : level;
    const double metres = graph->scalar_frames[i].metres_per_unit;
    scalar(read.value, s.value, s.inside, read.slope ? Vec3(cell_gradient / metres) : level);
    vector(read.gradient, turned(s.gradient), s.inside,
           read.turn ? gradientJacobian(i, p_W, bodies) : straight);
    vector(read.cell_gradient, cell_gradient, s.inside, straight);
  }
  for (const VectorRead& read : graph->vector_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    if ((wanted.vectors >> i & 1U) == 0) {
      vector(read.value, Vec3::Zero(), false, straight);
      vector(read.curl, Vec3::Zero(), false, straight);
      for (const int derived : {read.divergence, read.q, read.lambda2}) {
        scalar(derived, 0.0, false, level);
      }
      continue;
    }
    ++count;
    const Body* body = bodyOf(graph->vector_motions[i], bodies);
    const Vec3& p = body == nullptr ? p_W : body->seen;
    VectorSample s = graph->vector_fields[i]->sample(p, caches[graph->scalar_fields.size() + i]);
    out.coarse = out.coarse || s.coarse;
    if (body != nullptr) {
      const Motion& motion = *graph->motions[static_cast<std::size_t>(graph->vector_motions[i])];
      const Vec3 w = body->about.back * s.value;
      s.value = body->pose.vector(s.value);
      s.jacobian = body->pose.vectorJacobian(s.jacobian);
      if (motion.warp() != nullptr) {
        // d (F^-1 v) / dx = F^-1 (dv/dX) F - F^-1 (dF/dx) F^-1 v, then rotated by the rigid part.
        const Mat3 rotation = body->pose.linear * body->about.slope;
        s.jacobian -= body->pose.linear * body->about.bendAlong(w) * rotation.transpose() *
                      graph->vector_frames[i].metres_per_unit;
      }
    }
    vector(read.value, s.value, s.inside, s.jacobian / graph->vector_frames[i].metres_per_unit);
    vector(read.curl, curl(s.jacobian), s.inside, straight);
    scalar(read.divergence, divergence(s.jacobian), s.inside, level);
    if (read.q >= 0) scalar(read.q, qCriterion(s.jacobian), s.inside, level);
    if (read.lambda2 >= 0) scalar(read.lambda2, lambda2(s.jacobian), s.inside, level);
  }
  makeSteps(out);
  return count;
}

namespace {

/// Returns field n of a graph, in the order of the caches: scalars, then vectors.
const AnyField& fieldOf(const Graph& graph, std::size_t n) noexcept {
  const std::size_t scalars = graph.scalar_fields.size();
  if (n < scalars) return *graph.scalar_fields[n];
  return *graph.vector_fields[n - scalars];
}

}  // namespace

bool dataLost(const Graph& graph) noexcept {
  return std::any_of(graph.attentive.begin(), graph.attentive.end(),
                     [&](std::size_t n) { return fieldOf(graph, n).lost(); });
}

bool BoundGraph::attend(const Attention& at, std::span<const Body> bodies) const noexcept {
  bool changed = false;
  const std::size_t scalars = graph->scalar_fields.size();
  for (const std::size_t n : graph->attentive) {
    const bool scalar = n < scalars;
    const int motion = scalar ? graph->scalar_motions[n] : graph->vector_motions[n - scalars];
    const Body* body = bodyOf(motion, bodies);
    Attention rest = at;
    if (body != nullptr) {
      rest.proxy = body->pose.toRest(at.proxy);
      rest.probe = body->pose.toRest(at.probe);
    }
    changed = fieldOf(*graph, n).attend(rest, caches[n]) || changed;
  }
  return changed;
}

void BoundGraph::leave() const noexcept {
  for (const std::size_t n : graph->attentive) fieldOf(*graph, n).leave(caches[n]);
}

void BoundGraph::makeSteps(Properties& of) const noexcept {
  for (const UnitStep& step : graph->units) {
    const Properties::Vector& v = of.vectors[static_cast<std::size_t>(step.from)];
    of.vectors[static_cast<std::size_t>(step.to)] = {unit(v.value), v.inside,
                                                     turnOf(v.value, v.jacobian)};
  }
  for (const MagnitudeStep& step : graph->magnitudes) {
    const Properties::Vector& v = of.vectors[static_cast<std::size_t>(step.from)];
    of.scalars[static_cast<std::size_t>(step.to)] = {v.value.norm(), v.inside,
                                                     v.jacobian.transpose() * unit(v.value)};
  }
}

double BoundGraph::heightAt(const SurfaceSource& skin, double level, const Vec3& p) const noexcept {
  const auto i = static_cast<std::size_t>(skin.field);
  const ScalarField& field = *graph->scalar_fields[i];
  const double above = skin.sign * (field.value(p, caches[i]) - level);
  const double slope = field.cellGradient(p, caches[i]).norm();
  return above / slope * skin.metres_per_unit / skin.voxel;
}

Mat3 BoundGraph::gradientJacobian(std::size_t i, const Vec3& p_W,
                                  std::span<const Body> bodies) const noexcept {
  const Body* body = bodyOf(graph->scalar_motions[i], bodies);
  const Vec3& p = body == nullptr ? p_W : body->seen;
  Mat3 by = graph->scalar_fields[i]->gradientJacobian(p, caches[i]);
  if (body == nullptr) return by;
  by = body->pose.gradientJacobian(by);
  if (graph->motions[static_cast<std::size_t>(graph->scalar_motions[i])]->warp() != nullptr) {
    // d (F^T g) / dx = F^T (dg/dX) F + sum g_i d^2 u_i, then rotated by the rigid part.
    const Mat3 rotation = body->pose.linear * body->about.slope;
    const Vec3 g = graph->scalar_fields[i]->sample(p, caches[i]).gradient;
    by += rotation * body->about.bendOf(g) * rotation.transpose();
  }
  return by;
}

void BoundGraph::turn(Properties& read, std::span<const Body> bodies) const noexcept {
  const auto turned = [&](int motion, int index, bool gradient) {
    const Body* body = bodyOf(motion, bodies);
    if (body == nullptr || !body->moved || index < 0) return;
    const Pose& by = body->carry;
    Properties::Vector& v = read.vectors[static_cast<std::size_t>(index)];
    v.value = gradient ? by.gradient(v.value) : by.vector(v.value);
    v.jacobian = gradient ? by.gradientJacobian(v.jacobian) : by.vectorJacobian(v.jacobian);
  };
  for (const ScalarRead& r : graph->scalar_reads) {
    const int motion = graph->scalar_motions[static_cast<std::size_t>(r.field)];
    if (const Body* body = bodyOf(motion, bodies); body != nullptr && body->moved && r.slope) {
      Vec3& slope = read.scalars[static_cast<std::size_t>(r.value)].slope;
      slope = body->carry.gradient(slope);
    }
    turned(motion, r.gradient, true);
    turned(motion, r.cell_gradient, true);
  }
  for (const VectorRead& r : graph->vector_reads) {
    const int motion = graph->vector_motions[static_cast<std::size_t>(r.field)];
    turned(motion, r.value, false);
    turned(motion, r.curl, false);
  }
  makeSteps(read);
}

FieldSet fieldsAt(const Graph& graph, const Vec3& p_W, std::span<const Body> bodies) noexcept {
  const auto holding = [&](const std::vector<FieldFrame>& frames, const std::vector<int>& motions) {
    std::uint64_t bits = 0;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const Box& box = frames[i].bounds;
      const Body* body = bodyOf(motions[i], bodies);
      const Vec3& p = body == nullptr ? p_W : body->seen;
      const bool in = p.x() >= box.lower.x() && p.x() <= box.upper.x() && p.y() >= box.lower.y() &&
                      p.y() <= box.upper.y() && p.z() >= box.lower.z() && p.z() <= box.upper.z();
      bits |= static_cast<std::uint64_t>(in) << i;
    }
    return bits;
  };
  const FieldSet here{holding(graph.scalar_frames, graph.scalar_motions),
                      holding(graph.vector_frames, graph.vector_motions)};
  FieldSet wanted;
  for (const ModeFields& mode : graph.mode_fields) {
    if (here.holds(mode.support)) wanted |= mode.reads & here;
  }
  wanted |= graph.stiffness_reads & here;
  return wanted;
}

}  // namespace palpate
