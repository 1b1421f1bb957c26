#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include <fmt/format.h>

#include "palpate/devices/recording/recording.h"
#include "palpate/engine/error.h"
#include "palpate/engine/tick/step_report.h"
#include "palpate/scenes/apps/cli/again.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {
namespace {

struct CompareOptions {
  std::string a;
  std::string b;
  bool json = false;
};

/// Returns the first input (or output, if `outputs`) in which two ticks differ; null if there is
/// none.
const RecordedField* differing(const RecordedTick& a, const RecordedTick& b, bool outputs) {
  const auto fields = recordedFields();
  const auto* x = reinterpret_cast<const char*>(&a);
  const auto* y = reinterpret_cast<const char*>(&b);
  for (const RecordedField& field : fields) {
    if (field.output != outputs) continue;
    if (std::memcmp(x + field.offset, y + field.offset, sizeOf(field)) != 0) return &field;
  }
  return nullptr;
}

/// Clears the fields that may differ between two runs with equal results.
RecordedTick given(RecordedTick tick) {
  tick.scene = 0;
  tick.tick_ns = tick.wake_ns = tick.late_ticks = 0;
  tick.missed = tick.coarse = 0;
  return tick;
}

Vec3 vector(const std::array<double, 3>& v) {
  return {v[0], v[1], v[2]};
}

/// Largest of the values passed to add(), and its tick.
struct Largest {
  double value = 0.0;
  std::optional<RecordedTick> tick;

  void add(double x, const RecordedTick& in) {
    // A difference of infinity or NaN counts as the largest difference.
    if (!std::isfinite(x)) x = std::numeric_limits<double>::infinity();
    if (tick && !(x > value)) return;
    value = x;
    tick = in;
  }
  [[nodiscard]] OrderedJson json() const {
    if (!tick || !(value > 0.0)) return nullptr;
    return {{"by", std::isfinite(value) ? OrderedJson(value) : OrderedJson("not finite")},
            {"tick", tick->tick},
            {"time", tick->time},
            {"hand", toJson(vector(tick->hand))},
            {"proxy", toJson(vector(tick->proxy))}};
  }
};

struct Difference {
  std::int64_t ticks = 0;   ///< Number of ticks that both recordings have.
  std::int64_t only_a = 0;  ///< Ticks that only recording A has.
  std::int64_t only_b = 0;
  std::int64_t differing = 0;              ///< Ticks with different outputs.
  std::optional<RecordedTick> other_hand;  ///< First tick with different inputs.
  const char* given = "";                  ///< Name of the first different input.
  std::optional<RecordedTick> first;       ///< First tick with different outputs.
  const char* field = "";                  ///< Name of the first different output.
  Largest force;                           ///< Largest difference of the force [N].
  Largest proxy;                           ///< Largest difference of the proxy's position [m].
  std::map<std::string, std::array<std::int64_t, 2>> statuses;

  [[nodiscard]] bool alike() const {
    return ticks > 0 && differing == 0 && !other_hand && only_a == 0 && only_b == 0;
  }
};

Difference compare(const Recording& a, const Recording& b) {
  Difference d;
  std::int64_t j = 0;
  for (std::int64_t i = 0; i < a.size(); ++i) {
    const RecordedTick x = a.tick(i);
    while (j < b.size() && b.tick(j).tick < x.tick) ++j;
    if (j == b.size() || b.tick(j).tick != x.tick) continue;
    const RecordedTick y = b.tick(j++);
    ++d.ticks;
    if (!d.other_hand) {
      if (const RecordedField* field = differing(given(x), given(y), false)) {
        d.other_hand = x;
        d.given = field->name;
      }
    }
    const RecordedField* field = differing(x, y, true);
    ++d.statuses[wordFor(telemetryOf(x).report.status)][0];
    ++d.statuses[wordFor(telemetryOf(y).report.status)][1];
    if (field == nullptr) continue;
    ++d.differing;
    if (!d.first) {
      d.first = x;
      d.field = field->name;
    }
    d.force.add((vector(x.force) - vector(y.force)).norm(), x);
    d.proxy.add((vector(x.proxy) - vector(y.proxy)).norm(), x);
  }
  d.only_a = a.size() - d.ticks;
  d.only_b = b.size() - d.ticks;
  return d;
}

OrderedJson jsonOf(const Difference& d, const Recording& a, const Recording& b) {
  const auto moment = [](const std::optional<RecordedTick>& tick, const char* field) {
    if (!tick) return OrderedJson();
    return OrderedJson{{"tick", tick->tick}, {"time", tick->time}, {"field", field}};
  };
  OrderedJson json;
  json["identical"] = d.alike();
  json["ticks"] = {a.size(), b.size()};
  json["lost"] = {a.lost(), b.lost()};
  json["torn"] = {a.torn(), b.torn()};
  json["compared"] = d.ticks;
  json["alone"] = {d.only_a, d.only_b};
  json["differing"] = d.differing;
  json["given_otherwise"] = moment(d.other_hand, d.given);
  json["first"] = moment(d.first, d.field);
  json["force"] = d.force.json();
  json["proxy"] = d.proxy.json();
  json["statuses"] = OrderedJson::object();
  for (const auto& [word, counts] : d.statuses) json["statuses"][word] = counts;
  return json;
}

void tell(const CompareOptions& options, const Difference& d, const Recording& a,
          const Recording& b) {
  const auto about = [](const char* what, const std::string& file, const Recording& r) {
    const std::string missing = r.incomplete();
    const std::string ticks = r.size() == 0
                                  ? "no ticks"
                                  : fmt::format("{} ticks, {} to {}", r.size(), r.tick(0).tick,
                                                r.tick(r.size() - 1).tick);
    say("{}         {}: {}{}\n", what, file, sentence(ticks),
        sentence(missing.empty() ? missing : "; " + missing));
  };
  about("A", options.a, a);
  about("B", options.b, b);
  if (d.only_a > 0 || d.only_b > 0) {
    say("missing   {} ticks are only in A, {} only in B\n", d.only_a, d.only_b);
  }
  if (d.ticks == 0) {
    say("outputs   not compared: A and B have no tick in common\n");
    return;
  }
  if (d.other_hand) {
    say("inputs    differ, first in tick {} ({} s): field {}\n", d.other_hand->tick,
        rounded(d.other_hand->time), d.given);
  }
  if (d.differing == 0) {
    say("outputs   identical to the last bit, {} ticks\n", d.ticks);
    return;
  }
  say("outputs   differ in {} of {} ticks, first in tick {} ({} s): field {}\n", d.differing,
      d.ticks, d.first->tick, rounded(d.first->time), d.field);
  const auto by = [](double value, const char* unit) {
    return sentence(std::isfinite(value) ? rounded(value) + " " + unit
                                         : "a value that is not finite");
  };
  say("force     differs by at most {}, proxy by at most {}\n", by(d.force.value, "N"),
      by(1e3 * d.proxy.value, "mm"));
  for (const auto& [word, counts] : d.statuses) {
    if (counts[0] == counts[1]) continue;
    say("status    {}: {} ticks in A, {} in B\n", word, counts[0], counts[1]);
  }
  if (d.force.tick && d.force.value > 0.0) {
    const RecordedTick& most = *d.force.tick;
    say("largest   force difference in tick {} ({} s), hand at {} m, proxy at {} m: {} N in A; B "
        "differs by {}\n",
        most.tick, rounded(most.time), placeWords(vector(most.hand)),
        placeWords(vector(most.proxy)), rounded(vector(most.force).norm()), by(d.force.value, "N"));
  }
}

/// Returns a `palpate explain` command for the tick with the largest difference; empty if unknown.
/// `file` is the recording `a`.
std::string explained(const Recording& a, const std::string& file, const Largest& force) {
  if (!force.tick || !(force.value > 0.0)) return {};
  try {
    std::optional<SceneInput> scene = sceneAsItIs(a, force.tick->scene);
    if (!scene) return {};
    if (a.scenes().size() == 1 && a.lost() == 0) {
      return explainLine(scene->file, file, force.tick->time);
    }
    scene->spec.waits = true;
    const BuiltScene built = buildScene(scene->spec, showProgress("loading"));
    Most most;
    most.probe = vector(force.tick->hand);
    most.proxy = vector(force.tick->proxy);
    most.stiffness = force.tick->stiffness;
    return explainLine(scene->file, againOf(most, *built.scene, a.setting().rate));
  } catch (const Interrupted&) {
    throw;
  } catch (const std::exception&) {
    // Without the scene's files or enough memory, the report has no command.
    return {};
  }
}

int compareThem(const CompareOptions& options) {
  const Recording a(options.a);
  const Recording b(options.b);
  const Difference d = compare(a, b);
  if (options.json) {
    const std::string why = explained(a, options.a, d.force);
    OrderedJson json = jsonOf(d, a, b);
    json["explain"] = why.empty() ? OrderedJson() : OrderedJson(why);
    sayJson(json);
  } else {
    tell(options, d, a, b);
    const std::string why = explained(a, options.a, d.force);
    if (!why.empty()) say("explain   {}\n", sentence(why));
  }
  return d.alike() ? kDone : kEndedEarly;
}

}  // namespace

void addCompare(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "compare", "Compares two recordings tick by tick, and prints where they differ");
  auto options = std::make_shared<CompareOptions>();
  verb->add_option("A", options->a, "A recording (made by `palpate feel --record`)")->required();
  verb->add_option("B", options->b, "The second recording")->required();
  verb->add_flag("--json", options->json, "Print JSON");
  verb->footer(
      "Exit status: 0 if the inputs and outputs of all ticks are identical to the last bit, 1 if "
      "not\n\nExample:\n  palpate feel head.json --device replay:a.rec --record b.rec\n  "
      "palpate compare a.rec b.rec");
  verb->callback([=, &body] { body = [=] { return compareThem(*options); }; });
}

}  // namespace palpate::cli
