/// Tests a scene that several sites edit.
#include "palpate/scenes/network/sites/shared_scene.h"

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/watcher.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/scene_file.h"
#include "palpate/scenes/network/sites/site.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"
#include "tests/support/vdb_files.h"

namespace palpate::shared_scene_test {
using Catch::Contains;
using test::Random;

namespace {

/// Returns an edit of the strength of mode `name`, with stamp (`count`, `site`).
SharedEdits edit(const std::string& name, const Json& value, std::uint64_t count,
                 const std::string& site) {
  return {{{"modes", name, "0"}, {{{"name", name}, {"strength", value}}, {count, site}}}};
}

std::uint64_t largest(const SharedEdits& edits) {
  std::uint64_t count = 0;
  for (const auto& [key, one] : edits) count = std::max(count, one.stamp.count);
  return count;
}

/// Returns a scene with a wall and unnamed modes. Its paths on the disk must not be sent.
Json scene() {
  return parseJson(R"({
    "$schema": "/home/secret/schema.json", "palpate": 1, "description": "/home/secret/notes",
    "coupling": {"stiffness": 400, "description": "secret"}, "accuracy": {"max_substeps": 8},
    "play": {"speed": 2, "description": "secret"},
    "volumes": {
      "ball": {"file": "/home/secret/ball.vdb", "grid": "secret", "place": {"fit": 0.1}},
      "beat": {"file": "secret_%04d.vdb", "frames": {"rate": 5}, "description": "secret"},
      "head": {"file": "http://secret/head", "window": {"budget_mb": 7}}},
    "fields": {"slope": {"gradient": "ball", "description": "secret"}},
    "modes": [
      {"name": "wall", "mode": "isosurface", "of": "ball", "value": 0, "strength": 2,
       "description": "/home/secret"},
      {"mode": "follow", "of": "slope", "strength": 1},
      {"mode": "follow", "of": "slope", "strength": 2}]})",
                   "scene", raiseAs<Error>);
}

std::string withStrength(Json of, double strength) {
  of["modes"][0]["strength"] = strength;
  return of.dump();
}

/// Returns the message of a site with one edit, which sets the wall's strength to `is`.
std::string saying(const std::string& is, const std::string& of = R"(["modes", "wall", "0"])",
                   const std::string& at = R"([1, "boston"])") {
  return R"({"palpate_edits": 1, "rest": [], "edits": [{"of": )" + of + R"(, "at": )" + at +
         R"(, "is": )" + is + "}]}";
}

}  // namespace

TEST_CASE("sites have the same edits in the end despite lost, late and repeated messages",
          "[site]") {
  const long histories = test::cases(10000);
  for (long seed = 0; seed < histories; ++seed) {
    Random random(static_cast<std::uint64_t>(seed));
    CAPTURE(seed);
    const auto count = static_cast<std::size_t>(2 + random.integer(4));
    std::vector<SharedEdits> sites(count);
    SharedEdits ever;  // the largest edit of each part so far, found without merge()
    std::vector<std::pair<std::size_t, SharedEdits>> flying;
    const auto parted = static_cast<std::size_t>(random.integer(static_cast<int>(count) + 1));
    const bool forgets = random.integer(4) == 0;
    bool forgot = false;
    for (int step = 0; step < 40; ++step) {
      const auto at = static_cast<std::size_t>(random.integer(static_cast<int>(count)));
      const int what = random.integer(4);
      if (what == 0) {
        // Some sites forget all edits and use a stamp twice.
        if (forgets && random.integer(20) == 0) {
          sites[at].clear();
          forgot = true;
        }
        const std::string name(1, static_cast<char>('a' + random.integer(3)));
        // Includes equal numbers that are written differently.
        const int whole = random.integer(3);
        const Json value = random.integer(2) == 0 ? Json(whole) : Json(0.5 * whole);
        SharedEdits made = edit(name, value, largest(sites[at]) + 1, "site" + std::to_string(at));
        if (random.integer(4) == 0) made.begin()->second.value = nullptr;
        const auto& [key, one] = *made.begin();
        const auto known = ever.find(key);
        const auto order = [](const SharedEdit& e) {
          return std::tuple(e.stamp.count, e.stamp.site, e.value.dump());
        };
        if (known == ever.end() || order(known->second) < order(one)) ever[key] = one;
        merge(sites[at], made);
      } else if (what == 1) {
        const auto to = static_cast<std::size_t>(random.integer(static_cast<int>(count)));
        // For a time, two groups of sites are disconnected.
        const bool apart = step > 10 && step < 30 && (at < parted) != (to < parted);
        if (!apart) flying.emplace_back(to, sites[at]);
      } else if (!flying.empty()) {
        const auto n = static_cast<std::size_t>(random.integer(static_cast<int>(flying.size())));
        merge(sites[flying[n].first], flying[n].second);
        if (what == 2) flying.erase(flying.begin() + static_cast<std::ptrdiff_t>(n));
      }
    }
    // Late messages arrive. Then all sites exchange their edits.
    for (const auto& [to, edits] : flying) merge(sites[to], edits);
    for (const SharedEdits& one : sites) merge(sites[0], one);
    for (SharedEdits& one : sites) merge(one, sites[0]);
    for (const SharedEdits& one : sites) REQUIRE(textOf({one, {}}) == textOf({sites[0], {}}));
    // If a site forgot an edit before any other site received it, the edit is lost.
    if (!forgot) REQUIRE(sites[0] == ever);
    const SharedEdits before = sites[0];
    CHECK_FALSE(merge(sites[0], before));
  }
}

TEST_CASE(
    "for each part of a shared scene the edit with the larger number wins, then the later site "
    "name",
    "[site]") {
  SharedEdits edits;
  CHECK(merge(edits, edit("wall", 1, 5, "boston")));
  CHECK_FALSE(merge(edits, edit("wall", 2, 4, "uppsala")));
  CHECK(edits == edit("wall", 1, 5, "boston"));
  CHECK_FALSE(merge(edits, edit("wall", 2, 5, "atlanta")));
  CHECK(merge(edits, edit("wall", 2, 5, "uppsala")));
  // After a restart, a site uses the same stamp for a different edit.
  CHECK(merge(edits, edit("wall", 3, 5, "uppsala")));
  CHECK_FALSE(merge(edits, edit("wall", 2, 5, "uppsala")));
  CHECK(merge(edits, edit("floor", 1, 1, "boston")));
  CHECK(edits.size() == 2);
}

TEST_CASE("local files and device settings of a site are never sent to other sites", "[site]") {
  SharedScene site("boston", scene().dump());
  const std::optional<std::string> first = site.takeTold();
  REQUIRE(first);
  CHECK_THAT(*first, !Contains("secret"));
  CHECK_FALSE(site.takeTold());

  Json edited = scene();
  edited["description"] = "more secret";
  edited["coupling"]["stiffness"] = 300;
  edited["accuracy"]["max_substeps"] = 16;
  edited["volumes"]["ball"]["file"] = "/home/secret/other.vdb";
  edited["volumes"]["head"]["window"]["budget_mb"] = 9;
  edited["modes"][0]["description"] = "more secret";
  site.edit(edited.dump());
  CHECK(site.edits().empty());

  edited["volumes"]["ball"]["place"]["fit"] = 0.2;
  edited["volumes"]["new"] = {{"file", "/home/secret/new.vdb"}, {"grid", "secret"}};
  edited["fields"].erase("slope");
  edited["modes"].erase(2);
  edited["modes"].erase(1);
  edited["modes"][0]["strength"] = 3;
  edited["play"]["speed"] = 1;
  site.edit(edited.dump());
  const std::optional<std::string> told = site.takeTold();
  REQUIRE(told);
  CHECK_THAT(*told, !Contains("secret") && !Contains("file") && !Contains("stiffness"));
  std::vector<std::string> parts;
  for (const auto& [key, one] : site.edits()) {
    CHECK(one.stamp == SharedStamp{1, "boston"});
    parts.push_back(wordsFor({key}) + (one.value.is_null() ? " removed" : ""));
  }
  CHECK(parts == std::vector<std::string>{"field \"slope\" removed", "follow of \"slope\" removed",
                                          "follow of \"slope\" removed", "mode \"wall\"", "play",
                                          "volume \"ball\"", "volume \"new\""});

  // The receiving site keeps its own file names and settings.
  SharedScene other("uppsala", scene().dump());
  CHECK(other.hear("boston", *told).empty());
  SharedEdits all = other.edits();
  CHECK_THROWS_WITH(other.textWith(all),
                    Contains("volume \"new\": the scene of this site does not have it"));
  all.erase({"volumes", "new"});
  const Json felt = Json::parse(other.textWith(all));
  Json wanted = scene();
  wanted["volumes"]["ball"]["place"]["fit"] = 0.2;
  wanted.erase("fields");
  wanted["modes"].erase(2);
  wanted["modes"].erase(1);
  wanted["modes"][0]["strength"] = 3;
  wanted["modes"][0].erase("description");
  wanted["play"]["speed"] = 1;
  CHECK(felt["volumes"] == wanted["volumes"]);
  CHECK(felt["modes"] == wanted["modes"]);
  CHECK(felt["play"] == wanted["play"]);
  CHECK(felt["coupling"] == wanted["coupling"]);
  CHECK(felt["accuracy"] == wanted["accuracy"]);
  CHECK((!felt.contains("fields") || felt["fields"].empty()));
}

TEST_CASE("malformed edits from another site are rejected", "[site]") {
  const std::string wall = R"({"name": "wall", "mode": "isosurface", "strength": 1})";
  REQUIRE(sharedTextFrom(saying(wall)).edits.size() == 1);
  REQUIRE(sharedTextFrom(saying("null")).edits.size() == 1);
  const std::string deep = std::string(30000, '[') + std::string(30000, ']');
  const std::string volume = R"(["volumes", "ball"])";
  const std::vector<std::string> bad = {
      "",
      "[]",
      "{}",
      "null",
      "{\"palpate_edits\": 1}",
      "\xff\xfe",
      deep,
      saying(deep),
      std::string(kMostSceneText + 1, ' '),
      saying("1"),
      saying("[]"),
      saying("\"wall\""),
      saying(R"({"name": "wall", "strength": 1e999})"),
      saying(R"({"name": "wall", "strength": NaN})"),
      saying(R"({"name": "wall", "name": "wall"})"),
      saying(R"({"name": "floor"})"),
      saying(R"({"mode": "follow"})"),
      saying(R"({"name": "wall", "of": ")" + std::string(300, 'x') + "\"}"),
      saying(R"({"name": "wall", "of": "a\nb"})"),
      saying(R"({"name": "wall", "description": "/home"})"),
      saying(wall, R"(["coupling"])"),
      saying(wall, R"(["modes", "wall"])"),
      saying(wall, R"(["modes", 1, "0"])"),
      saying(wall, "[]"),
      saying(wall, R"(["volumes", ""])"),
      saying(wall, R"(["$schema", "x"])"),
      saying(R"({"file": "/etc/passwd"})", volume),
      saying(R"({"grid": "x"})", volume),
      saying(R"({"frames": {"rate": 1}})", volume),
      saying(R"({"window": {"budget_mb": 1e6}})", volume),
      saying(R"({"some_later_key": "/etc/passwd"})", volume),
      saying(wall, R"(["modes", "wall", "0"])", R"([0, "boston"])"),
      saying(wall, R"(["modes", "wall", "0"])", R"([-1, "boston"])"),
      saying(wall, R"(["modes", "wall", "0"])", R"([1.5, "boston"])"),
      saying(wall, R"(["modes", "wall", "0"])", R"([18446744073709551615, "boston"])"),
      saying(wall, R"(["modes", "wall", "0"])", R"([1, "a b"])"),
      saying(wall, R"(["modes", "wall", "0"])", R"([1])")};
  SharedScene site("uppsala", scene().dump());
  for (std::size_t i = 0; i < bad.size(); ++i) {
    CAPTURE(i, bad[i].substr(0, 200));
    CHECK_THROWS_AS(sharedTextFrom(bad[i]), Error);
    // The site reports one line for the first bad message, and ignores the edits.
    const auto lines = site.hear("boston", bad[i]);
    CHECK(lines.size() == (i == 0 ? 1U : 0U));
    CHECK(site.edits().empty());
  }

  // Any other text either throws or gives edits that can be sent again.
  const std::string good = saying(wall);
  Random random(7);
  long taken = 0;
  const long tries = test::cases(20000);
  for (long n = 0; n < tries; ++n) {
    std::string text = good;
    for (int k = random.integer(3); k >= 0; --k) {
      const auto at = static_cast<std::size_t>(random.integer(static_cast<int>(text.size())));
      if (random.integer(2) == 0) {
        text[at] = static_cast<char>(random.integer(256));
      } else {
        text.erase(at, 1);
      }
    }
    CAPTURE(n, text);
    try {
      const SharedText read = sharedTextFrom(text);
      ++taken;
      REQUIRE(sharedTextFrom(textOf(read)).edits == read.edits);
    } catch (const Error&) {
    }
  }
  CHECK(taken > 0);
}

TEST_CASE("a local edit of a site changes only the parts that differ in its file", "[site]") {
  SharedScene boston("boston", scene().dump());
  SharedScene uppsala("uppsala", scene().dump());
  (void)boston.takeTold();
  // Uppsala edits the wall's strength. Boston edits the strength of an unnamed mode, then also the
  // wall's.
  uppsala.edit(withStrength(scene(), 7));
  CHECK(boston.hear("uppsala", *uppsala.takeTold()).empty());
  CHECK(boston.takeNews());
  CHECK_FALSE(boston.takeNews());
  Json mine = scene();
  mine["modes"][1]["strength"] = 9;
  boston.edit(mine.dump());
  const auto strengths = [](const SharedScene& site) {
    std::vector<double> all;
    const Json now = Json::parse(site.textWith(site.edits()));
    for (const Json& mode : now["modes"]) {
      all.push_back(mode["strength"].get<double>());
    }
    return all;
  };
  CHECK(strengths(boston) == std::vector<double>{7, 9, 2});
  boston.edit(withStrength(mine, 4));
  CHECK(strengths(boston) == std::vector<double>{4, 9, 2});
  CHECK(uppsala.hear("boston", *boston.takeTold()).empty());
  CHECK(strengths(uppsala) == std::vector<double>{4, 9, 2});
  // A repeated message changes nothing, so the sites stop sending.
  CHECK(uppsala.takeNews());
  const std::string echo = *uppsala.takeTold();
  CHECK(boston.hear("uppsala", echo).empty());
  CHECK_FALSE(boston.takeNews());
  CHECK_FALSE(boston.takeTold());

  // A late joiner gets all edits from a site that has applied them.
  SharedScene late("late", scene().dump());
  CHECK(late.hear("uppsala", echo).empty());
  CHECK(strengths(late) == std::vector<double>{4, 9, 2});

  // A site refuses its own edit if it is too long to send.
  Json large = mine;
  large["modes"][0]["strength"] = {{"piecewise", Json::array()}};
  for (int i = 0; i < 10000; ++i) {
    large["modes"][0]["strength"]["piecewise"].push_back({i, i});
  }
  const SharedEdits before = boston.edits();
  CHECK_THROWS_WITH(boston.edit(large.dump()), Contains("have more than 65536 bytes"));
  CHECK(boston.edits() == before);
  CHECK_FALSE(boston.takeTold());
}

TEST_CASE("the total size of all sites' edits is bounded", "[site][release]") {
  SharedScene site("uppsala", scene().dump());
  int said = 0;
  for (int n = 0; n < 400; ++n) {
    const std::string name = std::to_string(n) + std::string(150, 'x');
    const std::string text = textOf({edit(name, 1.0, 1, "boston"), {}});
    said += static_cast<int>(site.hear("boston", text).size());
  }
  CHECK(said == 1);
  CHECK(site.edits().size() > 100);
  const auto told = site.takeTold();
  REQUIRE(told);
  CHECK(told->size() <= kMostSceneText);
}

TEST_CASE("a site rejects an edit whose number is far above those of the edits that it knows",
          "[site]") {
  SharedScene site("uppsala", scene().dump());
  const std::uint64_t most = std::uint64_t{1} << 20U;
  CHECK(site.hear("boston", textOf({edit("wall", 1.0, most + 1, "boston"), {}})).size() == 1);
  CHECK(site.edits().empty());
  CHECK(site.hear("boston", textOf({edit("wall", 1.0, most, "boston"), {}})).empty());
  CHECK(site.edits().size() == 1);
}

TEST_CASE("edits that arrive while a scene is built stay within the size of a message", "[site]") {
  SharedScene site("uppsala", scene().dump());
  SharedScene building = site;
  const auto many = [](SharedScene& to, const std::string& begin) {
    for (int n = 0; n < 250; ++n) {
      const std::string name = begin + std::to_string(n) + std::string(150, 'x');
      (void)to.hear("boston", textOf({edit(name, 1.0, 1, "boston"), {}}));
    }
  };
  many(site, "a");
  many(building, "b");
  site.settle(building);
  const auto told = site.takeTold();
  REQUIRE(told);
  CHECK(told->size() <= kMostSceneText);
  CHECK(site.edits() == building.edits());
}

TEST_CASE("a site with another scene is reported in one line with the difference", "[site]") {
  // A part whose name other sites would refuse is not sent. The other parts are sent.
  Json odd = scene();
  odd["fields"][std::string(300, 'x')] = {{"curl", "ball"}};
  SharedScene boston("boston", withStrength(odd, 5));
  SharedScene uppsala("uppsala", scene().dump());
  const std::string told = *boston.takeTold();
  const auto lines = uppsala.hear("boston", told);
  REQUIRE(lines.size() == 1);
  CHECK(lines[0] ==
        "site boston: its scene differs from this site's scene: mode \"wall\": copy one scene file "
        "to the other site, or edit these parts again");
  CHECK(uppsala.hear("boston", told).empty());
  SharedScene late("late", scene().dump());
  boston.edit(withStrength(odd, 6));
  CHECK(late.hear("boston", *boston.takeTold()).empty());
}

TEST_CASE("a site applies the edits that its scene supports and skips the others", "[site]") {
  const test::TemporaryFolder folder;
  test::writeTestVolumes(folder.path());
  const std::string file = (folder / "scene.json").string();
  const std::string text = R"({"palpate": 1, "volumes": {"ball": {"file": "ball.vdb",
    "grid": "ball", "place": {"scale": 0.02}}}, "modes": [{"name": "skin", "mode": "isosurface",
    "of": "ball", "value": 0, "solid": "below", "strength": 3}]})";
  std::ofstream(file) << text;
  test::TestDevice device;
  const std::vector<const Device*> devices{&device};
  SceneCache cache;
  cli::Watcher watcher(openScene(file), file, cli::writtenAt(file), true, devices, cache);
  watcher.share("uppsala", file, text);
  CHECK(watcher.takeTold());
  const auto look = [&]() -> std::optional<BuiltScene> {
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(2500);
    while (std::chrono::steady_clock::now() < end) {
      if (auto built = watcher.look()) return built;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return std::nullopt;
  };
  const auto strengths = [](const BuiltScene& built) {
    std::map<std::string, double> all;
    for (std::size_t i = 0; i < built.scene->graph.modes.size(); ++i) {
      all[built.scene->graph.mode_names[i]] =
          std::get<IsosurfaceMode>(built.scene->graph.modes[i]).strength.factors[0].curve(0.0);
    }
    return all;
  };
  const auto skin = [](const std::string& name, const std::string& of, double strength) {
    return Json{{"name", name}, {"mode", "isosurface"}, {"of", of},
                {"value", 0},   {"solid", "below"},     {"strength", strength}};
  };
  const auto one = [](const Json& value, std::uint64_t count) {
    return SharedEdits{{{"modes", value["name"], "0"}, {value, {count, "boston"}}}};
  };

  SharedEdits all = one(skin("skin", "ball", 2), 1);
  watcher.hear("boston", textOf({all, {}}));
  auto built = look();
  REQUIRE(built);
  CHECK(strengths(*built) == std::map<std::string, double>{{"skin", 2}});
  // The scene has the same shape, so the loop treats it as an edit and keeps the force on.
  const std::uint64_t shape = built->scene->shape;
  CHECK(shape == buildScene(openScene(file), {}, &cache).scene->shape);
  // text() is the scene in use, for recordings. The message has all known edits.
  CHECK(Json::parse(watcher.text())["modes"][0]["strength"] == 2);
  CHECK(watcher.takeTold());

  // One edit needs a volume that this site lacks, another has an unknown kind of mode. The edits
  // before and after them apply.
  merge(all, one(skin("bone", "skull", 1), 2));
  merge(all, one({{"name", "odd"}, {"mode", "odd"}}, 3));
  merge(all, one(skin("rind", "ball", 1), 4));
  watcher.hear("boston", textOf({all, {}}));
  built = look();
  REQUIRE(built);
  CHECK(strengths(*built) == std::map<std::string, double>{{"skin", 2}, {"rind", 1}});

  // This edit cannot be applied, so the scene stays.
  merge(all, one(skin("bone", "skull", 2), 5));
  watcher.hear("boston", textOf({all, {}}));
  CHECK_FALSE(look());

  // The user's file must not change. An edit of the file replaces a received edit.
  std::ifstream in(file);
  CHECK(std::string(std::istreambuf_iterator<char>(in), {}) == text);
  std::string edited = text;
  edited.replace(edited.find("\"strength\": 3"), 13, "\"strength\": 4");
  std::ofstream(file) << edited;
  std::filesystem::last_write_time(
      file, std::filesystem::file_time_type::clock::now() + std::chrono::seconds(2));
  built = look();
  REQUIRE(built);
  CHECK(strengths(*built) == std::map<std::string, double>{{"skin", 4}, {"rind", 1}});
  const auto told = watcher.takeTold();
  REQUIRE(told);
  const SharedEdits known = sharedTextFrom(*told).edits;
  CHECK(known.at({"modes", "skin", "0"}).stamp == SharedStamp{6, "uppsala"});
  CHECK(known.at({"modes", "bone", "0"}).stamp == SharedStamp{5, "boston"});
}

}  // namespace palpate::shared_scene_test
