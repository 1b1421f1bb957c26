#include "palpate/scenes/apps/import/reader.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <utility>

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
      {"us", 1e-6},     {"usec", 1e-6},        {"microsecond", 1e-6},
      {"ms", 1e-3},     {"msec", 1e-3},        {"millisecond", 1e-3},
      {"s", 1.0},       {"sec", 1.0},          {"second", 1.0},
      {"min", 60.0},    {"minute", 60.0},      {"h", 3600.0},
      {"hr", 3600.0},   {"hour", 3600.0},      {"d", 86400.0},
      {"day", 86400.0}, {"month", kYear / 12}, {"year", kYear}};
  std::string word = unit.substr(0, unit.find_first_of(" \t"));
  std::transform(word.begin(), word.end(), word.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  auto found = units.find(word);
  if (found == units.end() && word.ends_with('s')) {
    found = units.find(word.substr(0, word.size() - 1));
  }
  return found == units.end() ? std::nullopt : std::optional(found->second);
}

Slab slicesToRead(const Request& request, Piece& image, bool is_packed) {
  if (request.slices) image.held = request.slices(image.size, image.file_from_index, is_packed);
  return image.slices();
}

std::unique_ptr<Reader> oneStep(const Request& request, Content (*read)(const Request&)) {
  return std::make_unique<OneStep>(request, read);
}

}  // namespace palpate::importer
