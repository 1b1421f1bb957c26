#include "palpate/scenes/library/place_table.h"

#include <array>
#include <string>
#include <utility>
#include <vector>

#include "palpate/scenes/library/length_units.h"

namespace palpate {
namespace {

JsonType<double> unitType() {
  std::vector<std::pair<const char*, double>> words;
  words.reserve(kSceneUnits.size());
  for (const SceneUnit& unit : kSceneUnits) words.emplace_back(unit.name, unit.metres);
  return jsonWord<double>(std::move(words));
}

JsonType<std::array<double, 4>> rotationType() {
  return jsonNumbers<4>().says("A quaternion, which is normalised before use.");
}

JsonObject<PlaceSpec> motionRows() {
  const JsonType<Keyframe> keyframe =
      JsonObject<Keyframe>()
          .need("time", jsonNumber().says("Time since the scene began [s]."), &Keyframe::time)
          .may("rotation_wxyz", rotationType(), &Keyframe::rotation_wxyz)
          .may("translate", vectorType(), &Keyframe::translate)
          .type();
  const JsonType<WarpSpec> warp =
      JsonObject<WarpSpec>()
          .need("field",
                jsonName().says(
                    "The volume whose vectors are the displacement u, in the unit of length of its "
                    "file. The matter now at x was at x + u before deformation. The frames are the "
                    "grids of one name in this file, or numbered files (%04d in \"file\")."),
                &WarpSpec::field)
          .may("times",
               jsonList(jsonNumber(), "it is not a list of times, or is empty",
                        "write [0, 0.1, ...]")
                   .says("Times of the frames, ascending [s]. The displacement is constant before "
                         "the first and after the last. A single frame needs no time."),
               &WarpSpec::times)
          .may("repeat",
               jsonFlag().says("If true, the deformation repeats, and the last frame has to equal "
                               "the first. The default is false."),
               &WarpSpec::repeat)
          .type()
          .says("Deformation of the placed volume. The keyframes move the deformed volume.");
  return JsonObject<PlaceSpec>()
      .may("warp", warp, [](PlaceSpec& place, WarpSpec value) { place.warp = std::move(value); })
      .may("keyframes",
           jsonList(keyframe, "it is not a list of keyframes, or is empty",
                    "write [{\"time\": 0, ...}, ...]")
               .says("Motion of the placed volume. A keyframe turns it about the world's origin "
                     "and then shifts it. The pose changes evenly between keyframes and is "
                     "constant before the first and after the last. Times ascend."),
           &PlaceSpec::keyframes)
      .may("repeat",
           jsonFlag().says("If true, the motion repeats, and the last keyframe's pose has to equal "
                           "the first's. The default is false."),
           &PlaceSpec::repeat)
      .needs("repeat", "keyframes", "\"repeat\" needs keyframes", "add \"keyframes\"");
}

std::vector<JsonObject<PlaceSpec>> placesWith(const JsonObject<PlaceSpec>& motion) {
  const auto put = [](PlaceSpec::Kind kind) {
    return [kind](PlaceSpec& place, double size) {
      place.kind = kind;
      (kind == PlaceSpec::Kind::kMap ? place.scale : place.size) = size;
    };
  };
  // The kinds `fit` and `unit` turn the volume about its centre, and then shift the volume.
  const auto centred = [&](JsonObject<PlaceSpec> rows) {
    return rows.may("rotation_wxyz", rotationType(), &PlaceSpec::rotation_wxyz)
        .may("translate", vectorType().says("Place of the volume's centre [m]."),
             &PlaceSpec::translate)
        .with(motion);
  };
  return {centred(JsonObject<PlaceSpec>().need(
              "fit",
              jsonPositive().says("Length of the longest side of the box around the active voxels "
                                  "[m]. The volume is centred."),
              put(PlaceSpec::Kind::kFit))),
          centred(JsonObject<PlaceSpec>().need(
              "unit",
              unitType().says(
                  "The file's unit of length. The volume has its true size and is centred."),
              put(PlaceSpec::Kind::kUnit))),
          JsonObject<PlaceSpec>()
              .need("scale", jsonPositive().says("Scale: metres per unit of the file."),
                    put(PlaceSpec::Kind::kMap))
              .may("rotation_wxyz", rotationType(), &PlaceSpec::rotation_wxyz)
              .may("translate", vectorType(), &PlaceSpec::translate)
              .with(motion)};
}

}  // namespace

JsonType<Vec3> vectorType() {
  return jsonNumbers<3>().as<Vec3>([](const auto& v) { return Vec3(v[0], v[1], v[2]); });
}

JsonType<PlaceSpec> placeType() {
  std::vector<JsonObject<PlaceSpec>> kinds = placesWith(motionRows());
  kinds.push_back(
      JsonObject<PlaceSpec>()
          .need("like",
                jsonName().says("Name of the volume whose place and motion this volume shares."),
                [](PlaceSpec& place, std::string name) {
                  place.kind = PlaceSpec::Kind::kLike;
                  place.like = std::move(name);
                })
          .refuse({"keyframes", "repeat", "warp"},
                  "a volume that is placed like another volume moves with it",
                  "remove this key, or place the volume by fit, unit or scale")
          .refuse({"rotation_wxyz", "translate"},
                  "a volume that is placed like another volume is turned and shifted like it",
                  "remove this key, or place the volume by fit, unit or scale"));
  return JsonObject<PlaceSpec>()
      .chooseByKey(std::move(kinds))
      .type()
      .says("Place of the volume. The default is {\"fit\": 0.1}.");
}

JsonType<PlaceSpec> instanceType() {
  return JsonObject<PlaceSpec>()
      .chooseByKey(placesWith({}))
      .refuse({"like", "keyframes", "repeat", "warp"},
              "an instance cannot move, and cannot be placed like another volume",
              "remove this key, and place the instance by fit, unit or scale")
      .type();
}

}  // namespace palpate
