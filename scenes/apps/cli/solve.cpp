#include <algorithm>
#include <cmath>
#include <istream>

#include <fmt/format.h>

#include "palpate/devices/recording/csv.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

using Json = nlohmann::json;

class LineError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

double readNumber(const Json& json, const std::string& name) {
  if (!json.is_number() || !std::isfinite(json.get<double>())) {
    throw LineError(name + " is not a finite number");
  }
  return json.get<double>();
}

Vec3 readVector(const Json& object, const char* key, const std::string& name) {
  if (!object.contains(key)) throw LineError(name + " is missing");
  const Json& json = object[key];
  if (!json.is_array() || json.size() != 3) throw LineError(name + " is not a list [x, y, z]");
  return {readNumber(json[0], name), readNumber(json[1], name), readNumber(json[2], name)};
}

void onlyKeys(const Json& object, const std::vector<std::string>& keys, const std::string& name) {
  for (const auto& [key, value] : object.items()) {
    if (std::find(keys.begin(), keys.end(), key) == keys.end()) {
      const std::string near = nearestName(key, keys);
      throw LineError(fmt::format("{}unknown key \"{}\"{}", name, key,
                                  near.empty() ? "" : ", did you mean \"" + near + "\"?"));
    }
  }
}

Primitive readPrimitive(const Json& json, const std::string& name) {
  if (!json.is_object()) throw LineError(name + " is not an object");
  onlyKeys(json, {"kind", "position", "direction", "strength"}, name + ": ");
  if (!json.contains("kind") || !json["kind"].is_string())
    throw LineError(name + ".kind is missing or is not a string: use force, point, line or plane");
  Primitive p;
  const auto kind = json["kind"].get<std::string>();
  bool known = false;
  for (const PrimitiveKind k : {PrimitiveKind::kForce, PrimitiveKind::kPoint, PrimitiveKind::kLine,
                                PrimitiveKind::kPlane}) {
    if (kind != wordFor(k)) continue;
    p.kind = k;
    known = true;
  }
  if (!known) throw LineError(name + ".kind \"" + kind + "\" is not force, point, line or plane");
  if (!json.contains("strength")) throw LineError(name + ".strength is missing");
  p.strength = readNumber(json["strength"], name + ".strength");
  if (p.strength < 0.0) throw LineError(name + ".strength is negative");
  if (p.kind != PrimitiveKind::kForce)
    p.position = readVector(json, "position", name + ".position");
  if (p.kind != PrimitiveKind::kPoint) {
    const Vec3 direction = readVector(json, "direction", name + ".direction");
    const double length = direction.stableNorm();
    if (!(length > 0.0) || !std::isfinite(length)) {
      throw LineError(name + ".direction has a length of 0, or one that overflows");
    }
    p.direction = (direction / length).normalized();
  }
  return p;
}

/// Returns the answer to one input line. Throws LineError.
OrderedJson answer(const std::string& line) {
  Json json;
  try {
    json = Json::parse(line, [](int depth, Json::parse_event_t, Json&) {
      if (depth > 16) throw LineError("the JSON is nested more than 16 levels deep");
      return true;
    });
  } catch (const Json::out_of_range&) {
    throw LineError("a number on the line is too large");
  } catch (const Json::exception&) {
    throw LineError("the line is not valid JSON");
  }
  if (!json.is_object()) throw LineError("the line is not a JSON object");
  onlyKeys(json, {"stiffness", "probe", "start", "primitives"}, "");
  if (!json.contains("stiffness")) throw LineError("stiffness is missing");
  const double stiffness = readNumber(json["stiffness"], "stiffness");
  if (stiffness <= 0.0) throw LineError("stiffness is not above 0");
  const Vec3 probe = readVector(json, "probe", "probe");
  const Vec3 start = json.contains("start") ? readVector(json, "start", "start") : probe;
  std::vector<Primitive> primitives;
  if (json.contains("primitives")) {
    if (!json["primitives"].is_array()) throw LineError("primitives is not a list");
    if (json["primitives"].size() > kMaxPrimitives) {
      throw LineError(fmt::format("primitives has more than {} entries", kMaxPrimitives));
    }
    for (std::size_t i = 0; i < json["primitives"].size(); ++i) {
      primitives.push_back(readPrimitive(json["primitives"][i], fmt::format("primitives[{}]", i)));
    }
  }

  const SolveResult result = solveProxy(probe, stiffness, primitives, start);
  if (result.status == SolveStatus::kBadInput)
    throw LineError("the result overflows: use smaller numbers");
  OrderedJson out;
  out["proxy"] = toJson(result.proxy);
  out["force"] = toJson(stiffness * result.offset);
  out["error_bound"] = result.error_bound;
  out["iterations"] = result.iterations;
  out["solver"] = result.solver == SolverKind::kClosedForm ? "closed-form" : "general";
  out["status"] = result.status == SolveStatus::kConverged ? "converged" : "iteration-limit";
  return out;
}

int solve(std::istream& in) {
  int status = kDone;
  std::string line;
  while (std::getline(in, line)) {
    if (line.find_first_not_of(" \t\r") == std::string::npos) continue;
    OrderedJson out;
    try {
      out = answer(line);
    } catch (const LineError& e) {
      out["proxy"] = nullptr;
      out["force"] = nullptr;
      out["error_bound"] = nullptr;
      out["iterations"] = 0;
      out["solver"] = nullptr;
      out["status"] = "bad-input";
      out["message"] = sentence(e.what()).text();
      status = kBadInput;
    }
    sayJson(out, -1);
  }
  if (in.bad())
    throw Error("solve", "reading failed", "check the disk, or the program that writes the input");
  return status;
}

}  // namespace

void addSolve(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "solve", "Computes the balance of primitives; reads and writes JSON Lines");
  auto file = std::make_shared<std::string>("-");
  verb->add_option("FILE", *file, "JSON Lines; - is standard input (default)");
  verb->footer(
      "Example (one line):\n  echo '{\"stiffness\": 500, \"probe\": [0, 0, -0.001], "
      "\"primitives\": "
      "[{\"kind\": \"plane\", \"position\": [0, 0, 0], \"direction\": [0, 0, 1], \"strength\": "
      "1.5}]}' | "
      "palpate solve");
  verb->callback([=, &body] {
    body = [=] {
      std::ifstream holder;
      return solve(openInput(*file, holder));
    };
  });
}

}  // namespace palpate::cli
