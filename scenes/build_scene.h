/// From a description of a scene to one that can be felt.
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

#include "palpate/engine/device.h"
#include "palpate/engine/placement.h"
#include "palpate/engine/play_clock.h"
#include "palpate/engine/scene.h"
#include "palpate/samplers/brick_window.h"
#include "palpate/samplers/frame_sequence.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/samplers/volume.h"

namespace palpate {

class SceneCache;

/// Told how far loading is, from 0 to 1; from any thread, one at a time.
using Progress = std::function<void(double done)>;

/// How a placed volume deforms, as the scene file's "warp" says: what is at x at a time is what it
/// has at x + u(x, t); see engine/warp.h.
struct WarpSpec {
  std::string field;          ///< Name of the volume that is u: vectors in its file's unit of
                              ///< length, one grid a frame (scenes/frames.h). It is only this.
  std::vector<double> times;  ///< Of the frames [s]; of a single one none is needed.
  bool repeat = false;        ///< The last frame is the first again.
  WarpPtr warp;               ///< If set, of the above nothing counts.
};

/// Where a volume stands in the hand's world, as the scene file's "place" says.
struct PlaceSpec {
  /// Which of the members below place the volume, and how.
  enum class Kind : std::uint8_t {
    kFit,   ///< The longest side of the active bounds is `size` metres, centred.
    kUnit,  ///< True size: one unit of the file is `size` metres, centred.
    kMap,   ///< p = translate + R scale x.
    kLike,  ///< The same map as another volume's: co-registered. Moves with it.
  };
  Kind kind = Kind::kFit;                           ///< Decides which of the next five count.
  double size = 0.1;                                ///< [m]
  double scale = 1.0;                               ///< [m per unit of the file]
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};  ///< Normalised when used.
  Vec3 translate = Vec3::Zero();                    ///< [m]
  std::string like;                                 ///< Another volume's name.
  std::vector<Keyframe> keyframes;  ///< Move the volume so placed; none: it stands still. Not with
                                    ///< kLike.
  bool repeat = false;              ///< The last keyframe joins the first.
  std::optional<WarpSpec> warp;     ///< Deforms it, before the keyframes move it. Not with kLike.
};

/// How a volume that is a sequence is played, as the scene file's "frames" says: its frames are the
/// grids or files that scenes/frames.h finds.
struct FramesSpec {
  double rate = 0.0;          ///< Frames a second; 0: by `times`.
  std::vector<double> times;  ///< Of the frames [s]; repeated one more, when the first comes again.
  bool repeat = false;        ///< After the last frame the first comes.
  std::optional<double> budget_mb;  ///< Of memory for frames [MB]; none: 1024.
};

/// How the sequences of a scene are played together.
struct PlaySpec {
  double speed = 1.0;          ///< As PlayParams.
  bool paused = false;         ///< As PlayParams.
  bool repeat = false;         ///< As PlayParams.
  std::optional<double> from;  ///< [s]; none: where the first sequence begins.
  std::optional<double> to;    ///< [s]; none: where the last one ends, if none of them repeats.
};

/// One volume: a grid of a file, one in bricks, one already in memory, or a field of the user's
/// own.
struct VolumeSpec {
  std::filesystem::path file;  ///< A .vdb, a folder of bricks (samplers/bricks.h), or of many
                               ///< frames; not read where `volume` or `field` is set.
  std::string grid;            ///< Empty: the only one.
  NonFinite non_finite = NonFinite::kRefuse;  ///< As LoadOptions.
  int smooth = 0;                             ///< As LoadOptions, voxels.
  PlaceSpec place;                            ///< Where it stands, and how it moves.
  std::vector<PlaceSpec> instances;  ///< Where it stands instead, many times; not with kLike, no
                                     ///< keyframes. What is placed like it stands there as well.
  Sampling sampling;                 ///< How its values between voxels come about.
  std::optional<FramesSpec> frames;  ///< It is a sequence, and played so.
  std::optional<double> budget_mb;   ///< Of memory for bricks [MB]; none: 256. Only for these.
  std::shared_ptr<const Volume> volume;  ///< If set, no file is read.
  FieldPtr field;                        ///< If set, of the above only keyframes and warp count.
};

/// A whole scene, as a scene file says it; C++ builds the same and has it checked the same.
struct SceneSpec {
  std::string source;          ///< Named in errors: the scene file.
  CouplingParams coupling;     ///< The spring from probe to proxy; `graph.stiffness` may vary it.
  bool any_stiffness = false;  ///< Nobody has asked for that stiffness: fitCoupling may lower it.
  StepParams step;             ///< How exactly the proxy moves within a tick.
  std::map<std::string, VolumeSpec> volumes;         ///< By the names that fields and modes use.
  GraphSpec graph;                                   ///< "fields", "modes" and a varying stiffness.
  std::map<std::size_t, std::string> guide_volumes;  ///< By mode: the volume in whose own units a
                                                     ///< guide is given, else metres of W.
  std::optional<PlaySpec> play;                      ///< Only where there is a sequence.
  bool one_graph = false;          ///< No parts, however many volumes; not with instances.
  bool waits = false;              ///< Whoever reads bricks or frames waits for them
                                   ///< (WindowParams::waits): for virtual time.
  std::vector<std::string> notes;  ///< For the user, one line each: what was skipped or ignored.
};

/// A derived field that was computed at load, because something needs its derivatives.
struct ComputedField {
  std::string as;    ///< "magnitude of spin": as the scene says it.
  std::string from;  ///< The volume that it comes from in the end.
  std::string why;   ///< "mode "wall" needs its gradient"
};

/// Parts of a scene that are alike: the instances of the same volumes.
struct PartGroup {
  std::size_t first = 0;            ///< Index into Scene::parts,
  std::size_t count = 0;            ///< one after the other.
  std::vector<std::string> things;  ///< The volumes and derived fields that each has.
  std::string leader;               ///< That whose instances they are; empty: it is there once.
  std::vector<std::size_t> modes;   ///< Indices into SceneSpec::graph's.
};

/// Volumes in bricks, by name.
using Windows = std::map<std::string, std::shared_ptr<const BrickWindow>>;

/// A scene and what it was made of.
struct BuiltScene {
  std::shared_ptr<const Scene> scene;                            ///< For any number of hands.
  std::map<std::string, std::shared_ptr<const Volume>> volumes;  ///< Those that are grids, and
                                                                 ///< the computed fields.
  Windows windows;  ///< In `volumes` are their coarsest levels.
  std::map<std::string, std::shared_ptr<const FrameSequence>>
      sequences;                                  ///< Those that are played: in `volumes` are their
                                                  ///< first frames.
  PlayParams play;                                ///< How these are played.
  std::map<std::string, Placement> placements;    ///< Of many the first.
  std::map<std::string, Sampling> samplings;      ///< Of the volumes.
  std::map<std::string, FieldPtr> fields;         ///< All volumes, placed, as they rest.
  std::map<std::string, MotionPtr> motions;       ///< Of those that move.
  std::map<std::string, ComputedField> computed;  ///< By name; each is in `volumes` too.
  std::vector<PartGroup> parts;                   ///< All of them, in the order of their modes.
  Box bounds;                      ///< Of all fields in W, wherever they move or stand [m].
  std::vector<std::string> notes;  ///< What was filled or smoothed away, and what is valid but can
                                   ///< hardly be meant, one line each.
};

/// Loads, places, checks and compiles. A derived field that a mode needs the gradient of (surface,
/// isosurface, force by a scalar), or another field the derivatives of, is computed at load and
/// from there on a volume, placed and interpolated as the one that it comes from. Throws SceneError
/// (with the JSON path) or VolumeError; whatever is running is not touched. Slow.
///
/// @param cache  If given: what it has need not be loaded again, and a hand feels a scene of the
///               same fields as an edit.
[[nodiscard]] BuiltScene buildScene(const SceneSpec& spec, const Progress& progress = nullptr,
                                    SceneCache* cache = nullptr);

/// A scene's volumes in bricks by their coarsest levels, and sequences by their first frames, where
/// they stand: to look for places in, without fetching anything. `built`: of `spec`.
[[nodiscard]] SceneSpec coarsely(SceneSpec spec, const BuiltScene& built);

/// Lowers a coupling that nobody has asked for to what a device renders. What to tell the user
/// about it; empty: nothing was changed.
[[nodiscard]] std::string fitCoupling(SceneSpec& spec, const DeviceInfo& device);
/// Throws SceneError where the coupling asks for more stiffness or damping than a device renders
/// stably.
void checkDevice(const SceneSpec& spec, const DeviceInfo& device);
/// The coupling at the most that a varying stiffness comes to.
[[nodiscard]] CouplingParams stiffestCoupling(const SceneSpec& spec);

}  // namespace palpate
