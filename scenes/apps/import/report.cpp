#include "palpate/scenes/apps/import/report.h"

#include <sys/resource.h>

#include <fmt/format.h>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/common/say.h"

namespace palpate::importer {
namespace {

using OrderedJson = nlohmann::ordered_json;

std::string voxelsOf(const Imported& imported) {
  const openvdb::GridBase& grid = *imported.made.grid;
  const openvdb::Vec3d edge = grid.voxelSize();
  std::string line = fmt::format("{} active voxels", imported.made.active);
  if (!imported.level_set) {
    line += fmt::format(" ({:.3g} %)", 100.0 * static_cast<double>(imported.made.active) /
                                           static_cast<double>(imported.made.voxels));
  }
  line += fmt::format(" with edges of {:.4g} x {:.4g} x {:.4g} along i, j, k", edge.x(), edge.y(),
                      edge.z());
  if (imported.resampling) {
    line += fmt::format(", compared with the original at {} points", imported.resampling->points);
    if (imported.resampling->edge_points > 0) {
      line += fmt::format(" and {} at the edge of the data", imported.resampling->edge_points);
    }
    if (imported.resampling->lost_points > 0) {
      line += fmt::format("; {} more points in the mesh have no voxel with data around them",
                          imported.resampling->lost_points);
    }
  }
  return "  " + line + "\n";
}

std::string lineOf(const Imported& imported) {
  const Gridded& made = imported.made;
  const openvdb::GridBase& grid = *made.grid;
  const bool vector = grid.isType<openvdb::Vec3SGrid>();
  std::string line = cli::words("    {}: ", grid.getName()).text();
  if (imported.level_set && made.active == 0) {
    line += "empty level set, without a surface";
  } else if (imported.level_set) {
    line +=
        fmt::format("level set, solid {} the value; surface error {:.2g} voxels rms, {:.2g} at p99",
                    imported.level_set->solid_above ? "above" : "below",
                    imported.level_set->rms_error, imported.level_set->p99_error);
    if (imported.level_set->lost > 0.0) {
      line +=
          fmt::format("; {:.2g} % of the surface was lost, because it is thinner than the voxels",
                      100.0 * imported.level_set->lost);
    }
  } else {
    line += fmt::format("{} {:.5g} .. {:.5g}", vector ? "lengths" : "values", made.lowest,
                        made.highest);
    if (!vector) line += fmt::format(", background {:.5g}", made.background);
    if (imported.value_offset != 0.0) {
      line += fmt::format("; value in the file = value + {:.0f}", imported.value_offset);
    }
  }
  if (made.tolerance > 0.0) {
    line +=
        fmt::format("; values within {:.3g} of the background became background", made.tolerance);
  }
  if (imported.smoothing > 0.0) {
    line += fmt::format("; smoothing changed the values by {:.3g} rms", imported.smoothing);
  }
  if (made.holes > 0) line += fmt::format("; {} voxels have no data", made.holes);
  if (imported.resampling && imported.resampling->points == 0) {
    line += "; resampling error not measured: no point has data on all sides";
  } else if (imported.resampling) {
    line += fmt::format("; resampling error {:.2g} % rms of the range, {:.2g} % at most",
                        100.0 * imported.resampling->rms, 100.0 * imported.resampling->largest);
    if (imported.resampling->edge_points > 0) {
      line += fmt::format(" inside, {:.2g} % rms and {:.2g} % at most in the outermost voxel",
                          100.0 * imported.resampling->edge_rms,
                          100.0 * imported.resampling->edge_largest);
    }
  }
  if (made.quieter_tolerance > 0.0) {
    line += fmt::format("; --tolerance {:.3g} would keep {:.3g} % active", made.quieter_tolerance,
                        100.0 * made.quieter_share);
  }
  return line + "\n";
}

OrderedJson gridJson(const Imported& imported) {
  const Gridded& made = imported.made;
  const openvdb::GridBase& grid = *made.grid;
  const openvdb::Vec3d edge = grid.voxelSize();
  OrderedJson json{{"name", grid.getName()},
                   {"type", grid.isType<openvdb::Vec3SGrid>() ? "vec3s" : "float"},
                   {"unit", imported.unit},
                   {"voxel", {edge.x(), edge.y(), edge.z()}},
                   {"active_voxels", made.active},
                   {"voxels", made.voxels},
                   {"holes", made.holes},
                   {"lowest", made.lowest},
                   {"highest", made.highest},
                   {"background", made.background},
                   {"tolerance", made.tolerance}};
  if (imported.value_offset != 0.0) {
    json["value_offset"] = OrderedJson::parse(fmt::format("{:.0f}", imported.value_offset));
  }
  if (made.quieter_tolerance > 0.0) {
    json["quieter"] = {{"tolerance", made.quieter_tolerance}, {"share", made.quieter_share}};
  }
  if (imported.smoothing > 0.0) json["smoothing_rms"] = imported.smoothing;
  if (imported.resampling) {
    const bool measured = imported.resampling->points > 0;
    json["resampling"] = {
        {"rms", measured ? OrderedJson(imported.resampling->rms) : OrderedJson()},
        {"largest", measured ? OrderedJson(imported.resampling->largest) : OrderedJson()},
        {"points", imported.resampling->points},
        {"edge_rms", imported.resampling->edge_rms},
        {"edge_largest", imported.resampling->edge_largest},
        {"edge_points", imported.resampling->edge_points},
        {"lost_points", imported.resampling->lost_points}};
  }
  if (imported.level_set) {
    json["level_set"] = {{"solid", imported.level_set->solid_above ? "above" : "below"},
                         {"rms_voxels", imported.level_set->rms_error},
                         {"p99_voxels", imported.level_set->p99_error},
                         {"crossings", imported.level_set->crossings},
                         {"lost", imported.level_set->lost}};
  }
  return json;
}

}  // namespace

std::uint64_t peakMemory() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
}

std::string textOf(const std::filesystem::path& out, const Step& step) {
  std::string text = cli::words("{}:\n", out.string()).text();
  std::string voxels;
  for (const Imported& imported : step.grids) {
    if (voxelsOf(imported) != voxels) text += voxels = voxelsOf(imported);
    text += lineOf(imported);
  }
  for (const std::string& note : step.notes) {
    text += cli::words("  {}\n", cli::sentence(note)).text();
  }
  return text;
}

OrderedJson jsonOf(const std::filesystem::path& out, const Step& step) {
  OrderedJson report{{"file", out.string()}};
  if (step.time) report["time"] = *step.time;
  report["grids"] = OrderedJson::array();
  std::uint64_t memory = 0;
  for (const Imported& imported : step.grids) {
    report["grids"].push_back(gridJson(imported));
    memory += imported.made.grid->memUsage();
  }
  report["memory"] = {{"grids", memory}};
  report["notes"] = step.notes;
  return report;
}

}  // namespace palpate::importer
