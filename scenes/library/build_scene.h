/// Builds a scene from its description.
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
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/time/frame_sequence.h"

namespace palpate {

class SceneCache;

/// Receives the progress of loading, from 0 to 1. Any thread calls it; calls do not overlap.
using Progress = std::function<void(double done)>;

/// Deformation of a placed volume (key "warp" of a scene file): the value at x at time t is the
/// volume's value at x + u(x, t); see engine/field/warp.h.
struct WarpSpec {
  std::string field;  ///< Name of the volume u: vectors in its file's unit of length, one grid a
                      ///< frame (scenes/library/frames.h). It serves as u only.
  std::vector<double> times;  ///< Times of the frames [s]; not needed for a single frame.
  bool repeat = false;        ///< Repeats; the last frame is the first again.
  WarpPtr warp;               ///< If set, the members above are ignored.
};

/// Place of a volume in W (key "place" of a scene file).
struct PlaceSpec {
  /// Selects the members below that place the volume, and how.
  enum class Kind : std::uint8_t {
    kFit,   ///< The longest side of the active bounds is `size` metres; centred.
    kUnit,  ///< True size: one unit of the file is `size` metres; centred.
    kMap,   ///< p = translate + R scale x.
    kLike,  ///< The same map as another volume's (co-registered). Moves with it.
  };
  Kind kind = Kind::kFit;                           ///< Selects the members that apply.
  double size = 0.1;                                ///< [m]
  double scale = 1.0;                               ///< [m per unit of the file]
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};  ///< Normalised when used.
  Vec3 translate = Vec3::Zero();                    ///< [m]
  std::string like;                                 ///< Name of the other volume.
  std::vector<Keyframe> keyframes;  ///< Move the placed volume; empty: static. Not with kLike.
  bool repeat = false;              ///< Repeats; the last keyframe is the first again.
  std::optional<WarpSpec> warp;     ///< Deforms the volume before the keyframes move it. Not with
                                    ///< kLike.
};

/// Playback of a volume that is a sequence (key "frames" of a scene file). scenes/library/frames.h
/// finds its frames: grids or files.
struct FramesSpec {
  double rate = 0.0;          ///< Frames per second; 0: `times` applies.
  std::vector<double> times;  ///< Times of the frames [s]; with `repeat` one more, when the first
                              ///< returns.
  bool repeat = false;        ///< The first frame follows the last one.
  std::optional<double> budget_mb;  ///< Memory for frames [MB]; unset: 1024.
};

/// Common playback of a scene's sequences.
struct PlaySpec {
  double speed = 1.0;          ///< See PlayParams.
  bool paused = false;         ///< See PlayParams.
  bool repeat = false;         ///< See PlayParams.
  std::optional<double> from;  ///< [s]; unset: the begin of the first sequence.
  std::optional<double> to;    ///< [s]; unset: the end of the last sequence, if no sequence
                               ///< repeats.
};

/// One volume: a grid of a file, a volume in bricks, a volume in memory, or a field of the user.
struct VolumeSpec {
  std::filesystem::path file;  ///< A .vdb, a folder of bricks (samplers/bricks/bricks.h), or a
                               ///< pattern for many frames; not read if `volume` or `field` is set.
  std::string grid;            ///< Empty: the only grid.
  NonFinite non_finite = NonFinite::kRefuse;  ///< See LoadOptions.
  int smooth = 0;                             ///< See LoadOptions [voxels].
  PlaceSpec place;                            ///< Its place and motion.
  std::vector<PlaceSpec> instances;  ///< Replaces `place` by many places; not with kLike, no
                                     ///< keyframes. Volumes placed like this one have the same
                                     ///< instances.
  Sampling sampling;                 ///< Interpolation between voxels; the scene sets the reach of
                                     ///< slopes.
  std::optional<FramesSpec> frames;  ///< If set, the volume is a sequence.
  std::optional<double> budget_mb;   ///< Memory for bricks [MB]; unset: 256. Only for bricks.
  std::shared_ptr<const Volume> volume;  ///< If set, no file is read.
  FieldPtr field;                        ///< If set, only keyframes and warp apply of the above.
};

/// A whole scene, as in a scene file. A scene built in C++ gets the same checks.
struct SceneSpec {
  std::string source;          ///< Name in errors: the scene file.
  CouplingParams coupling;     ///< Spring from probe to proxy; `graph.stiffness` may vary it.
  bool any_stiffness = false;  ///< The user did not set the stiffness: fitCoupling may lower it.
  StepParams step;             ///< Accuracy of the proxy's motion within a tick.
  double slope_reach = 0.5;    ///< Sampling::slope_reach of all volumes.
  std::map<std::string, VolumeSpec> volumes;         ///< Keys: the names that fields and modes use.
  GraphSpec graph;                                   ///< "fields", "modes" and a varying stiffness.
  std::map<std::size_t, std::string> guide_volumes;  ///< Keys: mode indices. The volume that sets a
                                                     ///< guide's units; absent: metres in W.
  std::optional<PlaySpec> play;                      ///< Only for scenes with a sequence.
  bool one_graph = false;          ///< Builds no parts for any number of volumes; not with
                                   ///< instances.
  bool waits = false;              ///< Readers of bricks or frames wait for them
                                   ///< (WindowParams::waits): for virtual time.
  std::vector<std::string> notes;  ///< For the user, one line each: skipped or ignored items.
};

/// A derived field that is computed at load, because a mode or field needs its derivatives.
struct ComputedField {
  std::string as;    ///< "magnitude of spin": as in the scene.
  std::string from;  ///< The volume at the start of its chain of derivations.
  std::string why;   ///< "mode "wall" needs its gradient"
};

/// Similar parts of a scene: the instances of the same volumes.
struct PartGroup {
  std::size_t first = 0;            ///< Index into Scene::parts.
  std::size_t count = 0;            ///< Number of parts, which are consecutive.
  std::vector<std::string> things;  ///< Volumes and derived fields of each part.
  std::string leader;               ///< The volume with the instances; empty: there is one part.
  std::vector<std::size_t> modes;   ///< Indices into the modes of SceneSpec::graph.
};

/// Volumes in bricks, by name.
using Windows = std::map<std::string, std::shared_ptr<const BrickWindow>>;

/// A scene and its components.
struct BuiltScene {
  std::shared_ptr<const Scene> scene;                            ///< For any number of hands.
  std::map<std::string, std::shared_ptr<const Volume>> volumes;  ///< Volumes that are grids, and
                                                                 ///< the computed fields.
  Windows windows;  ///< `volumes` holds their coarsest levels.
  std::map<std::string, std::shared_ptr<const FrameSequence>>
      sequences;                                  ///< The sequences that are played; `volumes`
                                                  ///< holds their first frames.
  PlayParams play;                                ///< Playback of the sequences.
  std::map<std::string, Placement> placements;    ///< For instances the first place.
  std::map<std::string, Sampling> samplings;      ///< Sampling of the volumes.
  std::map<std::string, FieldPtr> fields;         ///< All volumes, placed, in their rest pose.
  std::map<std::string, MotionPtr> motions;       ///< Motions of the moving volumes.
  std::map<std::string, ComputedField> computed;  ///< Keys: names; each is in `volumes` too.
  std::vector<PartGroup> parts;                   ///< All groups, in the order of their modes.
  Box bounds;                      ///< Box about all fields in W, over all motions and instances
                                   ///< [m].
  std::vector<std::string> notes;  ///< Filled or smoothed values, and settings that are valid but
                                   ///< doubtful, one line each.
};

/// Loads, places, checks and compiles a scene. A derived field is computed at load if a mode needs
/// its gradient (surface, isosurface, force by a scalar), or if another field needs its
/// derivatives. It then is a volume, placed and interpolated like its source. Throws SceneError
/// (with the JSON path) or VolumeError; a running scene is not touched. Slow.
///
/// @param cache  If given, its contents are not loaded again. For a hand, a scene of the same
///               fields is then an edit.
[[nodiscard]] BuiltScene buildScene(const SceneSpec& spec, const Progress& progress = nullptr,
                                    SceneCache* cache = nullptr);

/// Returns `spec` with brick volumes replaced by their coarsest levels and sequences by their first
/// frames, at the same places. Serves searches for places without fetching data. `built` is the
/// result of `spec`.
[[nodiscard]] SceneSpec coarsely(SceneSpec spec, const BuiltScene& built);

/// If the user did not set the stiffness, lowers it to the limit of a device. Returns a message for
/// the user; empty: unchanged.
[[nodiscard]] std::string fitCoupling(SceneSpec& spec, const DeviceInfo& device);
/// Throws SceneError if the coupling asks for more stiffness or damping than a device renders
/// stably.
void checkDevice(const SceneSpec& spec, const DeviceInfo& device);
/// Returns the coupling at the highest value of a varying stiffness.
[[nodiscard]] CouplingParams stiffestCoupling(const SceneSpec& spec);

}  // namespace palpate
