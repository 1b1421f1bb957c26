/// A recording: all that a hand's ticks were given and came to, in a file that a killed program
/// leaves readable.
///
/// The file is a row of records of one size, kept little-endian. A header: one line of JSON, filled
/// up with blanks, that says what is in a record (`dtype`, as numpy has it), in which units, and of
/// which program, device and machine it is. Then chunks, each a record of its own (ChunkMark) and
/// what it announces: rows, or a scene as text. What is no row has a `tick` below zero. Files only
/// grow; of one that was torn off or damaged the whole chunks count.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/device.h"
#include "palpate/engine/telemetry.h"

namespace palpate {

/// One tick. Every byte of it is told.
struct RecordedTick {
  std::int64_t tick;                        ///< Telemetry::tick.
  std::uint64_t scene;                      ///< Telemetry::scene.
  std::int64_t tick_ns;                     ///< Time that the tick took [ns].
  std::int64_t wake_ns;                     ///< How late it began [ns].
  std::int64_t late_ticks;                  ///< Missed ticks so far.
  double time;                              ///< Since the start [s].
  double dt;                                ///< TickInput::dt [s].
  double play;                              ///< TickInput::play [s].
  double play_rate;                         ///< TickInput::play_rate [s/s].
  std::array<double, 3> pull;               ///< TickInput::pull [N].
  std::array<double, 3> hand;               ///< HandState::position [m].
  std::array<double, 3> velocity;           ///< HandState::velocity [m/s].
  std::array<double, 9> drives;             ///< HandState::drives, by columns.
  double age;                               ///< HandState::age [s].
  double still;                             ///< HandState::still [s].
  double max_speed;                         ///< HandState::max_speed [m/s].
  std::array<double, 4> orientation;        ///< Handle::orientation, as all of the next three.
  std::array<double, 3> measured_velocity;  ///< [m/s]
  double gripper;                           ///< [rad]
  std::array<double, kMostJoints> joints;   ///< [rad]
  double given;                             ///< TickInput::given.
  std::array<double, 3> force;              ///< StepReport::force [N].
  std::array<double, 3> wanted;             ///< StepReport::wanted [N].
  std::array<double, 3> proxy;              ///< StepReport::proxy [m].
  std::array<double, 3> waiting;            ///< StepReport::waiting [m].
  double stiffness;                         ///< StepReport::stiffness [N/m].
  double error_bound;                       ///< StepReport::error_bound [m].
  double injected;                          ///< StepReport::injected [J].
  double missing;                           ///< StepReport::missing [N].
  double moving;                            ///< StepReport::moving.
  double share;                             ///< StepReport::share.
  double energy;                            ///< StepReport::energy [J].
  double left;                              ///< StepReport::left.
  std::int32_t iterations;                  ///< StepReport's, as all of the next seven.
  std::int32_t substeps;                    ///< Readings.
  std::int32_t samples;                     ///< Field reads.
  std::int32_t traced;                      ///< Reads along streams.
  std::int32_t walked;                      ///< Cells.
  std::int32_t primitives;                  ///< Of the last balance.
  std::int32_t parts;                       ///< That were near.
  std::int32_t left_out;                    ///< That were near and had no room.
  std::uint32_t buttons;                    ///< Handle::buttons.
  std::uint8_t fresh;                       ///< StepReport::fresh.
  std::uint8_t ready;                       ///< HandState::ready.
  std::uint8_t reported;                    ///< HandState::fault.
  std::uint8_t too_fast;                    ///< HandState::too_fast.
  std::uint8_t cleared;                     ///< TickInput::cleared.
  std::uint8_t wrong;                       ///< TickInput::wrong.
  std::uint8_t order;                       ///< TickInput::order.
  std::uint8_t unsent;                      ///< TickInput::unsent.
  std::uint8_t solver;                      ///< StepReport::solver.
  std::uint8_t status;                      ///< StepReport::status.
  std::uint8_t limited;                     ///< StepReport::limited.
  std::uint8_t missed;                      ///< Telemetry::missed.
  std::uint8_t fault;                       ///< Telemetry::fault.
  std::array<std::uint8_t, 7> zero;         ///< Zeros.
};

/// RT: no allocation.
[[nodiscard]] RecordedTick recordedTick(const Telemetry& tick) noexcept PALPATE_NONBLOCKING;
/// The same tick again, all of it.
[[nodiscard]] Telemetry telemetryOf(const RecordedTick& tick) noexcept;

/// Where a field of a recorded tick is, and what it is.
struct RecordedField {
  const char* name;    ///< As RecordedTick has it.
  const char* type;    ///< numpy's: <f8, <i8, <u8, <i4, u1.
  std::size_t count;   ///< Numbers in it.
  std::size_t offset;  ///< [bytes]
  const char* unit;    ///< Empty: a number without one.
  bool output;         ///< Decided by the inputs and the scenes.
};
/// Its bytes.
[[nodiscard]] constexpr std::size_t sizeOf(const RecordedField& field) noexcept {
  return field.count * (field.type[0] == 'u' ? 1 : static_cast<std::size_t>(field.type[2] - '0'));
}
/// All of them, in order and without a gap.
[[nodiscard]] std::span<const RecordedField> recordedFields() noexcept;

/// A scene that became the hand's.
struct RecordedScene {
  std::uint64_t id = 0;  ///< RecordedTick::scene.
  std::string text;      ///< JSON: what it was made of; scenes/recorded.h.
};

/// What a recording is told in its header; numbers are exact.
struct RecordedSetting {
  DeviceInfo device;     ///< Of the hand; its `limits` as the loop had them.
  double rate = 1000.0;  ///< [Hz]
  std::string about;     ///< JSON object: program, machine and whatever else; opaque here.
};

/// A recording's file in memory, copied; what is torn off or damaged is left out.
class Recording {
 public:
  /// Throws Error: it cannot be read, or is no recording of this version.
  explicit Recording(const std::filesystem::path& file);
  Recording(const Recording&) = delete;
  Recording& operator=(const Recording&) = delete;
  ~Recording();

  /// What its header tells.
  [[nodiscard]] const RecordedSetting& setting() const noexcept { return setting_; }
  [[nodiscard]] std::int64_t size() const noexcept { return size_; }  ///< Ticks.
  /// The i-th tick, i < size(). Cost: a search among chunks.
  [[nodiscard]] RecordedTick tick(std::int64_t i) const noexcept;
  /// In the order in which they became the hand's.
  [[nodiscard]] const std::vector<RecordedScene>& scenes() const noexcept { return scenes_; }
  /// Bytes of chunks that are damaged, before whole ones,
  [[nodiscard]] std::size_t damaged() const noexcept { return damaged_; }
  /// and bytes behind the last whole one.
  [[nodiscard]] std::size_t torn() const noexcept { return torn_; }
  /// Ticks between its first and its last that did not get into the file.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }
  /// What is missing, in words; empty: nothing is.
  [[nodiscard]] std::string incomplete() const;

 private:
  struct Chunk {
    std::int64_t first = 0;  ///< Index of its first tick.
    std::size_t at = 0;      ///< Of that in the file [bytes].
  };

  std::span<const std::byte> bytes_;
  RecordedSetting setting_;
  std::vector<Chunk> chunks_;
  std::vector<RecordedScene> scenes_;
  std::int64_t size_ = 0;
  std::size_t damaged_ = 0;
  std::size_t torn_ = 0;
  std::int64_t lost_ = 0;
};

/// True where a file begins as recordings do.
[[nodiscard]] bool isRecording(const std::filesystem::path& file) noexcept;

/// The pieces of a file, for whoever writes one: the header,
[[nodiscard]] std::string recordingHeader(const RecordedSetting& setting);
/// chunks of ticks (not empty, with numbers that rise), of at most 1,024 each,
[[nodiscard]] std::string recordingChunk(std::span<const RecordedTick> ticks);
/// and one with a scene.
[[nodiscard]] std::string recordingChunk(const RecordedScene& scene);

}  // namespace palpate
