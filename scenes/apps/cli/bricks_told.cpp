#include "palpate/scenes/apps/cli/bricks_told.h"

#include <fmt/format.h>

namespace palpate::cli {
namespace {

struct Counts {
  std::uint64_t stored = 0;
  std::uint64_t constant = 0;
  std::uint64_t background = 0;
  std::uint64_t bytes = 0;
};

Counts countsOf(const BrickManifest& manifest, std::size_t level) {
  Counts counts;
  for (const BrickEntry& entry : manifest.entries(static_cast<std::int32_t>(level))) {
    ++(entry.kind == BrickKind::kStored ? counts.stored : counts.constant);
    counts.bytes += entry.bytes;
  }
  counts.background = manifest.levels()[level].bricks() - counts.stored - counts.constant;
  return counts;
}

std::uint64_t storedIn(const BrickManifest& manifest) {
  std::uint64_t stored = 0;
  for (std::size_t l = 0; l < manifest.levels().size(); ++l) {
    stored += countsOf(manifest, l).stored;
  }
  return stored;
}

double ratioOf(const BrickManifest& manifest) {
  const auto bytes = static_cast<double>(manifest.storedBytes());
  const auto unpacked = static_cast<double>(storedIn(manifest) * manifest.format().bytes());
  return bytes > 0.0 ? unpacked / bytes : 1.0;
}

}  // namespace

OrderedJson bricksJson(const BrickManifest& manifest) {
  OrderedJson json;
  json["identity"] = fmt::format("{:016x}", manifest.identity());
  json["brick_bytes"] = manifest.format().bytes();
  json["stored"] = storedIn(manifest);
  json["bytes"] = manifest.storedBytes();
  json["ratio"] = ratioOf(manifest);
  json["levels"] = OrderedJson::array();
  for (std::size_t l = 0; l < manifest.levels().size(); ++l) {
    const BrickLevel& level = manifest.levels()[l];
    const Counts counts = countsOf(manifest, l);
    json["levels"].push_back({{"voxel_size", toJson(level.linear.colwise().norm().transpose())},
                              {"count", level.count},
                              {"stored", counts.stored},
                              {"constant", counts.constant},
                              {"background", counts.background},
                              {"bytes", counts.bytes}});
  }
  return json;
}

void sayBricks(const BrickManifest& manifest) {
  for (std::size_t l = 0; l < manifest.levels().size(); ++l) {
    const auto& count = manifest.levels()[l].count;
    const Counts counts = countsOf(manifest, l);
    say("  level {}   {} x {} x {} bricks: {} stored in {} MB, {} constant, {} background\n", l,
        count[0], count[1], count[2], counts.stored,
        rounded(static_cast<double>(counts.bytes) / 1e6), counts.constant, counts.background);
  }
  say("  bricks    {} stored in {} MB, {} times as large in memory\n", storedIn(manifest),
      rounded(static_cast<double>(manifest.storedBytes()) / 1e6), rounded(ratioOf(manifest)));
}

}  // namespace palpate::cli
