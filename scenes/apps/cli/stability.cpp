#include "palpate/devices/simulated/stability.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/devices/arm/tested_arms.h"
#include "palpate/devices/hid/open_arm.h"
#include "palpate/devices/hid/profile_facts.h"
#include "palpate/devices/simulated/stability_map.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/script.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {
namespace {

struct StabilityOptions {
  std::string scene;
  std::optional<double> planes;
  std::string device;
  std::string map;
  double rate = 1000.0;
  double mass = ArmParams{}.mass;
  double viscous = ArmParams{}.viscous;
  double coulomb = ArmParams{}.coulomb;
  double encoder = ArmParams{}.encoder;
  double delay = ArmParams{}.delay;
  double grip = GripParams{}.stiffness;
  double grip_damping = GripParams{}.damping;
  double load = 1.0;
  int size = 65;
  bool json = false;
};

constexpr double kLeastStiffness = 50.0;  // [N/m]: lowest stiffness in a map
constexpr double kMostDamping = 50.0;     // [N s/m]: highest damping in a map

struct Setup {
  std::string name;
  MapContact contact;
  std::vector<MapMethod> methods;
};

/// The contact on an exploration path whose force is nearest to --load, and the parts near the
/// contact.
struct Touch {
  MapContact contact;
  Near near;
};

Touch touchOf(const BuiltScene& built, const StabilityOptions& options) {
  const Scene& scene = *built.scene;
  const double load = options.load;
  const double rate = options.rate;
  Reader reader;
  ProxyState state(pathLimits());
  constexpr double kSeconds = 10.0;
  const HandTarget hand = explore(built.bounds, kSeconds);
  Touch touch;
  MapContact& contact = touch.contact;
  double best = 1e9;
  for (long i = 0; i < std::lround(kSeconds * rate); ++i) {
    const Vec3 at = hand.at(static_cast<double>(i) / rate);
    const StepReport report = hapticStep(scene, reader, {at}, state, 1.0 / rate);
    const double off = std::abs(report.wanted.norm() - load);
    if (report.status != StepStatus::kConverged || report.wanted.norm() < 0.2 * load ||
        off >= best) {
      continue;
    }
    best = off;
    contact.place = report.proxy;
    contact.outwards = report.wanted.normalized();
    contact.primitives.assign(state.primitives().items().begin(), state.primitives().items().end());
    touch.near = {};
    touch.near.add(state, report);
  }
  if (contact.primitives.empty()) {
    throw Error(
        options.scene,
        fmt::format("on the exploration path no converged tick had a force of {} N (a fifth of "
                    "--load) or more",
                    rounded(0.2 * load)),
        "reduce --load, or run palpate check to see where the volumes are");
  }
  // Adds the parts that an oscillating hand can reach.
  constexpr double kAround = 0.01;  // [m]: distance from the contact
  for (std::size_t i = 0; i < scene.parts.size(); ++i) {
    const Box& bounds = scene.parts[i].bounds;
    const Vec3 nearest = contact.place.cwiseMax(bounds.lower).cwiseMin(bounds.upper);
    if ((nearest - contact.place).norm() < kAround) touch.near.parts.insert(i);
  }
  return touch;
}

Setup setupOf(const StabilityOptions& options, const std::vector<std::string>& outputs) {
  Setup setup;
  if (options.scene.empty()) {
    setup.name = options.planes ? fmt::format("two planes, {} degrees", *options.planes) : "a wall";
    setup.contact = options.planes ? troughContact(*options.planes) : wallContact();
    setup.methods = {solverOver(setup.contact)};
    return setup;
  }
  std::optional<Touch> touch;
  const auto trial = [&](const BuiltScene& built) {
    touch = touchOf(built, options);
    return touch->near;
  };
  const Opened opened = openFor(options.scene, trial);
  if (!touch) touch = touchOf(opened.built, options);
  checkOutputsApart(outputs, inputsOf(options.scene, opened.spec));
  setup.name = opened.spec.source;
  setup.contact = touch->contact;
  constexpr double kFree = 5e-3;  // [m]: distance from the surface at which the hand starts
  setup.methods = {
      wholeTick(opened.built.scene, setup.contact.place + kFree * setup.contact.outwards),
      solverOver(setup.contact)};
  return setup;
}

/// Copies the measured parameters of a tested arm, and encoder step and rate of its profile. Keeps
/// the values that the user has given.
void takeDevice(StabilityOptions& options, const CLI::App& verb) {
  const std::optional<ArmName> name = parseArmName(options.device);
  if (!name || name->profile.empty()) {
    throw Error("--device", "\"" + options.device + "\" does not name a profile",
                "write hid:PROFILE, hid:PROFILE@SERIAL or hid:FILE.json; for another arm leave out "
                "--device, and give --mass, --viscous, --coulomb and --delay");
  }
  const HidProfile profile =
      namedProfile(*name, [](const std::string& note) { complain("stability: " + note); });
  if (!profile.output) {
    throw Error("--device", profile.name + " gives no force", "name an arm that gives force");
  }
  std::string identity = name->serial;
  if (const auto arms = testedArms(identityOf(profile, "")); identity.empty()) {
    if (arms.size() > 1) {
      throw Error("--device", "several arms with this profile have been tested",
                  "name one of them, for example hid:" + name->profile + "@" + arms[0]);
    }
    if (!arms.empty()) identity = arms[0];
  }
  const MeasuredArm arm = measuredArm(identityOf(profile, identity));
  const auto take = [&](const char* option, double& to, double value) {
    if (verb.count(option) == 0) to = value;
  };
  if (arm.mass > 0.0) {
    take("--mass", options.mass, arm.mass);
    take("--viscous", options.viscous, arm.viscous);
    take("--coulomb", options.coulomb, arm.coulomb);
    take("--delay", options.delay, arm.delay + arm.doubt);
  } else if (verb.count("--mass") == 0 || verb.count("--viscous") == 0) {
    throw Error("--device", "mass and friction of " + options.device + " are not known",
                "run palpate devices --test " + options.device +
                    ", or give --mass and --viscous, and --coulomb and --delay if known");
  } else {
    std::vector<std::string> assumed;
    if (verb.count("--coulomb") == 0) {
      assumed.push_back(fmt::format("its Coulomb friction is taken as {} N", options.coulomb));
    }
    if (verb.count("--delay") == 0) {
      assumed.push_back(fmt::format("its delay is taken as {} s", options.delay));
    }
    if (!assumed.empty()) {
      complain(fmt::format("stability: {} has not been measured: {}", profile.name,
                           fmt::join(assumed, ", ")));
    }
  }
  take("--encoder", options.encoder, factsOf(profile).step);
  if (profile.output_rate > 0.0) take("--rate", options.rate, profile.output_rate);
}

void check(const StabilityOptions& options) {
  const auto within = [](const char* name, double value, double least, double most,
                         const char* unit) {
    if (value >= least && value <= most) return;
    throw Error(name, fmt::format("{} is not in {} to {} {}", value, least, most, unit),
                "give a value in this range");
  };
  within("--rate", options.rate, 100.0, 20000.0, "Hz");
  within("--mass", options.mass, 1e-3, 10.0, "kg");
  within("--viscous", options.viscous, 0.0, 100.0, "N s/m");
  within("--coulomb", options.coulomb, 0.0, 10.0, "N");
  within("--encoder", options.encoder, 0.0, 5e-4, "m");
  within("--delay", options.delay, 0.0, 0.02, "s");
  within("--grip", options.grip, 1.0, 1e4, "N/m");
  within("--grip-damping", options.grip_damping, 0.0, 1e3, "N s/m");
  within("--load", options.load, 0.01, 5.0, "N");
  constexpr double kMostPeriods = 60.0;
  if (options.delay * options.rate > kMostPeriods) {
    throw Error(
        "--delay",
        fmt::format("{} s is {} ticks, more than {}", options.delay,
                    rounded(options.delay * options.rate), kMostPeriods),
        fmt::format("give at most {} s, or a lower --rate", rounded(kMostPeriods / options.rate)));
  }
  // At a larger angle the planes are nearly parallel to the direction in which the hand presses.
  if (options.planes) within("--planes", *options.planes, 0.1, 170.0, "degrees");
  if (options.planes && !options.scene.empty()) {
    throw Error("--planes", "it cannot be combined with a scene", "leave out --planes or SCENE");
  }
  if (options.size < 9 || options.size > 257 || options.size % 8 != 1) {
    throw Error("--size",
                fmt::format("{} is not one of 9, 17, 25, ... 257, one more than a multiple of 8",
                            options.size),
                "use 65");
  }
}

OrderedJson report(const StabilityOptions& options, const Setup& setup, const MapSetting& setting,
                   double most, const std::vector<StabilityMap>& maps) {
  OrderedJson json;
  json["of"] = setup.name;
  json["device"] = options.device.empty() ? OrderedJson() : OrderedJson(options.device);
  json["at"] = toJson(setup.contact.place);
  json["outwards"] = toJson(setup.contact.outwards);
  json["rate"] = options.rate;
  json["arm"] = {{"mass", options.mass},
                 {"viscous", options.viscous},
                 {"coulomb", options.coulomb},
                 {"encoder", options.encoder},
                 {"delay", options.delay}};
  json["hand"] = {
      {"stiffness", options.grip}, {"damping", options.grip_damping}, {"load", options.load}};
  json["boundaries"] = OrderedJson::array();
  for (int i = 0; i <= 40; ++i) {
    const double b = i == 0 ? 0.0 : kMostDamping * std::pow(1e-3, 1.0 - i / 40.0);
    json["boundaries"].push_back(
        {{"damping", b},
         {"stable", finite(stableStiffness(setting.arm, setting.grip, options.rate, b))},
         {"passive", passiveStiffness(setting.arm, options.rate, b)}});
  }
  json["most_stiffness"] = most;
  json["methods"] = OrderedJson::array();
  for (const StabilityMap& map : maps) {
    OrderedJson one;
    one["name"] = map.method;
    one["tried"] = map.tried;
    one["stiffness"] = map.stiffness;
    one["damping"] = map.damping;
    // r: rests, c: oscillates, l: diverges. A capital letter: the coupling generated energy.
    one["rows"] = OrderedJson::array();
    const std::size_t n = map.stiffness.size();
    long rests = 0;
    for (std::size_t row = 0; row < n; ++row) {
      std::string word;
      for (std::size_t column = 0; column < n; ++column) {
        const MapCell& cell = map.cells[row * n + column];
        const std::size_t letter = static_cast<std::size_t>(cell.outcome);
        word += (cell.active ? "RCL" : "rcl")[letter];
        rests += static_cast<long>(cell.outcome == MapOutcome::kRests);
      }
      one["rows"].push_back(word);
    }
    one["rests"] = static_cast<double>(rests) / static_cast<double>(n * n);
    // Finds the highest stiffness up to which all cells without damping come to rest.
    std::size_t first = 0;
    while (first < n && map.cells[first].outcome == MapOutcome::kRests) ++first;
    one["rests_to"] = first == 0 ? OrderedJson() : OrderedJson(map.stiffness[first - 1]);
    json["methods"].push_back(one);
  }
  return json;
}

/// Output files of --map. stability_picture.py draws all formats except JSON.
struct MapFiles {
  std::vector<std::string> names;
  std::vector<std::unique_ptr<WholeFile>> files;
  std::optional<Script> script;
};

MapFiles openMapFiles(const std::string& map) {
  MapFiles out;
  if (map.empty()) return out;
  const std::filesystem::path path(map);
  std::vector<std::string> endings{".json", ".png", ".svg"};
  const bool one = std::find(endings.begin(), endings.end(), path.extension()) != endings.end();
  if (one) endings = {path.extension()};
  for (const std::string& ending : endings) {
    out.names.push_back(one ? path.string() : path.string() + ending);
    out.files.push_back(std::make_unique<WholeFile>(out.names.back()));
    if (ending != ".json" && !out.script) out.script.emplace("stability_picture.py", "--map");
  }
  return out;
}

void writeMapFiles(const MapFiles& out, const OrderedJson& json) {
  for (std::size_t i = 0; i < out.files.size(); ++i) {
    const std::filesystem::path path(out.names[i]);
    if (path.extension() == ".json") {
      out.files[i]->write(dump(json, 1) + "\n");
    } else {
      out.script->draw(json, *out.files[i], out.names[i], {path.extension().string().substr(1)});
    }
  }
  for (const auto& file : out.files) file->commit();
}

MapSetting settingOf(const StabilityOptions& options) {
  MapSetting setting;
  setting.arm.mass = options.mass;
  setting.arm.viscous = options.viscous;
  setting.arm.coulomb = options.coulomb;
  setting.arm.encoder = options.encoder;
  setting.arm.delay = options.delay;
  setting.grip = {options.grip, options.grip_damping};
  setting.rate = options.rate;
  setting.load = options.load;
  return setting;
}

std::vector<StabilityMap> drawMaps(const Setup& setup, const MapSetting& setting, int size,
                                   double most) {
  std::vector<StabilityMap> maps;
  const auto progress = showProgress("mapping");
  for (const MapMethod& method : setup.methods) {
    maps.push_back(
        drawMap(setting, setup.contact, method, size, kLeastStiffness, most, kMostDamping));
    if (progress) {
      progress(static_cast<double>(maps.size()) / static_cast<double>(setup.methods.size()));
    }
  }
  return maps;
}

void sayMaps(const StabilityOptions& options, const Setup& setup, const MapSetting& setting,
             const OrderedJson& methods) {
  const double stable = stableStiffness(setting.arm, setting.grip, options.rate);
  say("{}{} at {} Hz; arm {} kg, viscous friction {} N s/m, Coulomb friction {} N, encoder step {} "
      "um, delay {} ms; hand {} N/m, {} N s/m, pressing with {} N\n",
      setup.name, options.device.empty() ? "" : ", " + options.device, rounded(options.rate),
      rounded(options.mass), rounded(options.viscous), rounded(options.coulomb),
      rounded(1e6 * options.encoder), rounded(1e3 * options.delay), rounded(options.grip),
      rounded(options.grip_damping), rounded(options.load));
  if (!options.scene.empty()) {
    const Vec3& p = setup.contact.place;
    const Vec3& n = setup.contact.outwards;
    say("pressed at ({}, {}, {}) m; the force points along ({}, {}, {})\n", rounded(p.x()),
        rounded(p.y()), rounded(p.z()), rounded(n.x()), rounded(n.y()), rounded(n.z()));
  }
  say("one wall, by formulas: passive with any hand up to {} N/m, stable with this hand up to {}\n",
      rounded(passiveStiffness(setting.arm, options.rate)),
      std::isfinite(stable) ? rounded(stable) + " N/m" : "any stiffness");
  for (const auto& method : methods) {
    say("{:22} rests {}, and in {} % of the map ({} cells simulated)\n",
        method["name"].get<std::string>(),
        method["rests_to"].is_null()
            ? "at no stiffness without damping"
            : "up to " + rounded(method["rests_to"].get<double>()) + " N/m without damping",
        rounded(100.0 * method["rests"].get<double>()), method["tried"].get<long>());
  }
}

int draw(const StabilityOptions& options) {
  check(options);
  const MapFiles out = openMapFiles(options.map);
  const Setup setup = setupOf(options, out.names);
  const MapSetting setting = settingOf(options);
  const double stable = stableStiffness(setting.arm, setting.grip, options.rate);
  constexpr double kMost = 1e5;  // [N/m]: upper bound of the largest stiffness in a map
  const double most = std::min(kMost, 6.0 * std::max(stable, 10.0 * kLeastStiffness));
  const std::vector<StabilityMap> maps = drawMaps(setup, setting, options.size, most);
  const OrderedJson json = report(options, setup, setting, most, maps);
  writeMapFiles(out, json);
  if (options.json) {
    sayJson(json, 1);
  } else {
    sayMaps(options, setup, setting, json["methods"]);
  }
  return kDone;
}

}  // namespace

void addStability(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "stability",
      "Maps the stiffness and damping at which a coupling rests, oscillates or diverges");
  auto o = std::make_shared<StabilityOptions>();
  verb->add_option("SCENE", o->scene, "A scene to press on (default: a wall)");
  verb->add_option("--planes", o->planes,
                   "Two planes instead of a wall, with this angle between them [degrees]");
  verb->add_option("--device", o->device,
                   "hid:PROFILE: uses rate and encoder step of the profile, and mass, friction and "
                   "delay that `palpate devices --test` has measured");
  verb->add_option("--map", o->map,
                   "NAME: writes the map to NAME.json, NAME.png and NAME.svg; if NAME has one of "
                   "these endings, to this file only");
  verb->add_option("--rate", o->rate, "Ticks a second (default 1000)");
  verb->add_option("--mass", o->mass, "Mass of the arm [kg] (default 0.1)");
  verb->add_option("--viscous", o->viscous, "Viscous friction of the arm [N s/m] (default 0.5)");
  verb->add_option("--coulomb", o->coulomb, "Coulomb friction of the arm [N] (default 0.02)");
  verb->add_option("--encoder", o->encoder, "Encoder step of the arm [m] (default 1e-5)");
  verb->add_option("--delay", o->delay, "Delay from a reading to its force [s] (default 0.001)");
  verb->add_option("--grip", o->grip, "Stiffness of the hand [N/m] (default 300)");
  verb->add_option("--grip-damping", o->grip_damping, "Damping of the hand [N s/m] (default 5)");
  verb->add_option("--load", o->load, "Force with which the hand presses [N] (default 1)");
  verb->add_option(
      "--size", o->size,
      "Cells of the map along each axis: 9 to 257, one more than a multiple of 8 (default 65)");
  verb->add_flag("--json", o->json, "Print JSON");
  verb->footer("Example:\n  palpate stability --planes 20 --map planes");
  verb->callback([=, &body] {
    body = [=] {
      StabilityOptions options = *o;
      if (!options.device.empty()) takeDevice(options, *verb);
      return draw(options);
    };
  });
}

}  // namespace palpate::cli
