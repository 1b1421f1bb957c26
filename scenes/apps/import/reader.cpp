#include "palpate/scenes/apps/import/reader.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <string_view>
#include <utility>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate::importer {
namespace {

class OneStep final : public Reader {
 public:
  OneStep(Request request, Content (*how)(const Request&))
      : request_(std::move(request)), read_(how) {}

  Content read(std::size_t /*step*/) override { return read_(request_); }

 private:
  Request request_;
  Content (*read_)(const Request&);
};

}  // namespace

std::optional<double> secondsIn(const std::string& unit) {
  // Years and months have the lengths of UDUNITS, which the CF conventions use.
  constexpr double kYear = 31556925.9747;
  static const std::map<std::string, double> units = {
      {"us", 1e-6},     {"usec", 1e-6}, {"ms", 1e-3},     {"msec", 1e-3},        {"s", 1.0},
      {"sec", 1.0},     {"min", 60.0},  {"minute", 60.0}, {"h", 3600.0},         {"hr", 3600.0},
      {"hour", 3600.0}, {"d", 86400.0}, {"day", 86400.0}, {"month", kYear / 12}, {"year", kYear}};
  // The prefixes of seconds in OME-Zarr 0.4.
  static const std::map<std::string, double> prefixes = {
      {"yocto", 1e-24}, {"zepto", 1e-21}, {"atto", 1e-18}, {"femto", 1e-15}, {"pico", 1e-12},
      {"nano", 1e-9},   {"micro", 1e-6},  {"milli", 1e-3}, {"centi", 1e-2},  {"deci", 1e-1},
      {"", 1.0},        {"hecto", 1e2},   {"kilo", 1e3},   {"mega", 1e6},    {"giga", 1e9},
      {"tera", 1e12},   {"peta", 1e15},   {"exa", 1e18},   {"zetta", 1e21},  {"yotta", 1e24}};
  std::string word = unit.substr(0, unit.find_first_of(" \t"));
  std::transform(word.begin(), word.end(), word.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const std::string single = word.substr(0, word.size() - (word.ends_with('s') ? 1 : 0));
  for (const std::string& name : {word, single}) {
    if (const auto found = units.find(name); found != units.end()) return found->second;
  }
  constexpr std::string_view kSecond = "second";
  if (!single.ends_with(kSecond)) return std::nullopt;
  const auto found = prefixes.find(single.substr(0, single.size() - kSecond.size()));
  return found == prefixes.end() ? std::nullopt : std::optional(found->second);
}

Slab slicesToRead(const Request& request, Piece& image, bool is_packed, int depth) {
  if (request.slices) {
    image.held = request.slices(image.size, image.file_from_index, is_packed, depth);
  }
  return image.slices();
}

std::string remedyForMemory(const Request& request, int slices, const std::string& first) {
  // A brick has kBrickSide slices, so --bricks reads at least as many together. A displacement
  // field cannot be written as bricks.
  const bool can_divide = slices > kBrickSide && request.as != "displacement";
  if (!can_divide || (request.slices && first.empty())) {
    return "end other programs, or export a smaller part of the image";
  }
  if (request.slices) return first + ", so that --bricks reads it in parts";
  return (first.empty() ? "import it" : first + ", and import it") +
         " with --bricks, without --voxel and --iso: then only a part is in memory";
}

std::unique_ptr<Reader> oneStep(const Request& request, Content (*read)(const Request&)) {
  return std::make_unique<OneStep>(request, read);
}

}  // namespace palpate::importer
