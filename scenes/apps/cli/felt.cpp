#include "palpate/scenes/apps/cli/felt.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "palpate/scenes/apps/cli/again.h"

namespace palpate::cli {
namespace {

constexpr double kStep = 1.02;  // Ratio of the upper to the lower bound of a bin

Legible modeWords(const OrderedJson& mode) {
  Legible text = words("contact   {}: ", mode["mode"].get<std::string>());
  if (mode["touches"].get<int>() == 0) return text += words("none\n");
  text += words("{} s in {}, up to {} N", rounded(mode["seconds"].get<double>()),
                counted(mode["touches"].get<int>(), "touch", "touches"),
                rounded(mode["held_max"].get<double>()));
  const OrderedJson& at = mode["at"];
  text += words(" at {} m",
                placeWords({at[0].get<double>(), at[1].get<double>(), at[2].get<double>()}));
  if (mode["pushed_through"].get<int>() > 0) {
    text +=
        words(", pushed through {}", counted(mode["pushed_through"].get<int>(), "time", "times"));
  }
  return text += words("\n");
}

}  // namespace

void Durations::add(std::int64_t ns) {
  const std::int64_t value = std::max<std::int64_t>(ns, 0);
  auto bin = static_cast<std::size_t>(value);
  if (bin >= kExact) {
    const double steps = std::log(static_cast<double>(value) / kExact) / std::log(kStep);
    bin = kExact + std::min(static_cast<std::size_t>(steps), kCoarse - 1);
  }
  ++counts_[bin];
  ++count_;
  max_ = std::max(max_, value);
}

std::int64_t Durations::percentile(double share) const {
  const auto wanted = static_cast<std::int64_t>(std::ceil(share * static_cast<double>(count_)));
  std::int64_t sum = 0;
  for (std::size_t bin = 0; bin < counts_.size(); ++bin) {
    sum += counts_[bin];
    if (sum == 0 || sum < wanted) continue;
    if (bin < kExact) return static_cast<std::int64_t>(bin);
    const double upper = kExact * std::pow(kStep, static_cast<double>(bin - kExact + 1));
    return std::min(max_, static_cast<std::int64_t>(upper));
  }
  return 0;
}

std::shared_ptr<Felt::SceneFelt> Felt::startOf(const Scene& scene) {
  auto felt = std::make_shared<SceneFelt>();
  felt->id = scene.id;
  felt->names = scene.graph.mode_names;
  felt->motions = scene.graph.motions;
  felt->motion_of = scene.graph.mode_motions;
  felt->volumes = scene.graph.scalar_reads.size() + scene.graph.vector_reads.size();
  felt->own = felt->names.size();
  std::map<std::vector<std::string>, std::size_t> known;
  felt->modes_of_part.reserve(scene.parts.size());
  for (const Part& part : scene.parts) {
    const auto [place, fresh] = known.try_emplace(part.graph.mode_names, felt->names.size());
    felt->modes_of_part.push_back(place->second);
    if (!fresh) continue;
    felt->names.insert(felt->names.end(), place->first.begin(), place->first.end());
    felt->volumes += part.graph.scalar_reads.size() + part.graph.vector_reads.size();
  }
  felt->modes.resize(felt->names.size());
  return felt;
}

Felt::Felt(const Scene& scene, double rate)
    : rate_(rate), carriers_(scene.graph.mode_names), parts_(!scene.parts.empty()) {
  if (parts_) carriers_.emplace_back("parts");
  expect(scene);
}

std::vector<int> Felt::loadsOf(std::span<const std::string> modes) const {
  std::vector<int> loads;
  // For each name, the index at which the search for its next mode begins
  std::map<std::string, std::size_t> after;
  const std::size_t own = carriers_.size() - (parts_ ? 1 : 0);
  for (const std::string& name : modes) {
    std::size_t& i = after[name];
    while (i < own && carriers_[i] != name) ++i;
    loads.push_back(i < own ? static_cast<int>(i++) : -1);
  }
  return loads;
}

void Felt::expect(const Scene& scene) {
  scenes_.push_back(startOf(scene));
  scenes_.back()->load_of = loadsOf(scene.graph.mode_names);
  expected_.draft() = scenes_.back();
  expected_.publish();
}

void Felt::add(const Telemetry& tick, const ProxyState& state) noexcept {
  const StepReport& r = tick.report;
  // The last force acted until this reading, so it did work along the hand's move.
  const Vec3 moved = durations_.count() > 0 ? Vec3(tick.probe - last_probe_) : Vec3::Zero();
  net_energy_ += last_force_.dot(moved);
  last_probe_ = tick.probe;
  last_force_ = r.force;
  countTick(tick);
  addTank(r, state);
  std::fill_n(loads_.begin(), carriers_.size(), 0.0);
  SceneFelt* const felt = enterScene(tick.scene);
  if (felt == nullptr) return;
  const TickForces forces = addForces(*felt, r, state);

  // A force counts half during a fast move, because the hand is exposed to the force only briefly.
  constexpr double kFast = 0.1;  // [m/s]
  const double size = r.force.norm();
  const double worth = (moved.norm() * rate_ > kFast ? 0.5 : 1.0) * size;
  if (forces.most <= 0.0 || worth <= most_.worth) return;
  const std::size_t main = forces.main;
  most_ = {worth,           size,       tick.time, tick.probe, r.proxy, r.stiffness,
           r.wanted.norm(), tick.scene, main,      {}};
  const int motion = main < felt->own ? felt->motion_of[main] : -1;
  if (motion >= 0) most_.pose = state.bodies()[static_cast<std::size_t>(motion)].pose;
}

void Felt::countTick(const Telemetry& tick) noexcept {
  const StepReport& r = tick.report;
  durations_.add(tick.tick_ns);
  wakes_.add(tick.wake_ns);
  late_ = tick.late_ticks;
  last_time_ = tick.time;
  if (tick.fault != fault_) ++faults_[static_cast<std::size_t>(tick.fault)];
  fault_ = tick.fault;
  cut_ += static_cast<std::int64_t>(tick.fault != Fault::kNone);
  ++statuses_[static_cast<std::size_t>(r.status)];
  closed_form_ += static_cast<std::int64_t>(r.solver == SolverKind::kClosedForm);
  limited_ += static_cast<std::int64_t>(r.limited);
  samples_ += r.samples;
  coarse_ += static_cast<std::int64_t>(r.coarse);
  traced_ += r.traced;
  walked_ += r.walked;
  substeps_ += r.substeps;
  primitives_ += r.primitives;
  iterations_ += r.iterations;
  constexpr double kPulled = 1e-3;  // [N]: smallest pull that counts
  pulled_ += static_cast<std::int64_t>(r.left * tick.input.pull.norm() > kPulled);
  force_max_ = std::max(force_max_, r.force.norm());
  strong_ += static_cast<std::int64_t>(r.force.norm() > kStrong);
  bound_max_ = std::max(bound_max_, r.error_bound);
  injected_ += r.injected;
  still_ += static_cast<std::int64_t>(r.moving < 1.0);
  near_ += r.parts;
  most_near_ = std::max<std::int64_t>(most_near_, r.parts);
  crowded_ += static_cast<std::int64_t>(r.left_out > 0);
  missing_ = std::max(missing_, r.missing);
}

void Felt::addTank(const StepReport& r, const ProxyState& state) noexcept {
  drained_ += static_cast<std::int64_t>(r.share < 1.0);
  // An acting tank has already reduced r.force; a monitoring tank leaves r.force unchanged.
  const double size = r.force.norm();
  const bool acts = state.limits().tank.use == TankUse::kAct;
  const double asked = acts && r.share > 0.0 ? size / r.share : acts ? r.wanted.norm() : size;
  asked_ += asked;
  lost_ += (1.0 - r.share) * asked;
  least_energy_ = std::min(least_energy_, r.energy);
  debt_ = state.limiter().tank.debt();
  refilled_ = state.limiter().tank.refilled();
  tank_ = state.limits().tank.use;
}

Felt::SceneFelt* Felt::enterScene(std::uint64_t id) noexcept {
  // The loop gets a scene only after expect() has got it, so the scene is already in the mailbox.
  if (!expected_.current() || expected_.current()->id != id) expected_.refresh();
  if (!expected_.current() || expected_.current()->id != id) return nullptr;
  if (scene_ != id) {
    scene_ = id;
    own_ = {};
    slots_.fill({});
  }
  return expected_.current().get();
}

Felt::TickForces Felt::addForces(SceneFelt& felt, const StepReport& r,
                                 const ProxyState& state) noexcept {
  TickForces forces;
  if (r.status != StepStatus::kFault) forces.left = state.forces();
  for (std::size_t i = 0; i < felt.own; ++i) {
    addMode(felt, i, {r.proxy, state.memory(i), own_.of[i]}, forces);
  }
  for (const std::uint8_t slot : state.near().order()) {
    const NearPart& near = state.near()[slot];
    if (near.part >= felt.modes_of_part.size()) continue;
    Contacts& last = slots_[slot];
    if (last.part != near.part) last = {near.part, {}};
    const std::size_t first = felt.modes_of_part[near.part];
    const std::size_t count = near.modes;
    for (std::size_t i = 0; i < count; ++i) {
      addMode(felt, first + i, {r.proxy, near.memories[i], last.of[i]}, forces);
    }
  }
  if (parts_) loads_[carriers_.size() - 1] = forces.of_parts.norm();
  return forces;
}

void Felt::addMode(SceneFelt& felt, std::size_t index, const ModeTick& tick,
                   TickForces& forces) noexcept {
  // After a fault there can be fewer forces than primitives.
  Vec3 force = Vec3::Zero();
  const auto count = static_cast<std::size_t>(tick.memory.emitted);
  if (count <= forces.left.size()) {
    for (const Vec3& one : forces.left.first(count)) force += one;
    forces.left = forces.left.subspan(count);
  }
  const double held = force.norm();
  if (held > forces.most) {
    forces.most = held;
    forces.main = index;
  }
  if (index >= felt.own) {
    forces.of_parts += force;
  } else if (felt.load_of[index] >= 0) {
    loads_[static_cast<std::size_t>(felt.load_of[index])] = held;
  }
  countMode(felt.modes[index], held, tick);
}

void Felt::countMode(ModeFelt& mode, double held, const ModeTick& tick) const noexcept {
  constexpr double kNewtons = 1e-3;  // [N]: smallest force of a contact
  constexpr double kPause = 0.05;    // [s]: shortest pause between two contacts
  const std::int64_t now = durations_.count();
  const Side side = sideOf(tick.memory);
  if (side == Side::kYielded && tick.last != Side::kYielded) ++mode.yields;
  mode.inside = mode.inside || (side == Side::kInside && tick.last == Side::kUnknown);
  tick.last = side;
  mode.impulse += held;
  if (held < kNewtons) return;
  if (held > mode.held) {
    mode.held = held;
    mode.at = tick.proxy;
  }
  ++mode.active;
  if (mode.last_active < 0 || static_cast<double>(now - mode.last_active) > kPause * rate_) {
    ++mode.touches;
  }
  mode.last_active = now;
}

std::string Felt::inside() const {
  for (const auto& felt : scenes_) {
    for (std::size_t i = 0; i < felt->modes.size(); ++i) {
      if (felt->modes[i].inside) return felt->names[i];
    }
  }
  return {};
}

bool Felt::anything() const {
  return force_max_ >= kLeastForce && acted();
}

bool Felt::withheld() const {
  return force_max_ < kLeastForce && acted();
}

bool Felt::acted() const {
  if (pulled_ > 0) return true;
  return std::any_of(scenes_.begin(), scenes_.end(), [](const auto& felt) {
    return std::any_of(felt->modes.begin(), felt->modes.end(),
                       [](const ModeFelt& m) { return m.active > 0; });
  });
}

Most Felt::most() const {
  Most most;
  for (const auto& felt : scenes_) {
    if (!(most_.force > 0.0) || felt->id != most_.scene) continue;
    most = {most_.force,
            most_.time,
            most_.probe,
            most_.proxy,
            most_.stiffness,
            most_.wanted,
            felt->names[most_.mode],
            nullptr,
            most_.pose};
    const int motion = most_.mode < felt->own ? felt->motion_of[most_.mode] : -1;
    if (motion >= 0) most.motion = felt->motions[static_cast<std::size_t>(motion)];
  }
  return most;
}

std::map<std::string, double> Felt::impulses() const {
  std::map<std::string, double> impulses;
  for (const auto& felt : scenes_) {
    for (std::size_t i = 0; i < felt->modes.size(); ++i) {
      impulses[felt->names[i]] += felt->modes[i].impulse / rate_;
    }
  }
  return impulses;
}

OrderedJson Felt::summary() const {
  const auto count = static_cast<double>(durations_.count());
  const double ticks = std::max(1.0, count);
  OrderedJson json;
  json["ticks"] = durations_.count();
  json["seconds"] = count / rate_;
  json["rate_asked"] = rate_;
  json["rate_kept"] = last_time_ > 0.0 ? OrderedJson((count - 1.0) / last_time_) : OrderedJson();
  json["late_ticks"] = late_;
  json["wake_ns"] = {{"p50", wakes_.percentile(0.5)},
                     {"p99", wakes_.percentile(0.99)},
                     {"p99.9", wakes_.percentile(0.999)},
                     {"max", wakes_.max()}};
  json["tick_ns"] = {{"p50", durations_.percentile(0.5)},
                     {"p99", durations_.percentile(0.99)},
                     {"p99.9", durations_.percentile(0.999)},
                     {"max", durations_.max()}};
  json["force_max"] = force_max_;
  json["felt_anything"] = anything();
  json["felt_share"] = static_cast<double>(strong_) / ticks;
  json["error_bound_max"] = bound_max_;
  json["net_energy"] = net_energy_;
  json["injected_energy"] = injected_;
  const char* const uses[] = {"off", "observe", "act"};
  json["tank"] = {{"use", uses[static_cast<std::size_t>(tank_)]},
                  {"drained_ticks", drained_},
                  {"force_lost", asked_ > 0.0 ? lost_ / asked_ : 0.0},
                  {"energy_min", least_energy_},
                  {"debt", debt_},
                  {"refilled", refilled_}};
  json["per_tick"] = {{"samples", static_cast<double>(samples_) / ticks},
                      {"traced", static_cast<double>(traced_) / ticks},
                      {"walked", static_cast<double>(walked_) / ticks},
                      {"primitives", static_cast<double>(primitives_) / ticks},
                      {"substeps", static_cast<double>(substeps_) / ticks},
                      {"iterations", static_cast<double>(iterations_) / ticks}};
  json["solver"] = {{"closed-form", closed_form_},
                    {"general", static_cast<std::int64_t>(durations_.count()) - closed_form_}};
  json["volumes_active"] = scenes_.back()->volumes;
  const std::size_t parts = scenes_.back()->modes_of_part.size();
  if (parts > 0) {
    json["parts"] = {{"all", parts},
                     {"near_mean", static_cast<double>(near_) / ticks},
                     {"near_most", most_near_},
                     {"crowded_ticks", crowded_},
                     {"missing_max", missing_}};
  }
  json["status"] = OrderedJson::object();
  for (std::size_t i = 0; i < statuses_.size(); ++i) {
    json["status"][wordFor(static_cast<StepStatus>(i))] = statuses_[i];
  }
  json["limited"] = limited_;
  json["coarse_share"] = static_cast<double>(coarse_) / ticks;
  json["still_ticks"] = still_;
  json["faults"] = OrderedJson::object();
  for (std::size_t i = 1; i < kFaults; ++i) {
    if (faults_[i] > 0) json["faults"][wordFor(static_cast<Fault>(i))] = faults_[i];
  }
  json["scenes"] = scenes_.size();
  json["felt"] = OrderedJson::array();
  for (const auto& felt : scenes_) {
    for (std::size_t i = 0; i < felt->modes.size(); ++i) {
      const ModeFelt& mode = felt->modes[i];
      if (i >= felt->own && mode.active == 0) continue;
      json["felt"].push_back({{"mode", felt->names[i]},
                              {"seconds", static_cast<double>(mode.active) / rate_},
                              {"touches", mode.touches},
                              {"pushed_through", mode.yields},
                              {"held_max", mode.held},
                              {"at", mode.active > 0 ? toJson(mode.at) : OrderedJson()}});
    }
  }
  return json;
}

Legible Felt::words() const {
  const OrderedJson s = summary();
  const double ticks = std::max(1.0, s["ticks"].get<double>());
  const OrderedJson& per_tick = s["per_tick"];
  const auto us = [&](const char* key) { return rounded(1e-3 * s["tick_ns"][key].get<double>()); };
  const auto mean = [&](const char* key) { return rounded(per_tick[key].get<double>()); };
  Legible text = cli::words(
      "tick      {} us median, {} p99, {} p99.9, {} worst; per tick {} samples, {} vector reads "
      "along streams, {} cells searched for a surface, {} primitives, {} sub-steps\n",
      us("p50"), us("p99"), us("p99.9"), us("max"), mean("samples"), mean("traced"), mean("walked"),
      mean("primitives"), mean("substeps"));
  text += cli::words("balance   {} % closed form, {} iterations a tick; error at most {} m\n",
                     rounded(100.0 * static_cast<double>(closed_form_) / ticks), mean("iterations"),
                     rounded(bound_max_));
  text += cli::words(
      "force     at most {} N, above {} N in {} % of the ticks; the limiter acted in {}\n",
      rounded(force_max_), kStrong, rounded(100.0 * static_cast<double>(strong_) / ticks),
      counted(limited_, "tick", "ticks"));
  if (coarse_ > 0) {
    text += cli::words(
        "coarse    coarser data replaced missing data, or another frame replaced a missing frame, "
        "in {} % of the ticks\n",
        rounded(100.0 * static_cast<double>(coarse_) / ticks));
  }
  if (still_ > 0) {
    text += cli::words("still     the encoder counts did not change: the force faded in {}\n",
                       counted(still_, "tick", "ticks"));
  }
  const std::string troubles = troublesOf(s["status"]);
  if (!troubles.empty()) text += cli::words("status    {}\n", sentence(troubles));
  if (s.contains("parts")) text += partsWords(s["parts"]);
  text += cli::words("energy    {} J given to the hand; {} J added by the proxy's own motion\n",
                     rounded(net_energy_), rounded(injected_));
  if (tank_ != TankUse::kOff) text += tankWords(s["tank"], ticks);
  for (const auto& mode : s["felt"]) text += modeWords(mode);
  return text;
}

std::string Felt::troublesOf(const OrderedJson& statuses) const {
  std::string troubles;
  std::int64_t faults = 0;
  for (std::size_t i = 1; i < kFaults; ++i) faults += faults_[i];
  if (faults > 0) {
    troubles = fmt::format("{} fault{}, force off for {} ms", faults, faults == 1 ? "" : "s",
                           std::llround(1e3 * static_cast<double>(cut_) / rate_));
  }
  for (const auto& [status, count] : statuses.items()) {
    const auto ticks = count.get<std::int64_t>();
    if (status == wordFor(StepStatus::kConverged) || ticks == 0) continue;
    if (status == wordFor(StepStatus::kFault)) continue;
    troubles += fmt::format("{}{} in {}", troubles.empty() ? "" : ", ", status,
                            counted(ticks, "tick", "ticks"));
  }
  return troubles;
}

Legible Felt::partsWords(const OrderedJson& parts) const {
  Legible text = cli::words("parts     {} of {} near the hand on average, {} at most\n",
                            rounded(parts["near_mean"].get<double>()),
                            parts["all"].get<std::int64_t>(), most_near_);
  if (crowded_ > 0) {
    text += cli::words(
        "crowded   more than {} parts were near the hand in {} ticks: only the strongest were "
        "used; the force error was at most {} N\n",
        kMaxNearParts, crowded_, rounded(missing_));
  }
  return text;
}

Legible Felt::tankWords(const OrderedJson& tank, double ticks) const {
  const double share = 100.0 * static_cast<double>(drained_) / ticks;
  const double lost = 100.0 * tank["force_lost"].get<double>();
  if (tank_ != TankUse::kAct) {
    return cli::words(
        "tank      monitoring only; --passive would have acted in {} % of the ticks and removed {} "
        "% of the force\n",
        rounded(share), rounded(lost));
  }
  return cli::words(
      "tank      acted in {} % of the ticks and removed {} % of the force; debt {} J, refill {} "
      "J\n",
      rounded(share), rounded(lost), rounded(debt_), rounded(refilled_));
}

}  // namespace palpate::cli
