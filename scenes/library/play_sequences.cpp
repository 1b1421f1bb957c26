#include "palpate/scenes/library/play_sequences.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/frames.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {

void checkSequence(const SceneSpec& spec, const std::string& name) {
  const VolumeSpec& volume = spec.volumes.at(name);
  const std::string path = pathIn(spec, "/volumes/" + name);
  const auto refuse = [&](bool wrong, const char* key, const char* why, const char* remedy) {
    if (wrong) throw SceneError(path + "/" + key, why, remedy);
  };
  const FramesSpec& frames = *volume.frames;
  refuse(frames.times.empty() == (frames.rate == 0.0), "frames",
         "a sequence needs either \"rate\" or \"times\"",
         "give the frames per second, or the time of each frame");
  refuse(!std::isfinite(frames.rate) || frames.rate < 0.0, "frames/rate",
         "the rate is not a finite number > 0", "give frames per second, such as 25");
  refuse(isInBricks(volume), "frames", "a folder of bricks is one volume, not a sequence",
         "give the frames in .vdb files");
  refuse(volume.budget_mb.has_value(), "window",
         "\"window\" is only for volumes in bricks, and this volume is a sequence",
         "move \"budget_mb\" to \"frames\"");
  refuse(!volume.instances.empty(), "instances", "a sequence can have only one place",
         "replace \"instances\" by \"place\"");
}

std::shared_ptr<const FrameSequence> openSequence(const SceneSpec& spec, const std::string& name,
                                                  const Placement& placement, SceneCache& cache) {
  const VolumeSpec& volume = spec.volumes.at(name);
  const FramesSpec& of = *volume.frames;
  std::vector<VolumeRequest> frames = framesOf(volume);
  const FrameTimes when = of.rate > 0.0 ? evenTimes(frames.size(), of.rate, of.repeat)
                                        : FrameTimes{of.times, of.repeat};
  constexpr double kDefault = 1024.0;
  constexpr double kMost = 1e9;
  SequenceParams params;
  params.budget =
      static_cast<std::uint64_t>(std::min(kMost, of.budget_mb.value_or(kDefault)) * 1024 * 1024);
  params.waits = spec.waits;
  return cache.sequence({std::move(frames), when, placement, samplingOf(spec, name), params});
}

PlayParams playOf(const SceneSpec& spec, const BuiltScene& built) {
  if (built.sequences.empty()) {
    if (!spec.play) return {};
    throw SceneError(pathIn(spec, "/play"), "the scene has no sequence to play",
                     "add \"frames\" to a volume, or remove \"play\"");
  }
  const PlaySpec play = spec.play.value_or(PlaySpec{});
  PlayParams out;
  out.speed = play.speed;
  out.paused = play.paused;
  out.repeat = play.repeat;
  constexpr double kForEver = std::numeric_limits<double>::infinity();
  double first = kForEver;
  double end = -kForEver;
  bool all_repeat = true;
  for (const auto& [name, sequence] : built.sequences) {
    const FrameTimes& when = sequence->times();
    first = std::min(first, when.times.front());
    end = std::max(end, when.repeat ? kForEver : when.times.back());
    all_repeat = all_repeat && when.repeat;
  }
  // A repeating sequence has frames for all times, also for times before that of its first frame.
  out.from = play.from.value_or(all_repeat && !out.repeat ? -kForEver : first);
  out.to = play.to.value_or(end);
  out.begin = play.from.value_or(std::min(first, out.to));
  if (out.speed < 0.0 && std::isfinite(out.to)) out.begin = out.to;
  const auto refuse = [&](bool wrong, const char* key, const char* why, const char* remedy) {
    if (wrong) throw SceneError(pathIn(spec, std::string("/play/") + key), why, remedy);
  };
  refuse(!std::isfinite(out.speed), "speed", "the number is not finite",
         "give seconds per second, such as 1");
  refuse(play.from && !std::isfinite(out.from), "from", "the number is not finite",
         "give a time in seconds");
  refuse(!play.to && out.to < out.from, "from", "all sequences have ended before this time",
         "give a time [s] before the last frame's");
  if (std::isnan(out.to) || out.to < out.from) {
    throw SceneError(
        pathIn(spec, "/play/to"),
        fmt::format("the latest time, {} s, is before the earliest time, {} s", out.to, out.from),
        "give a later time [s], or an earlier \"from\"");
  }
  refuse(out.repeat && !std::isfinite(out.to), "repeat",
         "the play has no end, because a sequence repeats", "add \"to\", or remove \"repeat\"");
  if (out.speed < 0.0 && out.begin <= out.from) {
    throw SceneError(
        pathIn(spec, "/play/speed"),
        fmt::format("backward play begins at the earliest time, {} s, so nothing is played",
                    out.from),
        fmt::format("set \"to\", the time at which backward play begins, to more than {} s",
                    out.from));
  }
  return out;
}

void noteSequences(const SceneSpec& spec, BuiltScene& built) {
  for (const auto& [name, sequence] : built.sequences) {
    const SequenceState state = sequence->state();
    if (state.frames == 1) {
      built.notes.push_back(
          fmt::format("{}: the sequence has only one frame: give a file for each frame, such as "
                      "frame_%04d.vdb, or a file with a grid for each frame",
                      pathIn(spec, "/volumes/" + name + "/frames")));
    }
    if (state.empty > 0) {
      const std::vector<std::string>& first = sequence->firstEmpty();
      built.notes.push_back(fmt::format(
          "{}: {} of the sequence's {} frames have no data, and play as background: {}{}",
          pathIn(spec, "/volumes/" + name + "/frames"), state.empty, state.frames,
          fmt::join(first, "; "), state.empty > first.size() ? "; and others" : ""));
    }
    const std::uint64_t needed =
        std::min(sequence->neededFor(std::abs(built.play.speed)), state.frames);
    if (state.slots >= needed) continue;
    built.notes.push_back(
        fmt::format("{}: memory holds {} of the sequence's {} frames, but this speed of play needs "
                    "{}: give a larger budget_mb{}",
                    pathIn(spec, "/volumes/" + name + "/frames"), state.slots, state.frames, needed,
                    state.slots < sequence->neededFor(0.0) ? "" : ", or a lower speed"));
  }
}

}  // namespace palpate
