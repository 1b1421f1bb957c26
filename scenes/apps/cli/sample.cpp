#include <algorithm>
#include <array>
#include <string_view>

#include <fmt/format.h>

#include "palpate/devices/recording/csv.h"
#include "palpate/engine/error.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

constexpr std::array<std::string_view, 7> kDerived{"curl", "divergence", "jacobian", "magnitude",
                                                   "unit", "q",          "lambda2"};

struct SampleOptions {
  std::string file;
  std::string grid;
  std::string points;
  std::string interpolation = "trilinear";
  std::vector<std::string> derive;
  bool json = false;
};

/// Results at one point, in the order of the output columns.
using Sampled = std::vector<double>;

/// Names of the output columns after x,y,z, and the function that computes their values.
struct Table {
  std::vector<std::string> columns;
  std::function<Sampled(const Vec3&)> read;
};

Table scalarTable(const std::shared_ptr<const ScalarField>& field) {
  auto cache = std::make_shared<FieldCache>();
  field->reset(*cache);
  return {{"inside", "value", "gx", "gy", "gz"}, [=](const Vec3& p) {
            const ScalarSample s = field->sample(p, *cache);
            return Sampled{s.inside ? 1.0 : 0.0, s.value, s.gradient.x(), s.gradient.y(),
                           s.gradient.z()};
          }};
}

Table vectorTable(const std::shared_ptr<const VectorField>& field,
                  const std::vector<std::string>& derive) {
  auto cache = std::make_shared<FieldCache>();
  field->reset(*cache);
  Table table{{"inside", "vx", "vy", "vz"}, nullptr};
  for (const std::string& word : derive) {
    if (word == "curl" || word == "unit") {
      for (const char i : {'x', 'y', 'z'}) table.columns.push_back(fmt::format("{}_{}", word, i));
    } else if (word != "jacobian") {
      table.columns.push_back(word);
    } else {
      for (const char i : {'x', 'y', 'z'}) {
        for (const char j : {'x', 'y', 'z'}) table.columns.push_back(fmt::format("j_{}{}", i, j));
      }
    }
  }
  table.read = [=](const Vec3& p) {
    const VectorSample s = field->sample(p, *cache);
    Sampled row{s.inside ? 1.0 : 0.0, s.value.x(), s.value.y(), s.value.z()};
    for (const std::string& word : derive) {
      if (word == "curl" || word == "unit") {
        const Vec3 v = word == "curl" ? curl(s.jacobian) : unit(s.value);
        row.insert(row.end(), {v.x(), v.y(), v.z()});
      } else if (word == "magnitude") {
        row.push_back(s.value.norm());
      } else if (word == "divergence") {
        row.push_back(divergence(s.jacobian));
      } else if (word == "q") {
        row.push_back(qCriterion(s.jacobian));
      } else if (word == "lambda2") {
        row.push_back(lambda2(s.jacobian));
      } else {
        for (int i = 0; i < 3; ++i) {
          for (int j = 0; j < 3; ++j) row.push_back(s.jacobian(i, j));
        }
      }
    }
    return row;
  };
  return table;
}

int sample(const SampleOptions& options) {
  for (const std::string& word : options.derive) {
    if (std::find(kDerived.begin(), kDerived.end(), word) != kDerived.end()) continue;
    throw Error("--derive", "\"" + word + "\" is not known",
                fmt::format("use {}, separated by commas", fmt::join(kDerived, ", ")));
  }
  const auto interpolation = interpolationNamed(options.interpolation);
  if (!interpolation) {
    throw Error("--interpolation", "\"" + options.interpolation + "\" is not known",
                "use trilinear, nearest, quadratic or cubic");
  }
  const auto volume =
      loadVolume(options.file, options.grid, {NonFinite::kRefuse, {}, showProgress("loading")});
  const FieldPtr field = makeVdbField(volume, Placement{}, {*interpolation});
  if (field.index() == 0 && !options.derive.empty()) {
    throw Error("--derive", "grid \"" + volume->info().name + "\" is scalar",
                "leave out --derive: the gradient is always printed");
  }
  const Table table = field.index() == 0 ? scalarTable(std::get<0>(field))
                                         : vectorTable(std::get<1>(field), options.derive);
  std::ifstream holder;
  const auto points = readCsv(openInput(options.points, holder), {"x", "y", "z"},
                              options.points == "-" ? "standard input" : options.points);

  std::string out;
  if (!options.json) {
    out = "x,y,z";
    for (const std::string& column : table.columns) out += "," + column;
    out += "\n";
  }
  for (const auto& [line, p] : points) {
    const Sampled row = table.read({p[0], p[1], p[2]});
    if (options.json) {
      OrderedJson json;
      json["x"] = p[0];
      json["y"] = p[1];
      json["z"] = p[2];
      json["inside"] = row[0] == 1.0;
      for (std::size_t i = 1; i < row.size(); ++i) json[table.columns[i]] = row[i];
      out += dump(json) + "\n";
    } else {
      out += number(p[0]) + "," + number(p[1]) + "," + number(p[2]);
      for (const double value : row) out.append(",").append(number(value));
      out += "\n";
    }
    if (out.size() > 1U << 20U) {
      sayRaw(out);
      out.clear();
    }
  }
  sayRaw(out);
  return kDone;
}

}  // namespace

void addSample(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "sample", "Prints a grid's value and derivatives at points in the file's world space");
  auto options = std::make_shared<SampleOptions>();
  verb->add_option("FILE", options->file, "A .vdb file")->required();
  verb->add_option("--grid", options->grid, "Grid name; may be omitted if the file has only one");
  verb->add_option("--points", options->points, "CSV with the header x,y,z; - is standard input")
      ->required();
  verb->add_option("--interpolation", options->interpolation,
                   "trilinear (default), nearest, quadratic or cubic");
  verb->add_option(
          "--derive", options->derive,
          fmt::format("For vector grids: {}; separate them by commas", fmt::join(kDerived, ", ")))
      ->delimiter(',');
  verb->add_flag("--json", options->json, "Print JSON Lines");
  verb->footer(
      "Example:\n  printf 'x,y,z\\n0,0,0\\n' | palpate sample head.vdb --grid density "
      "--points -");
  verb->callback([=, &body] { body = [=] { return sample(*options); }; });
}

}  // namespace palpate::cli
