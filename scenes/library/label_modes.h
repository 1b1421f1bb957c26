/// Private to scenes: modes of labels of a volume. The mode reads a mask of its labels; the mask is
/// a volume of the scene.
#pragma once

#include <cstddef>
#include <vector>

#include "palpate/devices/json/json_table.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"

namespace palpate {

/// Returns the type of the key "label": a whole number, a name, or a list of both.
[[nodiscard]] JsonType<std::vector<LabelKey>> labelType();

/// Adds the mask that mode number `number` reads, as a volume such as "labels:liver", and lets the
/// mode read it. Modes with equal masks share the volume. Throws SceneError if `mask.of` is not a
/// volume of the scene, or if another volume or a field has the mask's name.
void addMask(SceneSpec& spec, std::size_t number, MaskSpec mask);

/// Computes the masks of the loaded volumes. Throws SceneError if makeLabelMask rejects the labels,
/// and for masks of volumes that are sequences, in bricks, smoothed, displacements, or fields of
/// the caller.
void computeMasks(const SceneSpec& spec, BuiltScene& built, SceneCache& cache);

/// Returns true if the volume is a mask that computeMasks() makes.
[[nodiscard]] bool isMask(const VolumeSpec& volume);

}  // namespace palpate
