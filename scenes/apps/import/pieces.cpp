#include "palpate/scenes/apps/import/pieces.h"

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/tensors.h"
#include "palpate/scenes/guess/components.h"

namespace palpate::importer {
namespace {

Values withThree(const Values& two) {
  Values out(Type::kFloat32, 3, two.tuples());
  out.setLost(floatLoss(two));
  auto* to = out.as<float>();
  for (std::size_t i = 0; i < two.tuples(); ++i, to += 3) {
    to[0] = static_cast<float>(two.at(i, 0));
    to[1] = static_cast<float>(two.at(i, 1));
    to[2] = 0.0F;
  }
  return out;
}

/// Returns a valid name for a grid: UTF-8, at most 100 bytes, no control characters.
std::string nameOf(std::string name, std::vector<std::string>& notes) {
  name.erase(name.find_last_not_of(' ') + 1);  // Exodus pads names with spaces
  const std::string given = name;
  constexpr std::size_t kLongest = 100;
  if (name.size() > kLongest) name.resize(kLongest);
  // nlohmann-json throws if the name is not UTF-8. In this case, replaces all bytes beyond ASCII.
  bool plain = true;
  try {
    (void)nlohmann::json(name).dump();
  } catch (const nlohmann::json::exception&) {
    plain = false;
  }
  for (char& c : name) {
    const auto u = static_cast<unsigned char>(c);
    if (u < 0x20 || u == 0x7f || (!plain && u > 0x7f)) c = '_';
  }
  if (name != given) {
    notes.push_back(
        fmt::format("an array was renamed to \"{}\", because its name has more than 100 bytes or "
                    "special characters",
                    name));
  }
  return name.empty() ? "density" : name;
}

/// Returns the arrays with valid names and with 1 or 3 components (makeReady). Leaves out other
/// arrays, and also tensors of a mesh, because directions cannot be interpolated in a cell.
std::vector<Array> readyArrays(std::vector<Array> given, const Content& content, bool image,
                               std::vector<std::string>& notes) {
  std::vector<Array> arrays;
  for (Array& array : given) {
    array.name = nameOf(array.name, notes);
    const auto known = content.value_unit.find(array.name);
    if (known != content.value_unit.end()) array.unit = known->second;
    const int components = array.values.components();
    if (components == 1 || components == 3) {
      arrays.push_back(std::move(array));
    } else if (components == 2) {
      array.values = withThree(array.values);
      notes.push_back(
          fmt::format("{}: the vectors have two components: z is set to 0", array.name));
      arrays.push_back(std::move(array));
    } else if ((components == 6 || components == 9) && image) {
      for (Array& felt : diffusionOf(array)) arrays.push_back(std::move(felt));
      notes.push_back(
          fmt::format("{0}: tensors became {0}_direction (its sign has no meaning), {0}_anisotropy "
                      "and {0}_diffusivity",
                      array.name));
    } else {
      notes.push_back(fmt::format("{}: skipped: it has {} values per point, {}", array.name,
                                  components, image ? "not 1, 2, 3, 6 or 9" : "not 1, 2 or 3"));
    }
  }
  return arrays;
}

std::vector<std::string> namesOf(const std::vector<Piece>& pieces) {
  std::vector<std::string> names;
  for (const Piece& piece : pieces) {
    for (const Array& array : piece.arrays) names.push_back(array.name);
  }
  return names;
}

Values joined(const std::array<Array*, 3>& parts) {
  const std::size_t count = parts[0]->values.tuples();
  Values out(Type::kFloat32, 3, count);
  for (std::size_t c = 0; c < 3; ++c) {
    out.setLost(floatLoss(parts[c]->values));
    const Values from = floatsOf(std::exchange(parts[c]->values, Values()));
    const float* read = from.as<float>();
    float* write = out.as<float>() + c;
    const auto offset = static_cast<float>(parts[c]->value_offset);
    for (std::size_t i = 0; i < count; ++i) write[3 * i] = read[i] + offset;
  }
  return out;
}

}  // namespace

std::vector<Piece> makeReady(Content& content, const std::string& file,
                             std::vector<std::string>& notes) {
  std::vector<Piece> pieces = std::exchange(content.pieces, {});
  for (Piece& piece : pieces) {
    if (piece.isImage() && !piece.by_cell &&
        *std::min_element(piece.size.begin(), piece.size.end()) < 2) {
      throw VolumeError(file,
                        fmt::format("the image is flat: {} points", fmt::join(piece.size, " x ")),
                        "give an image with two or more points along each axis");
    }
    piece.arrays = readyArrays(std::move(piece.arrays), content, piece.isImage(), notes);
    if (!piece.by_cell) continue;
    for (const Array& array : piece.arrays) {
      notes.push_back(fmt::format("{}: one value per cell: the cells became voxels", array.name));
    }
  }
  std::erase_if(pieces, [](const Piece& piece) { return piece.arrays.empty(); });
  std::set<std::string> taken;
  for (Piece& piece : pieces) {
    for (Array& array : piece.arrays) {
      std::string name = array.name;
      for (int n = 2; !taken.insert(name).second; ++n) name = fmt::format("{}_{}", array.name, n);
      array.given = array.name;
      array.name = name;
    }
  }
  if (taken.empty()) {
    throw VolumeError(file, "the file has no array with one, two or three values per point",
                      "export such an array with the image or mesh");
  }
  return pieces;
}

void joinComponents(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
                    std::vector<std::string>& notes) {
  const std::vector<std::string> there = namesOf(pieces);
  std::set<std::string> taken(there.begin(), there.end());
  for (Piece& piece : pieces) {
    std::vector<std::string> names;
    std::vector<Array*> scalars;
    for (Array& array : piece.arrays) {
      if (array.values.components() != 1) continue;
      names.push_back(array.given.empty() ? array.name : array.given);
      scalars.push_back(&array);
    }
    for (const Components& found : findComponents(names)) {
      if (!fields.empty() && std::find(fields.begin(), fields.end(), found.name) == fields.end()) {
        continue;
      }
      std::array<Array*, 3> parts{};
      for (std::size_t c = 0; c < 3; ++c) parts[c] = scalars[found.parts[c]];
      if (parts[0]->unit != parts[1]->unit || parts[0]->unit != parts[2]->unit) continue;
      std::string name = found.name;
      for (int n = 2; !taken.insert(name).second; ++n) name = fmt::format("{}_{}", found.name, n);
      notes.push_back(fmt::format("{}, {} and {}: joined into the vector {}", parts[0]->name,
                                  parts[1]->name, parts[2]->name, name));
      parts[0]->values = joined(parts);
      parts[0]->value_offset = 0.0;
      parts[0]->name = name;
      parts[0]->given = found.name;
    }
    std::erase_if(piece.arrays, [](const Array& array) { return array.values.none(); });
  }
}

void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file) {
  if (fields.empty()) return;
  const std::vector<std::string> names = namesOf(pieces);
  for (const std::string& field : fields) {
    if (std::find(names.begin(), names.end(), field) == names.end()) {
      throw VolumeError(file, fmt::format("no array \"{}\" can be imported", field),
                        fmt::format("choose from {}", fmt::join(names, ", ")));
    }
  }
  for (Piece& piece : pieces) {
    std::erase_if(piece.arrays, [&](const Array& array) {
      return std::find(fields.begin(), fields.end(), array.name) == fields.end() &&
             std::find(fields.begin(), fields.end(), array.given) == fields.end();
    });
  }
  std::erase_if(pieces, [](const Piece& piece) { return piece.arrays.empty(); });
}

}  // namespace palpate::importer
