#include "palpate/samplers/grid/label_mask.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <optional>
#include <set>
#include <type_traits>
#include <utility>

#include <openvdb/tree/LeafManager.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/prepare.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

/// Largest number of labels that an error lists.
constexpr std::size_t kMostListedLabels = 40;

std::string labelNumber(double value) {
  return std::to_string(static_cast<long long>(value));
}

/// Returns the remedy for an unknown label. It lists the labels of the metadata, or else the grid's
/// values if these are fewer than 10,000 whole numbers.
template <class GridT>
std::string remedyFor(const GridInfo& info, const GridT& grid) {
  constexpr std::size_t kMostDistinct = 10'000;
  std::set<double> values;
  std::vector<std::string> words;
  for (const Label& label : info.labels) {
    words.push_back(labelNumber(label.value) + (label.name.empty() ? "" : " " + label.name));
  }
  if (words.empty()) {
    for (auto value = grid.cbeginValueOn(); value && values.size() < kMostDistinct; ++value) {
      values.insert(static_cast<double>(*value));
    }
    const bool whole = std::all_of(values.begin(), values.end(), [](double v) {
      return std::floor(v) == v && std::abs(v) <= kMostLabel;
    });
    if (!whole || values.size() == kMostDistinct) {
      return "name a grid of labels: the values of this grid are not a few whole numbers";
    }
    for (const double value : values) words.push_back(labelNumber(value));
    // The background is a label too if it stands for a structure, as in an image without air.
    if (const auto around = static_cast<double>(grid.background());
        values.count(around) == 0 && std::floor(around) == around &&
        std::abs(around) <= kMostLabel) {
      words.push_back("the background " + labelNumber(around));
    }
  }
  std::string text = "choose from ";
  for (std::size_t i = 0; i < std::min(words.size(), kMostListedLabels); ++i) {
    text += (i > 0 ? ", " : "") + words[i];
  }
  if (words.size() > kMostListedLabels) {
    text += " and " + std::to_string(words.size() - kMostListedLabels) + " others (palpate info)";
  }
  return text;
}

/// A requested label: its value, and its colour if the metadata state one.
struct WantedLabel {
  double value = 0.0;
  std::optional<Vec3> colour;
};

/// Returns the value and the colour of a label; no value for an unknown name. Throws VolumeError
/// for a name of two values.
std::optional<WantedLabel> findLabel(const LabelKey& key, const std::vector<Label>& labels,
                                     const std::string& where) {
  const auto* value = std::get_if<double>(&key);
  const auto* name = std::get_if<std::string>(&key);
  const Label* found = nullptr;
  for (const Label& label : labels) {
    if (value != nullptr ? label.value != *value : label.name != *name) continue;
    if (found == nullptr) found = &label;
    if (label.value != found->value) {
      throw VolumeError(where,
                        "the labels " + labelNumber(found->value) + " and " +
                            labelNumber(label.value) + " both have the name \"" + *name + "\"",
                        "give the value of the label instead of its name");
    }
  }
  if (found != nullptr) return WantedLabel{found->value, found->colour};
  return value != nullptr ? std::optional<WantedLabel>({*value, std::nullopt}) : std::nullopt;
}

/// Makes the mask's voxels. Sets seen[i] if a voxel or the background has the value wanted[i].
template <class GridT>
openvdb::FloatGrid::Ptr maskOf(const GridT& grid, const std::vector<WantedLabel>& wanted,
                               std::vector<std::atomic<bool>>& seen) {
  using Leaf = openvdb::FloatTree::LeafNodeType;
  using Tree = typename GridT::TreeType;
  const auto is_wanted = [&](double value) {
    bool found = false;
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      if (wanted[i].value != value) continue;
      found = true;
      if (!seen[i].load(std::memory_order_relaxed)) seen[i] = true;
    }
    return found;
  };
  const bool around = is_wanted(static_cast<double>(grid.background()));
  const float other = around ? 0.0F : 1.0F;
  auto mask = openvdb::FloatGrid::create(around ? 1.0F : 0.0F);
  mask->setTransform(grid.transform().copy());
  const openvdb::tree::LeafManager<const Tree> leaves(grid.tree());
  std::vector<std::unique_ptr<Leaf>> made(leaves.leafCount());
  inParallel(made.size(), [&](std::size_t n) {
    const auto& leaf = leaves.leaf(n);
    auto out = std::make_unique<Leaf>(leaf.origin(), mask->background());
    for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
      if (is_wanted(static_cast<double>(leaf.getValue(i))) != around) out->setValueOn(i, other);
    }
    if (!out->isEmpty()) made[n] = std::move(out);
  });
  for (auto& leaf : made) {
    if (leaf) mask->tree().addLeaf(leaf.release());
  }
  auto tile = grid.cbeginValueAll();
  tile.setMaxDepth(GridT::ValueAllCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    if (is_wanted(static_cast<double>(*tile)) == around) continue;
    mask->tree().sparseFill(tile.getBoundingBox(), other, true);
  }
  return mask;
}

}  // namespace

std::string textOf(const LabelKey& label) {
  const auto* name = std::get_if<std::string>(&label);
  return name != nullptr ? *name : labelNumber(std::get<double>(label));
}

std::string textOf(const std::vector<LabelKey>& labels) {
  std::string text;
  for (const LabelKey& label : labels) text += (text.empty() ? "" : "+") + textOf(label);
  return text;
}

std::shared_ptr<const Volume> makeLabelMask(const std::shared_ptr<const Volume>& volume,
                                            const std::vector<LabelKey>& labels, double sigma) {
  const GridInfo& from = volume->info();
  const std::string where = "grid \"" + from.name + "\"";
  if (from.vector || from.grid_class == GridClass::kLevelSet) {
    throw VolumeError(where,
                      from.vector ? "it is a vector, not a grid of labels"
                                  : "it is a level set, not a grid of labels",
                      "name a scalar grid of whole numbers");
  }
  const auto make = [&](const auto& data) -> std::shared_ptr<const Volume> {
    using GridT = std::remove_const_t<typename std::decay_t<decltype(data)>::element_type>;
    if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
      const auto refuse = [&](const LabelKey& label) {
        throw VolumeError(where, "it has no voxel with the label " + textOf(label),
                          remedyFor(from, *data));
      };
      std::vector<WantedLabel> wanted;
      for (const LabelKey& label : labels) {
        const std::optional<WantedLabel> found = findLabel(label, from.labels, where);
        if (!found) refuse(label);
        wanted.push_back(*found);
      }
      std::vector<std::atomic<bool>> seen(wanted.size());
      const openvdb::FloatGrid::Ptr mask = maskOf(*data, wanted, seen);
      for (std::size_t i = 0; i < labels.size(); ++i) {
        if (!seen[i]) refuse(labels[i]);
      }
      LoadOptions options;
      options.smooth.sigma = sigma;
      Prepared out = prepare(from.name + ":" + textOf(labels), mask, options);
      if (!out.info.refusal.empty()) {
        throw VolumeError(where,
                          out.info.refusal == kNoActiveVoxel
                              ? "all its voxels have these labels, so they have no surface"
                              : "the mask of these labels has no surface: " + out.info.refusal,
                          "omit one of the labels");
      }
      out.info.colour = wanted.front().colour;
      out.info.source = from.source;
      return std::make_shared<Volume>(std::move(out.info), std::move(out.grid));
    } else {
      return nullptr;
    }
  };
  return std::visit(make, volume->grid().parts.front().data);
}

}  // namespace palpate
