/// Tests the requests that a window sends to a running program, and their effect on the scene.
#include "palpate/scenes/apps/common/asked.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "palpate/scenes/apps/cli/dials.h"
#include "palpate/scenes/apps/cli/watcher.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/formula_fields.h"
#include "tests/support/scenes.h"
#include "tests/support/vdb_files.h"

namespace palpate::asked_test {
using cli::dial;
using cli::idsOf;
using cli::inOrder;
using cli::ModeIds;
using Factors = std::vector<TransferSpec::Factor>;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

/// Returns a scene with a ball of radius 4 cm, a vortex, and a scalar that has data only for x > 0.
SceneSpec fields() {
  SceneSpec spec;
  FieldFrame frame;
  frame.voxel = 1e-3;
  frame.bounds = {Vec3::Constant(-0.06), Vec3::Constant(0.06)};
  spec.volumes["ball"].field = makeSphere(Vec3::Zero(), 0.04);
  spec.volumes["flow"].field = makeVortex(Vec3::Zero(), {0.0, 0.0, 2.0}, 0.1, 0.06);
  spec.volumes["half"].field = makeScalarField(frame, [](const Vec3& p) noexcept {
    return ScalarSample{1.0 + 10.0 * p.x(), {10.0, 0.0, 0.0}, p.x() > 0.0};
  });
  return spec;
}

/// Returns the forces on a hand that moves through all fields [N].
std::vector<Vec3> felt(const Scene& scene) {
  Reader reader;
  ProxyState state;
  std::vector<Vec3> forces;
  for (int i = 0; i < 600; ++i) {
    const double x = 0.05 - 2e-4 * i;
    const Vec3 probe(x, 0.01 + 0.003 * std::sin(0.05 * i), 0.042 - 1e-4 * (i % 200));
    forces.push_back(hapticStep(scene, reader, {probe}, state, 1e-3).force);
  }
  return forces;
}

double most(const std::vector<Vec3>& forces) {
  double most = 0.0;
  for (const Vec3& force : forces) most = std::max(most, force.norm());
  return most;
}

SceneSpec named(const std::vector<std::string>& names) {
  SceneSpec spec;
  for (const std::string& name : names) {
    ModeSpec mode;
    mode.of = "ball";
    mode.name = name;
    // In this test, a name that begins with a slash stands for an unnamed mode of a volume of that
    // name.
    if (!name.empty() && name[0] == '/') {
      mode.of = name;
      mode.name.clear();
    }
    spec.graph.modes.push_back(mode);
  }
  return spec;
}

/// Captures standard error during the object's lifetime.
class Said {
 public:
  Said() {
    std::fflush(stderr);
    dup2(fileno(file_), STDERR_FILENO);
  }
  ~Said() {
    std::fflush(stderr);
    dup2(before_, STDERR_FILENO);
    close(before_);
    std::fclose(file_);
  }
  Said(const Said&) = delete;
  Said& operator=(const Said&) = delete;
  [[nodiscard]] std::string all() const {
    std::fflush(stderr);
    std::string all(65536, '\0');
    all.resize(static_cast<std::size_t>(
        std::max<ssize_t>(0, pread(fileno(file_), all.data(), all.size(), 0))));
    return all;
  }
  [[nodiscard]] int times(const std::string& words) const {
    const std::string all = this->all();
    int count = 0;
    for (auto at = all.find(words); at != std::string::npos; at = all.find(words, at + 1)) ++count;
    return count;
  }

 private:
  std::FILE* file_ = std::tmpfile();
  int before_ = dup(STDERR_FILENO);
};

}  // namespace

TEST_CASE("a gain on a mode gives the same forces as a scene with its strength scaled",
          "[dial][release]") {
  struct Kind {
    ModeKind kind;
    std::string of;
  };
  const auto kind =
      GENERATE(Kind{ModeKind::kForce, "ball"}, Kind{ModeKind::kForce, "flow"},
               Kind{ModeKind::kViscosity, "ball"}, Kind{ModeKind::kSurface, "ball"},
               Kind{ModeKind::kIsosurface, "ball"}, Kind{ModeKind::kFollow, "flow"},
               Kind{ModeKind::kTransverseDamping, "flow"}, Kind{ModeKind::kFrontShape, "flow"},
               Kind{ModeKind::kVortexTube, "flow"}, Kind{ModeKind::kGuide, ""});
  const bool by = GENERATE(false, true);
  const std::string form = GENERATE("number", "curve", "product");
  const float factor = GENERATE(0.0F, 0.5F, 1.25F, 8.0F);
  CAPTURE(wordFor(kind.kind), kind.of, by, form, factor);

  const bool skin = kind.kind == ModeKind::kSurface || kind.kind == ModeKind::kIsosurface;
  const SceneSpec base = fields();
  const auto scene = [&](double times) {
    const auto property = [&](double newtons) {
      const TransferSpec number = newtons;
      const auto curve = TransferFunction::piecewise({{-0.03, 0.5 * newtons}, {1.5, newtons}});
      if (form == "number") return number;
      if (form == "curve") return TransferSpec(curve);
      return TransferSpec(Factors{{curve, "half"}, {0.5, ""}});
    };
    SceneSpec spec = base;
    ModeSpec mode;
    mode.kind = kind.kind;
    mode.of = kind.of;
    mode.solid = Solid::kBelow;
    mode.strength = property(times * 0.8);
    if (skin) mode.viscosity = property(times * 0.2);
    // The friction reads the mode's `by`, so that every form of the strength is tested with `by`.
    if (skin) mode.friction = TransferFunction::piecewise({{0.0, 0.1}, {2.0, 0.2}});
    const bool reads = form == "curve" || form == "number" || skin;
    if (by && reads) mode.by = "half";
    spec.graph.modes = {mode};
    return spec;
  };
  SceneSpec turned = scene(1.0);
  dial(turned, {{0, factor}});
  const BuiltScene dialled = buildScene(turned);
  const double times = std::max<double>(factor, 1e-9);
  const std::vector<Vec3> is = felt(*dialled.scene);
  const std::vector<Vec3> should = felt(*buildScene(scene(times)).scene);
  for (std::size_t i = 0; i < is.size(); ++i) {
    CAPTURE(i, is[i], should[i]);
    REQUIRE((is[i] - should[i]).norm() <= 1e-12 * (1.0 + should[i].norm()));
  }
  if (factor == 0.0F) CHECK(most(is) < 1e-6);
  if (factor == 8.0F) CHECK(most(is) > 0.05);
  // A changed gain keeps the scene's shape, so the loop does not restart the engagement.
  CHECK(dialled.scene->shape == buildScene(scene(1.0)).scene->shape);
}

TEST_CASE("a mode keeps its id if its scene file is edited", "[dial]") {
  const SceneSpec first = named({"skin", "/a", "bone"});
  const ModeIds ids = idsOf(first);
  CHECK(ids.of == std::vector<std::uint32_t>{0, 1, 2});

  SECTION("a mode keeps the id of its name and an unnamed mode that of its volume") {
    const ModeIds now = idsOf(named({"new", "bone", "/b", "/a", "skin"}), first, ids);
    CHECK((now.of[1] == 2 && now.of[3] == 1 && now.of[4] == 0));
    CHECK((now.of[0] >= 3 && now.of[2] >= 3 && now.of[0] != now.of[2]));
    CHECK(now.next == 5);
  }
  SECTION("two long names with the same beginning get different ids") {
    const std::string same(60, 'n');
    const SceneSpec two = named({same + "1", same + "2"});
    CHECK(idsOf(named({same + "2", same + "1"}), two, idsOf(two)).of ==
          std::vector<std::uint32_t>{1, 0});
  }
  SECTION("modes with the same name keep their ids while their number is unchanged") {
    const SceneSpec three = named({"skin", "skin", "/a", "/a"});
    const ModeIds known = idsOf(three);
    CHECK(idsOf(named({"/a", "skin", "/a", "skin"}), three, known).of ==
          std::vector<std::uint32_t>{2, 0, 3, 1});
    const ModeIds fewer = idsOf(named({"skin", "/a", "/a", "/a"}), three, known);
    CHECK(*std::min_element(fewer.of.begin(), fewer.of.end()) == 4);
  }
  SECTION("the id of a removed mode is not used again") {
    const SceneSpec without = named({"/a"});
    const ModeIds gone = idsOf(without, first, ids);
    CHECK(gone.of == std::vector<std::uint32_t>{1});
    CHECK(idsOf(named({"skin", "/a"}), without, gone).of == std::vector<std::uint32_t>{3, 1});
  }
  const auto all = inOrder({{2, 0.5F}, {7, 0.0F}}, ids);
  REQUIRE(all.size() == 3);
  CHECK((all[0].factor == 1.0F && all[1].factor == 1.0F && all[2].factor == 0.5F));
  CHECK(all[2].mode == 2);
}

TEST_CASE("requests in the shared memory are limited to valid values", "[asked]") {
  LiveWishes before;
  LiveWishes now;
  CHECK(cli::asked(before, now).dialled == 0);
  now.dialled = 7;
  now.dial_count = 6;
  now.dials[0] = {10, static_cast<float>(kNan)};
  now.dials[1] = {11, static_cast<float>(kInf)};
  now.dials[2] = {12, static_cast<float>(-kInf)};
  now.dials[3] = {13, -1.0F};
  now.dials[4] = {14, 1e9F};
  now.dials[5] = {15, 0.5F};
  cli::Asked asked = cli::asked(before, now);
  CHECK(asked.dialled == 7);
  // Gains that are not finite are ignored.
  REQUIRE(asked.dials.size() == 3);
  CHECK((asked.dials[0].mode == 13 && asked.dials[0].factor == 0.0F));
  CHECK((asked.dials[1].mode == 14 && asked.dials[1].factor == kMostDial));
  CHECK((asked.dials[2].mode == 15 && asked.dials[2].factor == 0.5F));
  now.dial_count = 4000000000U;
  CHECK(cli::asked(before, now).dials.size() == kLiveModes - 3);
  CHECK(cli::asked(now, now).dialled == 0);

  // If a cut and a clear arrive together, the cut wins.
  before = now;
  ++now.cuts;
  ++now.clears;
  asked = cli::asked(before, now);
  CHECK((asked.cut && !asked.clear && !asked.closed));
  before = now;
  ++now.clears;
  asked = cli::asked(before, now);
  CHECK((!asked.cut && asked.clear));
  now.closed = 1;
  CHECK(cli::asked(now, now).closed);
}

TEST_CASE("the simulated hand follows its mouse with a time constant of 20 ms", "[asked]") {
  Published<LiveHand> mouse;
  const Vec3 start(0.1, 0.0, 0.0);
  const HandTarget hand = cli::behindMouse(mouse, start);
  const auto to = [&](double x, double y = 0.0, double z = 0.0) { mouse.write({{x, y, z}}); };
  CHECK(hand.at(0.0) == start);
  CHECK(hand.at(20.0) == start);
  SECTION("after 20 s without a move, a move of the mouse counts as one tick") {
    to(0.11);
    const double share = 1.0 - std::exp(-1e-3 / 0.02);
    CHECK(hand.at(20.001).x() == Approx(0.1 + share * 0.01).epsilon(1e-12));
    // A request for the same or an earlier time must not move the target.
    CHECK(hand.at(20.001).x() == Approx(0.1 + share * 0.01).epsilon(1e-12));
    Vec3 at = start;
    for (int i = 2; i <= 20; ++i) at = hand.at(20.0 + 1e-3 * i);
    CHECK(at.x() == Approx(0.11 - 0.01 * std::exp(-1.0)).epsilon(1e-9));
  }
  SECTION("after a jump of the mouse the hand moves at up to 2 m/s") {
    to(0.1, 0.5, 0.0);
    Vec3 last = start;
    double fastest = 0.0;
    for (int i = 1; i <= 500; ++i) {
      const Vec3 now = hand.at(20.0 + 1e-3 * i);
      fastest = std::max(fastest, 1e3 * (now - last).norm());
      last = now;
    }
    CHECK(fastest == Approx(2.0).epsilon(1e-9));
    CHECK(last.y() == Approx(0.5).epsilon(1e-6));
  }
  SECTION("an invalid position is ignored, and positions are limited to 10 m") {
    for (const double bad : {kNan, kInf, -kInf}) {
      to(0.0, bad, 0.0);
      CHECK(hand.at(30.0) == start);
    }
    to(1e300, -1e300, 0.2);
    CHECK((hand.at(100.0) - Vec3(10.0, -10.0, 0.2)).norm() < 1e-6);
    to(-11.0, 11.0, 0.2);
    CHECK((hand.at(200.0) - Vec3(-10.0, 10.0, 0.2)).norm() < 1e-6);
  }
}

TEST_CASE("the simulated arm follows its mouse with the expected lag and within the speed limit",
          "[asked]") {
  Published<LiveHand> mouse;
  ArmParams arm;
  arm.coulomb = 0.0;
  arm.encoder = 0.0;
  const GripParams grip;
  SimulatedDevice device(arm, grip, cli::behindMouse(mouse, Vec3::Zero()), 1000.0);
  SECTION(
      "the arm follows a steadily moving mouse with the lag of the filter and of its friction") {
    constexpr double kSpeed = 0.1;  // [m/s]
    for (int i = 0; i <= 2000; ++i) {
      mouse.write({{kSpeed * 1e-3 * i, 0.0, 0.0}});
      device.write(Vec3::Zero());
    }
    CHECK(device.velocity().x() == Approx(kSpeed).epsilon(1e-3));
    // The target is constant within a tick. So in the middle of a tick, the arm is where a target
    // that moves continuously would lead it.
    const double behind = 1e-3 / std::expm1(1e-3 / 0.02) + arm.viscous / grip.stiffness;
    const double should = kSpeed * (2.0005 - behind);
    CHECK(device.position().x() == Approx(should).margin(2e-6));
  }
  SECTION("after a jump of the mouse the arm reaches the mouse below the speed limit") {
    mouse.write({{0.5, 0.0, 0.0}});
    double fastest = 0.0;
    for (int i = 0; i <= 1000; ++i) {
      device.write(Vec3::Zero());
      fastest = std::max(fastest, device.velocity().norm());
    }
    CHECK(fastest < WatchLimits{}.max_speed);
    CHECK(device.position().x() == Approx(0.5).margin(1e-4));
  }
}

TEST_CASE("gains stay with their modes if the scene file is edited", "[dial]") {
  const test::TemporaryFolder folder;
  test::writeTestVolumes(folder.path());
  const std::string file = (folder / "scene.json").string();
  int edits = 0;
  const auto write = [&](const std::string& modes) {
    std::ofstream(file)
        << R"({"palpate": 1, "volumes": {"ball": {"file": "ball.vdb", "grid": "ball",
      "place": {"scale": 0.02}}}, "modes": [)" +
               modes + "]}";
    // The time stamps must differ even if the file system's clock is coarse.
    std::filesystem::last_write_time(
        file, std::filesystem::file_time_type::clock::now() + std::chrono::seconds(++edits));
  };
  const std::string skin = R"({"name": "skin", "mode": "isosurface", "of": "ball", "value": 0,
      "solid": "below", "strength": 3})";
  const std::string pin = R"({"mode": "guide", "shape": "point", "at": [0, 0, 0.2], "snap": 0.01,
      "strength": 9e5})";
  write(skin + "," + pin);

  const Said said;
  test::TestDevice device;
  device.about.max_stiffness = 300.0;
  const std::vector<const Device*> devices{&device};
  SceneSpec spec = openScene(file);
  REQUIRE(cli::fitToAll(spec, devices));
  SceneCache cache;
  cli::Watcher watcher(spec, file, cli::writtenAt(file), true, devices, cache);
  /// Waits for a new scene, for a minute. Returns nullopt if none comes or a request is refused.
  const auto look = [&]() -> std::optional<BuiltScene> {
    const std::uint64_t refused = watcher.refused();
    for (int i = 0; i < 60000; ++i) {
      if (auto built = watcher.look()) return built;
      if (watcher.refused() != refused) return std::nullopt;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return std::nullopt;
  };
  const auto factors = [&] {
    std::vector<float> all;
    for (const LiveDial& dial : watcher.dials()) all.push_back(dial.factor);
    return all;
  };
  const auto strength = [](const BuiltScene& built, std::size_t mode) {
    return std::get<IsosurfaceMode>(built.scene->graph.modes[mode]).strength.factors[0].curve(0.0);
  };
  CHECK_FALSE(watcher.look());

  // A mode that is switched off has almost zero strength. The watcher does not repeat earlier
  // messages.
  watcher.turn({{0, 0.0F}, {1, 1.0F}}, 1);
  auto built = look();
  INFO(said.all());
  REQUIRE(built);
  CHECK(strength(*built, 0) == 3.0 * 1e-9);
  CHECK(factors() == std::vector<float>{0.0F, 1.0F});
  CHECK(said.times("the coupling is 300 N/m") == 1);

  // The edit moves the mode within the file. The mode must stay switched off.
  const std::string core = R"({"name": "core", "mode": "isosurface", "of": "ball", "value": -0.5,
      "solid": "below", "strength": 2})";
  write(core + "," + pin + "," + skin);
  built = look();
  REQUIRE(built);
  CHECK(factors() == std::vector<float>{1.0F, 1.0F, 0.0F});
  CHECK(watcher.dials()[2].mode == 0);
  CHECK(watcher.dials()[1].mode == 1);
  CHECK(strength(*built, 0) == 2.0);
  CHECK(strength(*built, 2) == 3.0 * 1e-9);
  CHECK(built->scene->coupling.stiffness == 300.0);
  CHECK(said.times("the coupling is 300 N/m") == 2);

  // A key that was pressed before the edit was noticed still applies to the skin. A request for an
  // unknown mode is ignored.
  watcher.turn({{0, 0.5F}, {1, 1.0F}, {77, 0.0F}}, 2);
  built = look();
  REQUIRE(built);
  CHECK(strength(*built, 2) == 1.5);
  CHECK(factors() == std::vector<float>{1.0F, 1.0F, 0.5F});
  CHECK(said.times("the coupling is 300 N/m") == 2);

  // A scene that cannot be built is refused and reported once, and the gains stay.
  watcher.turn({{0, 0.5F}, {1, 8.0F}}, 3);
  CHECK_FALSE(look());
  CHECK(watcher.refused() == 3);
  CHECK(factors() == std::vector<float>{1.0F, 1.0F, 0.5F});
  for (int i = 0; i < 20; ++i) CHECK_FALSE(watcher.look());
  CHECK(said.times("the previous scene stays active") == 1);

  // While the file is invalid, gains can still be changed.
  write("nothing");
  watcher.turn({{0, 1.25F}, {1, 1.0F}}, 4);
  built = look();
  REQUIRE(built);
  CHECK(strength(*built, 2) == 3.75);
  CHECK(said.times("the previous scene stays active") == 2);
  CHECK(watcher.refused() == 3);
}

}  // namespace palpate::asked_test
