// Tests the scenes that play the time steps of a file.
#include "palpate/scenes/apps/import/play_scene.h"

#include <limits>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::play_scene_test {
using namespace palpate::importer;
using Catch::Contains;
using Json = nlohmann::json;

namespace {

struct Played {
  Json scene;
  std::vector<std::string> notes;

  [[nodiscard]] Json frames() const { return scene["volumes"]["heart"]["frames"]; }
};

Played played(const PlayedSteps& steps) {
  const Json guess = {
      {"palpate", 1},
      {"volumes",
       {{"heart", {{"file", "a_%04d.vdb"}, {"grid", "heart"}}},
        {"fibres", {{"file", "a_%04d.vdb"}, {"grid", "fibres"}, {"axial", true}}}}}};
  Played out;
  out.scene = Json::parse(playScene(guess.dump(), steps, out.notes));
  return out;
}

PlayedSteps stepsAt(const std::vector<double>& times, std::optional<double> unit = 1.0) {
  return {times, unit, 1000, "a_0002.vdb"};
}

}  // namespace

TEST_CASE("a scene plays steps at equal times by their rate, and others by their times", "[play]") {
  CHECK(played(stepsAt({2.0, 2.1F, 2.2F, 2.3F})).frames() == Json{{"rate", 10.0}});
  CHECK(played(stepsAt({2.0, 2.25, 3.0})).frames() == Json{{"times", {0.0, 0.25, 1.0}}});
  CHECK(played(stepsAt({7.0, 57.0, 157.0}, 1e-3)).frames() == Json{{"times", {0.0, 0.05, 0.15}}});
}

TEST_CASE("a scene plays steps of hours or microseconds at about five steps a second", "[play]") {
  const Json slow = played(stepsAt({0.0, 6.0, 12.0}, 3600.0)).scene["play"];
  CHECK(slow["speed"] == 110000.0);
  CHECK(slow["repeat"] == true);
  CHECK_THAT(slow["description"].get<std::string>(), Contains("5 steps a second"));
  CHECK(played(stepsAt({0.0, 2e-6, 4e-6})).scene["play"]["speed"] == 1e-5);
  CHECK(played(stepsAt({0.0, 1.0, 2.0})).scene["play"] == Json{{"speed", 1.0}, {"repeat", true}});
}

TEST_CASE("times that do not increase, or without a unit, are reported", "[play]") {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  for (const std::vector<double>& times : {std::vector{0.0, 1.0, 1.0},
                                           {0.0, 2.0, 1.0},
                                           {0.0, kNone, 1.0},
                                           {0.0, 1e-314, 2e-314},
                                           {0.0, 1e290, 1e300}}) {
    const Played one = played(stepsAt(times));
    CHECK(one.frames() == Json{{"rate", 1.0}});
    CHECK_THAT(one.notes.front(), Contains("the times of the steps do not increase"));
  }
  const Played unknown = played(stepsAt({0.0, 0.5, 1.0}, std::nullopt));
  CHECK(unknown.frames() == Json{{"rate", 2.0}});
  CHECK_THAT(unknown.notes.front(), Contains("states no unit of its times that palpate knows") &&
                                        Contains("takes them as seconds"));
  const Played fast = played(stepsAt({0.0, 5.0, 10.0}, std::nullopt));
  CHECK(fast.scene["play"]["description"] == "about 5 steps a second");
}

TEST_CASE("a scene of large steps states the memory that play needs", "[play]") {
  PlayedSteps steps = stepsAt({0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7});
  steps.largest = 300ULL << 20U;
  // Seven frames: the five around two moments, one that loads, and one of the last 50 ms.
  CHECK(played(steps).frames()["budget_mb"] == 2520.0);
  steps.times.resize(2);
  CHECK_FALSE(played(steps).frames().contains("budget_mb"));
}

TEST_CASE("axial vectors do not play: the scene keeps those of one step", "[play]") {
  const Played one = played(stepsAt({0.0, 0.1, 0.2}));
  CHECK(one.scene["volumes"]["heart"]["file"] == "a_%04d.vdb");
  CHECK(one.scene["volumes"]["fibres"]["file"] == "a_0002.vdb");
  CHECK_FALSE(one.scene["volumes"]["fibres"].contains("frames"));
  CHECK_THAT(one.notes.back(), Contains("fibres") && Contains("a_0002.vdb"));
}

TEST_CASE("units of time are recognized by name, also before a date", "[play]") {
  CHECK(secondsIn("hours since 1900-01-01 00:00") == 3600.0);
  CHECK(secondsIn("Days") == 86400.0);
  CHECK(secondsIn("ms") == 1e-3);
  CHECK(secondsIn("s") == 1.0);
  CHECK(secondsIn("seconds") == 1.0);
  CHECK(secondsIn("nanosecond") == 1e-9);
  CHECK(secondsIn("hectosecond") == 100.0);
  CHECK(secondsIn("Megaseconds since") == 1e6);
  for (const char* unit :
       {"attosecond",  "centisecond", "day",         "decisecond",  "exasecond",  "femtosecond",
        "gigasecond",  "hectosecond", "hour",        "kilosecond",  "megasecond", "microsecond",
        "millisecond", "minute",      "nanosecond",  "petasecond",  "picosecond", "second",
        "terasecond",  "yoctosecond", "yottasecond", "zeptosecond", "zettasecond"}) {
    CAPTURE(unit);
    CHECK(secondsIn(unit).has_value());  // all of NGFF 0.4
  }
  CHECK_FALSE(secondsIn("lightsecond").has_value());
  CHECK_FALSE(secondsIn("mm").has_value());
  CHECK_FALSE(secondsIn("").has_value());
}

}  // namespace palpate::play_scene_test
