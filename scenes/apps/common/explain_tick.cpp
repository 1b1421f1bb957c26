#include "palpate/scenes/apps/common/explain_tick.h"

#include <string>
#include <utility>

#include <fmt/format.h>

#include "palpate/scenes/apps/common/explain_parts.h"

namespace palpate::cli {
namespace {

OrderedJson balanceReport(const ExplainedTick& tick) {
  const StepReport& r = tick.report;
  const Vec3 spring = r.stiffness * (r.proxy - tick.hand);
  Vec3 sum = Vec3::Zero();
  for (std::size_t i = 0; i < tick.modes(); ++i) {
    sum += totalOf(loadsOf(tick.state, r, i));
  }
  OrderedJson json;
  json["status"] = wordFor(r.status);
  json["solver"] = wordFor(r.solver);
  json["iterations"] = r.iterations;
  json["substeps"] = r.substeps;
  json["error_bound"] = r.error_bound;
  json["stiffness"] = r.stiffness;
  if (!tick.graph().stiffness.factors.empty()) {
    json["stiffness_by"] = transferReport(tick, tick.graph().stiffness, 0.0);
    json["stiffness_by"]["value"] = tick.graph().stiffness.anywhere(tick.properties());
  }
  json["proxy"] = toJson(r.proxy);
  json["spring"] = toJson(spring);
  json["loads"] = toJson(sum);
  const Vec3 waiting = r.stiffness * r.waiting;
  json["waiting"] = toJson(waiting);
  json["left_over"] = (sum + waiting - spring).norm();
  json["injected_energy"] = r.injected;
  return json;
}

/// Reports how the force that is sent follows from the spring's force, step by step.
OrderedJson forceReport(const ExplainedTick& tick) {
  const StepReport& r = tick.report;
  const Vec3 spring = r.stiffness * (r.proxy - tick.hand);
  OrderedJson json;
  json["spring"] = toJson(spring);
  json["damper"] =
      toJson(tick.scene.coupling.damping > 0.0 ? Vec3(r.wanted - spring) : Vec3(Vec3::Zero()));
  json["wanted"] = toJson(r.wanted);
  json["limiter"] = {{"acted", r.limited},
                     {"peaked", tick.limited.peaked},
                     {"heated", tick.limited.heated},
                     {"ramped", tick.limited.ramped},
                     {"slewed", tick.limited.slewed},
                     {"drained", tick.limited.drained},
                     {"peak", tick.limits.peak},
                     {"growth", tick.limits.slew * tick.dt}};
  json["sent"] = toJson(r.force);
  json["size"] = r.force.norm();
  return json;
}

/// Describes what the limiter changed. Returns an empty text if the limiter changed nothing.
std::string limiterWords(const ExplainedTick& tick) {
  if (tick.limited.slewed) {
    return fmt::format("the limiter lets the force grow by {} N per tick",
                       shown(tick.limits.slew * tick.dt));
  }
  if (tick.limited.peaked)
    return fmt::format("the limiter's peak is {} N", shown(tick.limits.peak));
  if (tick.limited.heated) return "the heat of the motors limits the force";
  if (tick.limited.ramped) return "an engagement reduces the force";
  if (tick.limited.drained) return "the energy tank reduces the force";
  return "";
}

std::string loadsSentence(const ExplainedTick& tick) {
  std::string text;
  for (std::size_t i = 0; i < tick.modes(); ++i) {
    const std::string carries = loadsInWords(tick.graph().mode_names[i], tick.graph().modes[i],
                                             loadsOf(tick.state, tick.report, i));
    if (!carries.empty()) text += (text.empty() ? "" : "; ") + carries;
  }
  return text.empty() ? "No primitive holds the proxy." : text + ".";
}

std::string forceSentence(const ExplainedTick& tick) {
  const StepReport& r = tick.report;
  const double length = (r.proxy - tick.hand).norm();
  const double spring = r.stiffness * length;
  constexpr double kNothing = 1e-9;  // [N]: a smaller force counts as zero
  if (spring < kNothing) return "The proxy is at the hand, so the spring's force is zero.";
  std::string text =
      fmt::format("The proxy is {} m from the hand, and the spring of {} N/m pulls with {} N",
                  shown(length), shown(r.stiffness), shown(spring));
  if (tick.scene.coupling.damping > 0.0) {
    const double damper = r.wanted.norm() - spring;
    text += fmt::format(", the damper with {} N", shown(damper));
    if (!tick.time && damper > 0.999 * spring)
      text += " (its maximum, because the whole push happens in one tick)";
  }
  const std::string limiter = limiterWords(tick);
  if (!limiter.empty())
    text += fmt::format("; {}: the device gets {} N", limiter, shown(r.force.norm()));
  return text + ".";
}

OrderedJson because(const ExplainedTick& tick) {
  const StepStatus status = tick.report.status;
  OrderedJson json = OrderedJson::array();
  if (status == StepStatus::kFault) {
    const Fault fault = tick.state.fault();
    json.push_back(fault == Fault::kNone || fault == Fault::kNotFinite
                       ? "A sample or a force was not finite, so the force is cut."
                       : fmt::format("The force is cut: {}.", wordsFor(fault)));
    return json;
  }
  json.push_back(loadsSentence(tick));
  json.push_back(forceSentence(tick));
  if (status == StepStatus::kSubstepLimit) {
    const bool waits = !(tick.report.proxy - tick.hand).isZero(0.0);
    json.push_back(
        waits ? "The proxy has not arrived within the sub-steps and iterations that one tick "
                "allows: the rest of the path waits for the next tick."
              : "The tick has reached its limit of sub-steps or iterations: the proxy is at the "
                "hand, and may have passed a surface without contact.");
  } else if (status == StepStatus::kHairpin) {
    json.push_back("A streamline bends so tightly that the proxy may jump along it.");
  } else if (status == StepStatus::kDropped) {
    json.push_back("The modes placed more primitives than a tick can hold, so some were skipped.");
  }
  return json;
}

/// Reports a sub-step. The key `went` is the place to which the proxy moved or, if the sub-step is
/// foreseen, the place of the next reading.
OrderedJson stepReport(const ExplainedTick& tick, const StepTrace::Step& step) {
  OrderedJson json;
  json["foreseen"] = step.foreseen;
  json["at"] = toJson(step.at);
  json["proxy"] = toJson(step.proxy);
  json["balance"] = toJson(step.balance);
  json["newton"] = toJson(step.newton);
  json["end"] = wordFor(step.end);
  json["went"] = toJson(step.went);
  json["yields"] = OrderedJson::array();
  for (std::size_t i = 0; i < tick.modes(); ++i) {
    if (step.yields.test(i)) json["yields"].push_back(tick.graph().mode_names[i]);
  }
  return json;
}

OrderedJson tickReport(const ExplainedTick& tick) {
  OrderedJson json;
  json["scene"] = tick.opened.spec.source;
  json["at"] = toJson(tick.at);
  json["hand"] = toJson(tick.hand);
  json["rate"] = 1.0 / tick.dt;
  json["time"] = tick.time ? OrderedJson(*tick.time) : OrderedJson();
  json["rest"] = {{"proxy", toJson(tick.rest.report.proxy)},
                  {"moved", (tick.rest.report.proxy - tick.at).norm()},
                  {"force", toJson(tick.rest.report.force)},
                  {"ticks", tick.rest.ticks}};
  json["read_at"] = OrderedJson::array();
  for (const StepTrace::Step& step : tick.trace.steps()) {
    if (!step.foreseen) json["read_at"].push_back(toJson(step.at));
  }
  json["steps"] = OrderedJson::array();
  for (const StepTrace::Step& step : tick.trace.steps())
    json["steps"].push_back(stepReport(tick, step));
  json["fields"] = fieldsReport(tick);
  json["left_out"] = tick.graph().unused;
  json["properties"] = propertiesReport(tick);
  json["modes"] = OrderedJson::array();
  for (std::size_t i = 0; i < tick.modes(); ++i) json["modes"].push_back(modeReport(tick, i));
  json["silent"] = tick.graph().silent;
  json["balance"] = balanceReport(tick);
  json["force"] = forceReport(tick);
  json["because"] = because(tick);
  return json;
}

}  // namespace

Explained explainTick(SceneSpec spec, const Vec3& at, const Vec3& push, double rate,
                      const Progress& progress, const Say& say) {
  checkRate("rate", rate);
  checkReach("at", at);
  const Vec3 hand = at + push;
  checkReach("push", hand);
  const double dt = 1.0 / rate;
  const ForceLimits limits = pathLimits();
  const auto trial = [&](const BuiltScene& built) {
    Near near;
    Reader reader;
    ProxyState state(limits);
    near.add(state, restAt(*built.scene, reader, state, at, dt).report);
    near.add(state, hapticStep(*built.scene, reader, {hand}, state, dt));
    return near;
  };
  const Opened opened = openFor(std::move(spec), trial, progress, say);
  if (!opened.built.sequences.empty()) {
    say("explain: the first frame of each sequence acts; for another time, explain a run "
        "(--until)");
  }
  const Scene& scene = *opened.built.scene;

  Reader reader;
  ProxyState state(limits);
  const Rest rest = restAt(scene, reader, state, at, dt);
  StepTrace trace;
  const StepReport report = hapticStep(scene, reader, {hand}, state, dt, &trace);
  LimiterState limiter;
  limiter.sent = rest.report.force;
  const LimitedForce limited = limitForce(report.wanted, hand, dt, limits, limiter);
  const ExplainedTick tick{opened,  scene,  at, hand, rest,  report,
                           limited, limits, dt, {},   trace, state};
  return {tickReport(tick), report.status == StepStatus::kFault};
}

Explained explainRun(const Opened& opened, std::span<const RunTick> ticks,
                     const ForceLimits& limits, double time) {
  const Scene& scene = *opened.built.scene;
  HandTick hand(limits);
  const auto run = [&](const RunTick& one, StepTrace* trace) {
    StepReport report = hand.step(one.scene ? &scene : nullptr, one.input, trace);
    hand.withhold(one.input, report);
    hand.sent(one.input);
    return report;
  };
  const TickInput& last = ticks.back().input;
  Vec3 at = last.hand.position;
  Rest rest;
  rest.report.proxy = at;
  for (const RunTick& one : ticks.first(ticks.size() - 1)) {
    rest.report = run(one, nullptr);
    ++rest.ticks;
    at = one.input.hand.position;
  }
  LimiterState limiter = hand.state().limiter();
  StepTrace trace;
  const StepReport report = run(ticks.back(), &trace);
  const LimitedForce limited =
      limitForce(report.wanted, last.hand.position, last.dt, limits, limiter, report.fresh);
  const ExplainedTick tick{opened,  scene, at,    last.hand.position, rest, report, limited, limits,
                           last.dt, time,  trace, hand.state()};
  return {tickReport(tick), report.status == StepStatus::kFault};
}

}  // namespace palpate::cli
