#include "palpate/scenes/library/live.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fcntl.h>
#include <map>
#include <new>
#include <sched.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

// [Hz]: approximate rate at which ticks with primitives are published
constexpr double kWholeRate = 100.0;
const char* const kSubject = "window";

std::array<double, 3> numbers(const Vec3& v) noexcept {
  return {v.x(), v.y(), v.z()};
}

}  // namespace

int loopsCore() noexcept {
  cpu_set_t cores;
  if (sched_getaffinity(0, sizeof cores, &cores) != 0 || CPU_COUNT(&cores) < 2) return -1;
  int last = CPU_SETSIZE - 1;
  while (last > 0 && !CPU_ISSET(static_cast<std::size_t>(last), &cores)) --last;
  return last;
}

LiveShare::LiveShare()
    : descriptor_(memfd_create("palpate-live", MFD_CLOEXEC | MFD_ALLOW_SEALING)) {
  if (descriptor_.get() < 0 || ftruncate(descriptor_.get(), sizeof(LiveBlock)) != 0 ||
      fcntl(descriptor_.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) {
    throw Error(kSubject, std::string("shared memory cannot be created: ") + std::strerror(errno),
                "run palpate feel without a window");
  }
  map();
  new (block_) LiveBlock;
  block_->process = getpid();
}

LiveShare::LiveShare(int descriptor) : descriptor_(descriptor) {
  // Reads only magic and layout: another version may have other members and another size.
  std::array<std::uint64_t, 2> head{};
  if (pread(descriptor, head.data(), sizeof head, 0) != static_cast<ssize_t>(sizeof head) ||
      head[0] != LiveBlock::kMagic) {
    throw Error("--live",
                "descriptor " + std::to_string(descriptor) + " is not the memory of a loop",
                "start the window with palpate view");
  }
  struct stat status {};
  if (head[1] != LiveBlock::kLayout || fstat(descriptor, &status) != 0 ||
      status.st_size != static_cast<off_t>(sizeof(LiveBlock))) {
    throw Error("--live", "the loop belongs to another version of palpate",
                "install palpate and palpate-view of the same release");
  }
  map();
}

LiveShare::~LiveShare() {
  munmap(block_, sizeof(LiveBlock));
}

void LiveShare::map() {
  void* memory =
      mmap(nullptr, sizeof(LiveBlock), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor_.get(), 0);
  if (memory == MAP_FAILED) {
    throw Error(kSubject,
                std::string("the shared memory cannot be mapped: ") + std::strerror(errno),
                "run palpate feel without a window");
  }
  block_ = static_cast<LiveBlock*>(memory);
}

LiveWriter::LiveWriter(LiveBlock& block, double rate)
    : block_(block), every_(std::max<std::int64_t>(1, std::llround(rate / kWholeRate))) {}

void LiveWriter::expect(const Scene& scene, std::span<const LiveDial> dials) {
  auto modes = std::make_shared<Modes>();
  modes->id = scene.id;
  modes->own = scene.graph.mode_names.size();
  modes->told.id = scene.id;
  const auto add = [&told = modes->told, dials](const Graph& graph) {
    for (std::size_t i = 0; i < graph.mode_names.size(); ++i) {
      if (told.mode_count == kLiveModes) return;
      LiveScene::Mode& mode = told.modes[told.mode_count++];
      const std::string& name = graph.mode_names[i];
      std::copy_n(name.begin(), std::min(name.size(), mode.name.size() - 1), mode.name.begin());
      const std::size_t source = graph.mode_sources[i];
      mode.dial = dials.empty() ? LiveDial{static_cast<std::uint32_t>(source)} : dials[source];
    }
  };
  add(scene.graph);
  std::size_t next = modes->own;
  std::map<std::vector<std::size_t>, std::size_t> known;
  for (const Part& part : scene.parts) {
    const auto [place, fresh] = known.try_emplace(part.graph.mode_sources, next);
    modes->of_part.push_back(static_cast<std::uint32_t>(place->second));
    if (!fresh) continue;
    next += part.graph.mode_names.size();
    add(part.graph);
  }
  expected_.draft() = std::move(modes);
  expected_.publish();
}

void LiveWriter::take(const Telemetry& tick, const ProxyState& state) noexcept {
  LiveRow row;
  row.tick = tick.tick;
  row.time = tick.time;
  row.force = static_cast<float>(tick.report.force.norm());
  row.apart = static_cast<float>((tick.probe - tick.report.proxy).norm());
  row.took = 1e-9F * static_cast<float>(tick.tick_ns);
  block_.rows[static_cast<std::size_t>(tick.tick) % kLiveRows].write(row);
  block_.newest.store(tick.tick, std::memory_order_release);
  if (tick.tick % every_ == 0 || tick.fault != told_fault_) tellWhole(tick, state);
}

void LiveWriter::tellWhole(const Telemetry& tick, const ProxyState& state) noexcept {
  told_fault_ = tick.fault;
  const StepReport& r = tick.report;
  whole_.tick = tick.tick;
  whole_.scene = tick.scene;
  whole_.time = tick.time;
  whole_.probe = numbers(tick.probe);
  whole_.proxy = numbers(r.proxy);
  whole_.force = numbers(r.force);
  whole_.stiffness = r.stiffness;
  whole_.error_bound = r.error_bound;
  whole_.late_ticks = tick.late_ticks;
  whole_.status = r.status;
  whole_.fault = tick.fault;
  whole_.limited = r.limited;
  whole_.primitive_count = 0;
  // The loop gets a scene only after expect() has got it, so an unknown scene is already in
  // `expected_`.
  if (!expected_.current() || expected_.current()->id != tick.scene) expected_.refresh();
  const Modes* modes = expected_.current().get();
  const bool known = modes != nullptr && modes->id == tick.scene;
  if (known && told_scene_ != tick.scene) {
    block_.scene.write(modes->told);
    told_scene_ = tick.scene;
  }
  if (known && r.status != StepStatus::kFault) {
    const auto items = state.primitives().items();
    const auto forces = state.forces();
    const auto links = state.primitives().links();
    std::size_t next = 0;
    std::size_t link = 0;
    const auto add = [&](std::size_t mode, const ModeMemory& memory) {
      const std::size_t end =
          std::min(items.size(), next + static_cast<std::size_t>(memory.emitted));
      for (; next < end; ++next) {
        while (link < links.size() && links[link].line < next) ++link;
        if (whole_.primitive_count == kLivePrimitives) continue;
        LivePrimitive& told = whole_.primitives[whole_.primitive_count++];
        told.position = numbers(items[next].position);
        told.direction = numbers(items[next].direction);
        told.force = numbers(forces[next]);
        told.strength = items[next].strength;
        told.kind = items[next].kind;
        told.friction = link < links.size() && links[link].line == next;
        told.mode = static_cast<std::uint16_t>(std::min(mode, kLiveModes));
      }
    };
    for (std::size_t i = 0; i < modes->own; ++i) add(i, state.memory(i));
    for (const std::uint8_t slot : state.near().order()) {
      const NearPart& near = state.near()[slot];
      if (near.part >= modes->of_part.size()) continue;
      for (std::size_t i = 0; i < near.modes; ++i) {
        add(modes->of_part[near.part] + i, near.memories[i]);
      }
    }
  }
  block_.tick.write(whole_);
}

}  // namespace palpate
