#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/telemetry.h"
#include "palpate/scenes/apps/cli/again.h"
#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/slow_rate.h"
#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {
namespace {

// [N]: yields at smaller loads do not count, because drags often yield at small loads. Exception:
// the proxy passes a surface within one tick, before the mode has borne a load.
constexpr double kLoad = 0.05;
constexpr double kMostSteps = 1e6;  // Largest number of steps in one direction

struct PressOptions {
  std::string scene;
  std::string at;
  std::string along;
  double speed = 0.05;  // [m/s]
  double rate = 1000.0;
  std::string csv;
  PictureOptions picture;
  bool json = false;
};

/// Path of the hand: straight to the end and back, in equal steps.
struct Way {
  Vec3 at;
  Vec3 along;
  int steps = 1;

  [[nodiscard]] double length() const { return along.norm(); }
  [[nodiscard]] Vec3 direction() const { return along / length(); }
  [[nodiscard]] bool inwards(int tick) const { return tick <= steps; }
  /// Returns the depth in a tick as a fraction of the path's length, 0 to 1.
  [[nodiscard]] double share(int tick) const {
    return static_cast<double>(inwards(tick) ? tick : 2 * steps - tick) / steps;
  }
  [[nodiscard]] Vec3 hand(int tick) const { return at + share(tick) * along; }
};

/// Results of one tick. "Along" and "across" mean along and perpendicular to the hand's path.
struct Row {
  bool in = true;
  double depth = 0.0;         ///< Depth of the hand [m].
  double force_along = 0.0;   ///< Component along the path [N]; positive: pushes the hand out.
  double force_across = 0.0;  ///< Magnitude of the component perpendicular to the path [N].
  double proxy_depth = 0.0;   ///< Depth of the proxy [m].
  double proxy_across = 0.0;  ///< Distance of the proxy from the path [m].
  double injected = 0.0;      ///< Energy that the proxy's own motion added [J].
  StepStatus status = StepStatus::kConverged;
  bool limited = false;
  std::string contacts;  ///< State of each mode, for example "bone=holds; blood=yields"
};

struct Yield {
  double depth = 0.0;        ///< Depth of the hand [m].
  double proxy_depth = 0.0;  ///< Depth of the proxy [m].
  /// Load without friction and drag [N]; unset if the proxy has passed the surface in this tick.
  std::optional<double> force;
  double force_along = 0.0;  ///< Hand's force along the path [N]; positive: out.
  double held = 0.0;         ///< Largest load up to the yield [N].
};

/// Results of one mode. All members except `held` describe the way in.
struct ModePressed {
  std::optional<double> touched;  ///< Depth of the hand at which the mode's load begins [m].
  double held = 0.0;              ///< Largest load on the way in or out [N].
  bool ready = false;             ///< True after the mode has held in a tick without yielding.
  std::optional<Yield> yield;     ///< First yield after `ready` has become true.
  std::optional<double> let_go;   ///< Depth at which the load last ends after the yield [m].
};

class Curve {
 public:
  Curve(const Opened& opened, const Way& way)
      : scene_(*opened.built.scene), way_(way), modes_(scene_.graph.modes.size()) {
    for (const std::string& name : scene_.graph.mode_names) names_.push_back(Legible(name).text());
  }

  void add(int tick, const StepReport& r, const ProxyState& state, const StepTrace& trace) {
    Row row = seen(tick, r);
    for (std::size_t i = 0; i < modes_.size(); ++i) {
      const std::vector<Load> loads = loadsOf(state, r, i);
      follow(modes_[i], loads, yielded(trace, i), row);
      tell(row, i, loads, sideOf(state.memory(i)));
    }
    count(tick, r, row);
    rows_.push_back(std::move(row));
  }

  [[nodiscard]] const std::vector<Row>& rows() const { return rows_; }
  [[nodiscard]] OrderedJson summary(const PressOptions& options, const std::string& source) const;

 private:
  [[nodiscard]] Row seen(int tick, const StepReport& r) const {
    const Vec3 u = way_.direction();
    const Vec3 proxy = r.proxy - way_.at;
    Row row;
    row.in = way_.inwards(tick);
    row.depth = way_.share(tick) * way_.length();
    row.force_along = 0.0 - r.force.dot(u);
    row.force_across = (r.force - r.force.dot(u) * u).norm();
    row.proxy_depth = proxy.dot(u);
    row.proxy_across = (proxy - proxy.dot(u) * u).norm();
    row.injected = r.injected;
    row.status = r.status;
    row.limited = r.limited;
    return row;
  }

  /// Returns true if mode i yielded in any sub-step, even if the mode holds at the end of the tick.
  static bool yielded(const StepTrace& trace, std::size_t i) {
    const auto steps = trace.steps();
    return std::any_of(steps.begin(), steps.end(), [i](const StepTrace::Step& step) {
      return !step.foreseen && step.yields.test(i);
    });
  }

  static void follow(ModePressed& mode, const std::vector<Load>& loads, bool yielded,
                     const Row& row) {
    constexpr double kNewtons = 1e-6;  // [N]: smaller forces are rounding errors
    const double held = totalOf(loads).norm();
    const bool carries = held > kNewtons;
    mode.held = std::max(mode.held, held);
    if (!row.in) return;
    if (carries && !mode.touched) {
      mode.touched = row.depth;
      // A yield before the mode's first load does not count.
      mode.yield.reset();
    }
    // A surface that the proxy has passed in this tick is not among the loads at the tick's end.
    const bool gone = yielded && !carries;
    const bool yields = gone || (carries && holdOf(loads) == Hold::kYields);
    const bool counts = mode.held >= kLoad || (gone && !mode.touched);
    if (yields && counts && mode.ready && !mode.yield) {
      mode.yield = Yield{row.depth, row.proxy_depth, std::nullopt, row.force_along, mode.held};
      if (!gone) mode.yield->force = totalOf(bearersOf(loads)).norm();
    }
    mode.ready = mode.ready || !yields;
    if (carries) {
      mode.let_go.reset();
    } else if (mode.yield && !mode.let_go) {
      mode.let_go = row.depth;
    }
  }

  void tell(Row& row, std::size_t i, const std::vector<Load>& loads, Side side) const {
    const bool inside = side == Side::kInside;
    if (loads.empty() && !inside) return;
    const char* word = inside && holdOf(loads) == Hold::kIdle ? "inside" : wordFor(holdOf(loads));
    row.contacts += (row.contacts.empty() ? "" : "; ") + names_[i] + "=" + word;
  }

  /// Adds a tick to the counts and energies. The force of a tick acts until the next tick.
  void count(int tick, const StepReport& r, const Row& row) {
    const Vec3 hand = way_.hand(tick);
    if (rows_.empty()) {
      bound_ = 0.5 * r.stiffness * (r.proxy - hand).squaredNorm();
    } else {
      const Vec3 moved = hand - way_.hand(tick - 1);
      net_ += last_force_.dot(moved);
      bound_ += r.injected + 0.5 * last_stiffness_ * moved.squaredNorm();
      injected_ += r.injected;
      const double work =
          0.5 * (row.force_along + rows_.back().force_along) * (row.depth - rows_.back().depth);
      (row.in ? work_in_ : work_out_) += row.in ? work : -work;
    }
    ++statuses_[static_cast<std::size_t>(r.status)];
    limited_ += static_cast<int>(r.limited);
    last_force_ = r.force;
    last_stiffness_ = r.stiffness;
  }

  /// Returns the slope of a line fitted between the first force and the first yield of a load of at
  /// least 50 mN [N/m]; empty if the force does not rise, or fewer than three ticks have a force.
  [[nodiscard]] std::optional<double> slope() const;

  const Scene& scene_;
  const Way way_;
  std::vector<Row> rows_;
  std::vector<ModePressed> modes_;
  std::vector<std::string> names_;  ///< Names of the modes, which need not differ.
  std::array<int, kStepStatuses> statuses_{};
  Vec3 last_force_ = Vec3::Zero();
  double last_stiffness_ = 0.0;
  double net_ = 0.0;    ///< Work of the force on the hand [J].
  double bound_ = 0.0;  ///< Largest work that a passive engine could have done [J].
  double injected_ = 0.0;
  double work_in_ = 0.0;
  double work_out_ = 0.0;
  int limited_ = 0;
};

std::optional<double> Curve::slope() const {
  constexpr double kNewtons = 1e-6;
  double first_yield = std::numeric_limits<double>::infinity();
  for (const ModePressed& mode : modes_) {
    if (mode.yield && mode.yield->held >= kLoad) {
      first_yield = std::min(first_yield, mode.yield->depth);
    }
  }
  double n = 0.0;
  double x = 0.0;
  double y = 0.0;
  double xx = 0.0;
  double xy = 0.0;
  for (const Row& row : rows_) {
    if (!row.in || row.depth >= first_yield || std::abs(row.force_along) <= kNewtons) continue;
    n += 1.0;
    x += row.depth;
    y += row.force_along;
    xx += row.depth * row.depth;
    xy += row.depth * row.force_along;
  }
  const double spread = n * xx - x * x;
  if (n < 3.0 || !(spread > 0.0)) return std::nullopt;
  const double slope = (n * xy - x * y) / spread;
  return slope > 0.0 ? std::optional<double>(slope) : std::nullopt;
}

OrderedJson orNull(const std::optional<double>& value) {
  return value ? OrderedJson(*value) : OrderedJson();
}

/// Returns true if a mode carried at least kLoad before the mode yielded.
bool bore(const OrderedJson& yield) {
  return !yield.is_null() && yield["held"].get<double>() >= kLoad;
}

OrderedJson report(const std::string& name, const ModePressed& mode) {
  OrderedJson json;
  json["mode"] = name;
  json["touched_at"] = orNull(mode.touched);
  json["held_max"] = mode.held;
  json["yield"] = nullptr;
  if (mode.yield) {
    json["yield"] = {{"depth", mode.yield->depth},
                     {"proxy_depth", mode.yield->proxy_depth},
                     {"force", mode.yield->force ? OrderedJson(*mode.yield->force) : OrderedJson()},
                     {"force_along", mode.yield->force_along},
                     {"held", mode.yield->held}};
  }
  json["let_go_at"] = orNull(mode.let_go);
  return json;
}

OrderedJson Curve::summary(const PressOptions& options, const std::string& source) const {
  const auto most = std::max_element(rows_.begin(), rows_.end(), [](const Row& a, const Row& b) {
    return std::hypot(a.force_along, a.force_across) < std::hypot(b.force_along, b.force_across);
  });
  OrderedJson json;
  json["scene"] = source;
  json["at"] = toJson(way_.at);
  json["along"] = toJson(way_.along);
  json["depth"] = way_.length();
  json["speed"] = way_.length() / way_.steps * options.rate;
  json["rate"] = options.rate;
  json["ticks"] = rows_.size();
  json["force_max"] = {{"force", std::hypot(most->force_along, most->force_across)},
                       {"depth", most->depth},
                       {"phase", most->in ? "in" : "out"}};
  json["stiffness"] = orNull(slope());
  json["work_in"] = work_in_;
  json["work_out"] = work_out_;
  json["hysteresis"] = work_in_ - work_out_;
  json["net_energy"] = net_;
  json["net_energy_bound"] = bound_;
  json["injected_energy"] = injected_;
  json["limited"] = limited_;
  json["status"] = OrderedJson::object();
  for (std::size_t i = 0; i < statuses_.size(); ++i) {
    json["status"][wordFor(static_cast<StepStatus>(i))] = statuses_[i];
  }
  json["modes"] = OrderedJson::array();
  for (std::size_t i = 0; i < modes_.size(); ++i) {
    json["modes"].push_back(report(scene_.graph.mode_names[i], modes_[i]));
  }
  return json;
}

/// Quotes a CSV field if necessary.
std::string field(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
  return quoted + "\"";
}

std::string csv(const std::vector<Row>& rows) {
  std::string text =
      "phase,depth,force_along,force_across,proxy_depth,proxy_across,injected,status,limited,"
      "contacts\n";
  for (const Row& row : rows) {
    text += fmt::format("{},{},{},{},{},{},{},{},{},{}\n", row.in ? "in" : "out", number(row.depth),
                        number(row.force_along), number(row.force_across), number(row.proxy_depth),
                        number(row.proxy_across), number(row.injected), wordFor(row.status),
                        row.limited ? 1 : 0, field(sentence(row.contacts).text()));
  }
  return text;
}

/// Prints at most eleven rows, evenly spaced.
void printTable(const Curve& curve, int steps) {
  constexpr int kLines = 10;
  say("{:>12} {:>12} {:>12} {:>12}  contacts while moving in\n", "depth mm", "in N", "out N",
      "proxy mm");
  const std::vector<Row>& rows = curve.rows();
  int last = -1;
  for (int line = 0; line <= kLines; ++line) {
    const int i = static_cast<int>(std::llround(static_cast<double>(line) / kLines * steps));
    if (i == last) continue;
    last = i;
    const Row& in = rows[static_cast<std::size_t>(i)];
    const Row& out = rows[static_cast<std::size_t>(2 * steps - i)];
    say("{:>12} {:>12} {:>12} {:>12}  {}\n", shown(1e3 * in.depth), shown(in.force_along),
        shown(out.force_along), shown(1e3 * in.proxy_depth), sentence(in.contacts));
  }
}

std::string millimetres(const OrderedJson& metres) {
  return shown(1e3 * metres.get<double>()) + " mm";
}

void printPressed(const OrderedJson& mode) {
  const OrderedJson& yield = mode["yield"];
  const double held = mode["held_max"].get<double>();
  constexpr double kNewtons = 1e-6;  // [N]: smaller forces are rounding errors
  std::string text;
  if (!mode["touched_at"].is_null()) {
    text = fmt::format("contact from {}, load up to {} N", millimetres(mode["touched_at"]),
                       shown(held));
  } else if (held > kNewtons) {
    text = fmt::format("contact only on the way out, load up to {} N", shown(held));
  } else if (yield.is_null()) {
    text = "no contact";
  }
  if (!yield.is_null()) {
    text += (text.empty() ? "yielded at " : "; yielded at ") + millimetres(yield["depth"]);
    text += yield["force"].is_null()
                ? " within one tick, load unknown"
                : fmt::format(" under {} N", shown(yield["force"].get<double>()));
  }
  if (!mode["let_go_at"].is_null()) text += "; released at " + millimetres(mode["let_go_at"]);
  say("mode      {}: {}\n", mode["mode"].get<std::string>(), sentence(text));
}

void printPress(const OrderedJson& json) {
  const auto of = [](const OrderedJson& value) { return shown(value.get<double>()); };
  say("press     {} deep at {} m/s, {} ticks\n", millimetres(json["depth"]), of(json["speed"]),
      json["ticks"].get<std::size_t>());
  say("force     at most {} N, at {} moving {}; the limiter acted in {}\n",
      of(json["force_max"]["force"]), millimetres(json["force_max"]["depth"]),
      json["force_max"]["phase"].get<std::string>(),
      counted(json["limited"].get<int>(), "tick", "ticks"));
  const bool yielded = std::any_of(json["modes"].begin(), json["modes"].end(),
                                   [](const OrderedJson& mode) { return bore(mode["yield"]); });
  say("stiffness {}\n", json["stiffness"].is_null() ? "not measured"
                        : yielded ? of(json["stiffness"]) + " N/m up to the first yield"
                                  : of(json["stiffness"]) + " N/m on the way in");
  for (const OrderedJson& mode : json["modes"]) printPressed(mode);
  say("energy    the hand gave {} J on the way in and got back {} J on the way out; {} J were "
      "lost\n",
      of(json["work_in"]), of(json["work_out"]), of(json["hysteresis"]));
  say("          {} J given to the hand (passive: at most {} J); {} J added by the proxy's own "
      "motion\n",
      of(json["net_energy"]), of(json["net_energy_bound"]), of(json["injected_energy"]));
}

/// Returns the curve for the picture: at most 4,000 rows, and the depths at which each mode begins
/// to hold, yields and ends.
OrderedJson drawnCurve(const Curve& curve, const OrderedJson& summary) {
  constexpr std::size_t kMostRows = 4000;
  const std::size_t every = curve.rows().size() / kMostRows + 1;
  OrderedJson json;
  json["in"] = json["out"] = OrderedJson::array();
  for (std::size_t i = 0; i < curve.rows().size(); i += every) {
    const Row& row = curve.rows()[i];
    json[row.in ? "in" : "out"].push_back({row.depth, row.force_along});
  }
  json["marks"] = OrderedJson::array();
  const auto mark = [&](const OrderedJson& mode, const char* event, const OrderedJson& depth) {
    if (depth.is_null()) return;
    const std::string name = sentence(mode["mode"].get<std::string>()).text();
    json["marks"].push_back({{"name", name + event}, {"depth", depth}});
  };
  for (const OrderedJson& mode : summary["modes"]) {
    mark(mode, "", mode["touched_at"]);
    const OrderedJson& yield = mode["yield"];
    if (bore(yield)) mark(mode, " yields", yield["depth"]);
    mark(mode, " ends", mode["let_go_at"]);
  }
  return json;
}

Way wayOf(const PressOptions& options) {
  Way way;
  way.at = readVector("--at", options.at);
  way.along = readVector("--along", options.along);
  checkReach("--along", way.at + way.along);
  if (!(way.length() > 1e-9)) {
    throw Error("--along",
                fmt::format("its length is the depth, and {} m is not above 1e-9 m", way.length()),
                "give metres, for example 0,0,-0.01");
  }
  if (!(options.speed > 0.0) || !std::isfinite(options.speed)) {
    throw Error("--speed", fmt::format("{} m/s is not a finite number above 0", options.speed),
                "use 0.05");
  }
  const double steps = std::ceil(way.length() * options.rate / options.speed * (1.0 - 1e-12));
  if (!(steps <= kMostSteps)) {
    throw Error("--speed", fmt::format("each way of the path takes more than {} ticks", kMostSteps),
                "press faster, less deep or at a lower rate");
  }
  way.steps = std::max(1, static_cast<int>(steps));
  return way;
}

void checkOutputs(const PressOptions& options, const SceneSpec& spec) {
  checkOutputsApart({options.csv, options.picture.file, options.json ? "-" : ""},
                    inputsOf(options.scene, spec));
}

template <class Seen>
bool run(const Scene& scene, const Way& way, double rate, Seen&& seen) {
  Reader reader;
  ProxyState state(pathLimits());
  const double dt = 1.0 / rate;
  StepTrace trace;
  Telemetry tick;
  tick.scene = scene.id;
  tick.report = restAt(scene, reader, state, way.at, dt).report;
  for (int i = 0; i <= 2 * way.steps; ++i) {
    tick.probe = way.hand(i);
    tick.time = i * dt;
    if (i > 0) tick.report = hapticStep(scene, reader, {tick.probe}, state, dt, &trace);
    seen(i, tick, state, trace);
  }
  return !state.faulted();
}

/// Explains a press without a force if the whole path is outside the scene's bounds.
void hintAtBounds(const Box& bounds, const Way& way, const OrderedJson& summary) {
  if (summary["force_max"]["force"].get<double>() > 0.0) return;
  for (int i = 0; i <= way.steps; ++i) {
    if (holds(bounds, way.hand(i))) return;
  }
  complain(
      fmt::format("press: the hand felt no force: the path is outside the scene's bounds, {} to {} "
                  "m: give --at and --along in metres, through these bounds",
                  placeWords(bounds.lower), placeWords(bounds.upper)));
}

int press(const PressOptions& options) {
  checkRate("--rate", options.rate);
  noteSlowRate("press", options.rate);
  checkPicture(options.picture);
  const Way way = wayOf(options);
  const auto trial = [&](const BuiltScene& built) {
    Near near;
    run(*built.scene, way, options.rate,
        [&](int, const Telemetry& tick, const ProxyState& state, const StepTrace&) {
          near.add(state, tick.report);
        });
    return near;
  };
  const Opened opened = openFor(options.scene, trial);
  checkOutputs(options, opened.spec);
  if (!opened.built.sequences.empty()) complain("press: the first frame of each sequence acts");
  std::optional<Picture> picture;
  if (!options.picture.file.empty()) picture.emplace(options.picture);
  std::optional<WholeFile> file;
  if (!options.csv.empty()) file.emplace(options.csv);

  Felt felt(*opened.built.scene, options.rate);
  Curve curve(opened, way);
  const auto seen = [&](int i, const Telemetry& tick, const ProxyState& state,
                        const StepTrace& trace) {
    curve.add(i, tick.report, state, trace);
    if (!picture) return;
    picture->add(tick);
    felt.add(tick, state);
  };
  std::function<void(double)> progress = showProgress("pressing");
  const bool good = run(*opened.built.scene, way, options.rate, seen);
  progress = nullptr;
  if (file) {
    file->write(csv(curve.rows()));
    file->commit();
  }
  const OrderedJson summary = curve.summary(options, opened.spec.source);
  if (options.json) {
    sayJson(summary);
  } else if (options.csv != "-") {
    printTable(curve, way.steps);
    printPress(summary);
  }
  hintAtBounds(opened.built.bounds, way, summary);
  if (!good) {
    complain("press: the force was cut: a sample or a force was not finite: correct the volume");
  }
  // Draws the picture last: if drawing fails, the results are already written.
  if (picture) picture->draw(opened.told, opened.built, felt, drawnCurve(curve, summary));
  return good ? kDone : kEndedEarly;
}

}  // namespace

void addPress(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("press", "Presses straight in and out; prints the force-depth curve");
  auto options = std::make_shared<PressOptions>();
  verb->add_option("SCENE", options->scene, "A scene file, a .vdb, or a folder of .vdb or bricks")
      ->required();
  verb->add_option("--at", options->at, "x,y,z: start and end position of the hand [m]")
      ->required();
  verb->add_option("--along", options->along,
                   "x,y,z: the hand's move from --at; its length is the depth [m]")
      ->required();
  verb->add_option("--speed", options->speed, "Speed of the hand [m/s] (default 0.05)");
  verb->add_option("--rate", options->rate, "Ticks a second (default 1000)");
  verb->add_option("--csv", options->csv, "Writes the curve, one row a tick; - is standard output");
  addPictureOptions(*verb, options->picture,
                    "Draws the path over slices and the force over depth: .png, .pdf or .svg");
  verb->add_flag("--json", options->json, "Print the summary as JSON");
  verb->footer(
      "Example:\n  palpate press head.json --at 0,0,0.06 --along 0,0,-0.02 --csv curve.csv");
  verb->callback([=, &body] { body = [=] { return press(*options); }; });
}

}  // namespace palpate::cli
