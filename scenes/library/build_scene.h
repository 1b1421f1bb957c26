/// Builds a scene from its description: SceneSpec becomes BuiltScene.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/field/placement.h"
#include "palpate/engine/loop/play_clock.h"
#include "palpate/engine/safety/device.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/grid/label_mask.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/time/frame_sequence.h"

namespace palpate {

class SceneCache;

/// Receives the progress of a function, 0 to 1. buildScene() reports this range twice if the scene
/// has parts: for loading the volumes, and for building the parts. Any thread may call it, but only
/// one at a time.
using Progress = std::function<void(double done)>;

/// Deformation of a placed volume (key "warp" of a scene file). The deformed volume has, at x and
/// time t, the value of the volume at x + u(x, t); see engine/field/warp.h.
struct WarpSpec {
  /// Name of the volume that contains u: one vector grid per frame, in its file's unit of length.
  /// Modes and fields cannot read this volume.
  std::string field;
  std::vector<double> times;  ///< Times of the frames, ascending [s]; empty: one frame.
  /// If true, the deformation repeats. There must then be two or more frames, and the last frame
  /// must equal the first one.
  bool repeat = false;
  WarpPtr warp;  ///< If set, the members above are ignored.
};

/// Place of a volume in W, and its motion (key "place" of a scene file).
struct PlaceSpec {
  /// Selects how the members below determine the place of the volume.
  enum class Kind : std::uint8_t {
    kFit,   ///< The longest side of the box around the active voxels becomes `size` [m].
    kUnit,  ///< True size: `size` is metres per unit of the file.
    kMap,   ///< p_W = translate + R scale p_file, with R from `rotation_wxyz`.
    /// Same transform and motion as the volume `like`, so that both stay aligned.
    kLike,
  };
  Kind kind = Kind::kFit;  ///< Determines which of the members below apply.
  double size = 0.1;   ///< For kFit: longest side in W [m]; for kUnit: metres per unit of the file.
  double scale = 1.0;  ///< For kMap: scale [m per unit of the file].
  /// Rotation as a quaternion; normalised when it is used.
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};
  Vec3 translate =
      Vec3::Zero();  ///< Translation [m]; for kFit and kUnit: place of the bounds' centre in W.
  std::string like;  ///< For kLike: name of the other volume.
  /// Poses that move the placed volume; empty: the volume does not move. Not for kLike.
  std::vector<Keyframe> keyframes;
  /// If true, the motion repeats; the last keyframe must then have the pose of the first one.
  bool repeat = false;
  /// Deformation of the volume; the keyframes move the deformed volume. Not for kLike.
  std::optional<WarpSpec> warp;
};

/// Playback of a sequence (key "frames" of a scene file); scenes/library/frames.h finds the frames.
struct FramesSpec {
  double rate = 0.0;  ///< Number of frames per second; 0: `times` applies.
  /// Times of the frames [s]. With `repeat`, the last time is the return of the first frame.
  std::vector<double> times;
  bool repeat = false;              ///< If true, the first frame follows the last frame.
  std::optional<double> budget_mb;  ///< Memory for the frames [MiB]; unset: 1024.
};

/// Playback of all sequences of a scene, on one clock.
struct PlaySpec {
  double speed = 1.0;   ///< PlayParams::speed.
  bool paused = false;  ///< PlayParams::paused.
  bool repeat = false;  ///< PlayParams::repeat.
  /// Earliest time that is played [s]; unset: the start of the first sequence, or no limit if all
  /// sequences repeat but the play does not.
  std::optional<double> from;
  /// Latest time that is played [s]; unset: the end of the last sequence, or no limit if a sequence
  /// repeats.
  std::optional<double> to;
};

/// A mask of labels (key "label" of a mode); see makeLabelMask.
struct MaskSpec {
  std::string of;                ///< Volume of labels; the mask has the place of this volume.
  std::vector<LabelKey> labels;  ///< At least one.
  double smooth = kMaskSigma;    ///< Standard deviation of the Gaussian [voxels].

  /// Returns true if all members are equal.
  bool operator==(const MaskSpec&) const = default;
};

/// A volume: a grid of a file, a sequence, a volume in bricks or in memory, a mask, or a field of
/// the caller.
struct VolumeSpec {
  /// A .vdb file, the folder or address of bricks, or a pattern for numbered files. Ignored if
  /// `volume` or `field` is set.
  std::filesystem::path file;
  /// Name of the grid; empty: the only grid of the file. For a sequence in one file: the frames are
  /// the grids of this name; empty: all grids.
  std::string grid;
  /// Treatment of values that are not finite; see LoadOptions.
  NonFinite non_finite = NonFinite::kRefuse;
  SmoothWidth smooth;  ///< Width of a Gaussian that smooths the grid; see LoadOptions.
  PlaceSpec place;     ///< Place and motion of the volume.
  /// If not empty, replaces `place` by several places, none with kLike, keyframes or a warp.
  /// Volumes that are placed like this volume (kLike) get the same instances.
  std::vector<PlaceSpec> instances;
  Sampling sampling;  ///< Interpolation between voxels; SceneSpec::slope_reach applies.
  std::optional<FramesSpec> frames;  ///< If set, the volume is a sequence.
  std::optional<double> budget_mb;   ///< For bricks: memory [MiB]; unset: 256.
  /// If set, the volume is a mask of another volume, and has no file. Ignored if `volume` is set.
  std::optional<MaskSpec> mask;
  std::shared_ptr<const Volume> volume;  ///< Volume in memory; if set, no file is read.
  /// Field of the caller; if set, only the keyframes, their `repeat` and the warp apply.
  FieldPtr field;
};

/// Description of a whole scene, with the content of a scene file.
struct SceneSpec {
  std::string source;  ///< Name of the scene in errors, such as its file.
  /// Coupling of probe and proxy; `graph.stiffness` may vary its stiffness.
  CouplingParams coupling;
  /// True if the user has not set the stiffness: then fitCoupling() may lower the stiffness.
  bool any_stiffness = false;
  StepParams step;                            ///< Accuracy with which a tick moves the proxy.
  double slope_reach = 0.5;                   ///< Sampling::slope_reach of all volumes.
  std::map<std::string, VolumeSpec> volumes;  ///< Volumes by the names that fields and modes use.
  GraphSpec graph;                            ///< Fields, modes, and a varying stiffness.
  /// Volume with the units and place of a guide, by index of the mode; absent: metres in W.
  std::map<std::size_t, std::string> guide_volumes;
  std::optional<PlaySpec> play;  ///< Playback; only for scenes with a sequence.
  /// If true, the scene is not divided into parts. Then no volume may have instances.
  bool one_graph = false;
  /// If true, readers wait for missing bricks and frames. Set `waits` in virtual time.
  bool waits = false;
  std::vector<std::string>
      notes;  ///< Notes for the user about skipped or ignored items, one line each.
};

/// A mask, or a derived field that a mode or a field differentiates. Both are computed at load.
struct ComputedField {
  std::string as;    ///< Description as in the scene, such as "magnitude of spin".
  std::string from;  ///< Volume from which the field is computed, directly or through other fields.
  std::string why;   ///< Reason, such as: mode "wall" needs its gradient.
};

/// Parts with equal volumes and modes, one for each instance.
struct PartGroup {
  std::size_t first = 0;            ///< Index of the first part in Scene::parts.
  std::size_t count = 0;            ///< Number of parts, which are consecutive.
  std::vector<std::string> things;  ///< Names of the volumes and derived fields in each part.
  /// Name of the volume that has the instances; empty: there is one part.
  std::string leader;
  std::vector<std::size_t> modes;  ///< Indices of the modes in SceneSpec::graph.
};

/// Volumes in bricks, by name.
using Windows = std::map<std::string, std::shared_ptr<const BrickWindow>>;

/// A scene that is ready to run, and its components.
struct BuiltScene {
  std::shared_ptr<const Scene> scene;  ///< The scene, for any number of hands.
  /// Volumes that are grids, and the computed fields, by name.
  std::map<std::string, std::shared_ptr<const Volume>> volumes;
  Windows windows;  ///< Volumes in bricks; `volumes` contains their coarsest levels.
  std::map<std::string, std::shared_ptr<const FrameSequence>>
      sequences;    ///< Volumes that are sequences; `volumes` contains their first frames with
                    ///< data.
  PlayParams play;  ///< Playback of the sequences.
  /// Places of the volumes; for instances, the first place.
  std::map<std::string, Placement> placements;
  std::map<std::string, Sampling> samplings;  ///< Interpolation of the volumes between voxels.
  /// Fields of all volumes at their places, in their rest pose.
  std::map<std::string, FieldPtr> fields;
  std::map<std::string, MotionPtr> motions;  ///< Motions of the moving volumes.
  /// Computed fields by name; `volumes` contains their volumes.
  std::map<std::string, ComputedField> computed;
  std::vector<PartGroup> parts;  ///< All groups of parts, ordered by their first modes.
  /// Box around all fields, at all times of their motions and at all instances, in W [m].
  Box bounds;
  std::vector<std::string> notes;  ///< Notes for the user about values and settings, one line each.
};

/// Loads the volumes of a scene, places them, checks the scene and compiles its graph.
///
/// A derived field becomes a volume if a mode or another field needs its derivatives. This volume
/// has the place and the interpolation of its source. Throws SceneError with the JSON path, or
/// VolumeError. A running scene is not affected. Slow.
///
/// @param cache  If not null, volumes in the cache are not loaded again. If the new scene has the
///               same fields and kinds of modes as the previous one, and no motions, the force
///               stays on when the new scene replaces it (Scene::shape).
[[nodiscard]] BuiltScene buildScene(const SceneSpec& spec, const Progress& progress = nullptr,
                                    SceneCache* cache = nullptr);

/// Returns `spec` with the coarsest level of each volume in bricks, and with the first frame with
/// data of each sequence. They are at their places in `built`, the scene built from `spec`. A
/// search for contacts in the result loads no bricks and no frames.
[[nodiscard]] SceneSpec coarsely(SceneSpec spec, const BuiltScene& built);

/// Lowers the stiffness to the limit of a device, unless the user has set the stiffness. Returns a
/// message for the user; empty if the stiffness is unchanged.
[[nodiscard]] std::string fitCoupling(SceneSpec& spec, const DeviceInfo& device);
/// Throws SceneError if the coupling has more stiffness or damping than the device renders stably.
void checkDevice(const SceneSpec& spec, const DeviceInfo& device);
/// Returns the coupling with the highest stiffness that can occur in the scene.
[[nodiscard]] CouplingParams stiffestCoupling(const SceneSpec& spec);

}  // namespace palpate
