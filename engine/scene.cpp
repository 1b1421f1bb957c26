#include "engine/scene.h"

#include <atomic>
#include <cmath>

#include "engine/error.h"

namespace palpate {

std::unique_ptr<const Scene> makeScene(const GraphSpec& spec,
                                       const std::map<std::string, FieldPtr>& fields,
                                       const CouplingParams& coupling, const StepParams& step) {
  static std::atomic<std::uint64_t> next_id{1};
  if (!std::isfinite(coupling.stiffness) || coupling.stiffness <= 0.0) {
    throw SceneError("/coupling/stiffness", "it must be a finite number > 0", "give N/m, as 500");
  }
  if (!std::isfinite(coupling.damping) || coupling.damping < 0.0) {
    throw SceneError("/coupling/damping", "it must be a finite number >= 0", "give N s/m, as 0.5");
  }
  if (step.max_substeps < 1 || step.max_substeps > 64) {
    throw SceneError("/accuracy/max_substeps", "it must be 1 to 64", "give 8");
  }
  auto scene = std::make_unique<Scene>();
  scene->graph = compileGraph(spec, fields);
  scene->coupling = coupling;
  scene->step = step;
  scene->id = next_id++;
  return scene;
}

void Reader::bind(const Scene& scene) noexcept {
  if (scene.id == scene_id_) return;
  scene_id_ = scene.id;
  std::size_t i = 0;
  for (const auto& field : scene.graph.scalar_fields) field->reset(caches_[i++]);
  for (const auto& field : scene.graph.vector_fields) field->reset(caches_[i++]);
}

int Reader::sample(const Scene& scene, const Vec3& p_W, Properties& out) noexcept {
  const Graph& graph = scene.graph;
  const auto scalar = [&](int index, double value, bool inside) {
    if (index >= 0) out.scalars[static_cast<std::size_t>(index)] = {value, inside};
  };
  const auto vector = [&](int index, const Vec3& value, bool inside) {
    if (index >= 0) out.vectors[static_cast<std::size_t>(index)] = {value, inside};
  };

  for (const ScalarRead& read : graph.scalar_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    const ScalarField& field = *graph.scalar_fields[i];
    const ScalarSample s = field.sample(p_W, caches_[i]);
    scalar(read.value, s.value, s.inside);
    vector(read.gradient, s.gradient, s.inside);
    if (read.cell_gradient >= 0) {
      vector(read.cell_gradient, field.cellGradient(p_W, caches_[i]), s.inside);
    }
  }
  for (const VectorRead& read : graph.vector_reads) {
    const auto i = static_cast<std::size_t>(read.field);
    const VectorSample s =
        graph.vector_fields[i]->sample(p_W, caches_[graph.scalar_fields.size() + i]);
    vector(read.value, s.value, s.inside);
    vector(read.curl, curl(s.jacobian), s.inside);
    scalar(read.divergence, divergence(s.jacobian), s.inside);
    if (read.q >= 0) scalar(read.q, qCriterion(s.jacobian), s.inside);
    if (read.lambda2 >= 0) scalar(read.lambda2, lambda2(s.jacobian), s.inside);
  }
  for (const UnitStep& step : graph.units) {
    const Properties::Vector& v = out.vectors[static_cast<std::size_t>(step.from)];
    vector(step.to, unit(v.value), v.inside);
  }
  for (const MagnitudeStep& magnitude : graph.magnitudes) {
    const Properties::Vector& v = out.vectors[static_cast<std::size_t>(magnitude.from)];
    scalar(magnitude.to, v.value.norm(), v.inside);
  }
  return static_cast<int>(graph.scalar_reads.size() + graph.vector_reads.size());
}

}  // namespace palpate
