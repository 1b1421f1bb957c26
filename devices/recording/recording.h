/// A recording: the inputs and results of a hand's ticks. The file stays readable if the program is
/// killed.
///
/// The file is a sequence of little-endian records of one size. The header is one line of JSON,
/// padded with blanks to whole records. It describes the fields of a record (`dtype`, as in numpy),
/// their units, and the program, device and machine.
///
/// Then come chunks. Each chunk is a mark (ChunkMark), which is itself a record, and the records
/// that the mark announces: ticks, or a scene as text. After the header, a record that is not a
/// tick has a `tick` below zero. In a truncated or damaged file, the complete and undamaged chunks
/// are valid.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/loop/telemetry.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// The record of one tick. The fields cover every byte of the record.
struct RecordedTick {
  std::int64_t tick;               ///< Telemetry::tick.
  std::uint64_t scene;             ///< Telemetry::scene.
  std::int64_t tick_ns;            ///< Telemetry::tick_ns.
  std::int64_t wake_ns;            ///< Telemetry::wake_ns.
  std::int64_t late_ticks;         ///< Number of late ticks until now.
  double time;                     ///< Time since the start of the loop [s].
  double dt;                       ///< TickInput::dt [s].
  double play;                     ///< TickInput::play [s].
  double play_rate;                ///< TickInput::play_rate [s/s].
  std::array<double, 3> pull;      ///< TickInput::pull [N].
  std::array<double, 3> hand;      ///< HandState::position [m].
  std::array<double, 3> velocity;  ///< HandState::velocity [m/s].
  std::array<double, 9> drives;    ///< HandState::drives, column by column.
  double age;                      ///< HandState::age [s].
  double still;                    ///< HandState::still [s].
  double max_speed;                ///< HandState::max_speed [m/s].
  /// Handle::orientation; the next three fields are from Handle too.
  std::array<double, 4> orientation;
  std::array<double, 3> measured_velocity;  ///< Measured by the arm [m/s].
  double gripper;                           ///< Handle::gripper [rad or m].
  std::array<double, kMostJoints> joints;   ///< Handle::joints [rad or m].
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
  std::int32_t iterations;  ///< StepReport::iterations; the next seven are from StepReport too.
  /// Number of readings of properties; a balance follows each.
  std::int32_t substeps;
  std::int32_t samples;              ///< Number of field reads.
  std::int32_t traced;               ///< Number of reads along streams.
  std::int32_t walked;               ///< Number of cells searched for a surface.
  std::int32_t primitives;           ///< Number of primitives in the last balance.
  std::int32_t parts;                ///< StepReport::parts.
  std::int32_t left_out;             ///< StepReport::left_out.
  std::uint32_t buttons;             ///< Handle::buttons.
  std::uint8_t fresh;                ///< StepReport::fresh.
  std::uint8_t ready;                ///< HandState::ready.
  std::uint8_t reported;             ///< HandState::fault.
  std::uint8_t too_fast;             ///< HandState::too_fast.
  std::uint8_t cleared;              ///< TickInput::cleared.
  std::uint8_t wrong;                ///< TickInput::wrong.
  std::uint8_t order;                ///< TickInput::order.
  std::uint8_t unsent;               ///< TickInput::unsent.
  std::uint8_t solver;               ///< StepReport::solver.
  std::uint8_t status;               ///< StepReport::status.
  std::uint8_t limited;              ///< StepReport::limited.
  std::uint8_t missed;               ///< Telemetry::missed.
  std::uint8_t fault;                ///< Telemetry::fault.
  std::uint8_t coarse;               ///< StepReport::coarse; 0 in recordings of version 4.
  std::array<std::uint8_t, 6> zero;  ///< Padding, always zero.
};

/// Returns the record of a tick. RT: no allocation.
[[nodiscard]] RecordedTick recordedTick(const Telemetry& tick) noexcept PALPATE_NONBLOCKING;
/// Returns the tick that a record stores.
[[nodiscard]] Telemetry telemetryOf(const RecordedTick& tick) noexcept;

/// Position and meaning of a field of a recorded tick.
struct RecordedField {
  const char* name;    ///< Name in RecordedTick.
  const char* type;    ///< Type in numpy's notation: <f8, <i8, <u8, <i4, <u4, u1.
  std::size_t count;   ///< Count of numbers in the field.
  std::size_t offset;  ///< Offset in the record [bytes].
  const char* unit;    ///< Empty: the numbers have no unit.
  bool output;         ///< True: a replay of the inputs and scenes determines the field.
};
/// Returns the size of a field [bytes].
[[nodiscard]] constexpr std::size_t sizeOf(const RecordedField& field) noexcept {
  return field.count * (field.type[0] == 'u' ? 1 : static_cast<std::size_t>(field.type[2] - '0'));
}
/// Returns all fields, in order and without a gap.
[[nodiscard]] std::span<const RecordedField> recordedFields() noexcept;

/// A scene that the hand received.
struct RecordedScene {
  std::uint64_t id = 0;  ///< RecordedTick::scene.
  /// JSON that describes the scene's origin; see scenes/apps/cli/recorded.h.
  std::string text;
};

/// Contents of a recording's header. Numbers are read back exactly.
struct RecordedSetting {
  DeviceInfo device;     ///< Device of the hand, with the `limits` that the loop used.
  double rate = 1000.0;  ///< Rate of the loop [Hz].
  /// Text of a JSON object about program, machine and run; empty: {}. Recording::setting() returns
  /// the same object.
  std::string about;
};

/// A recording's file, copied to memory. Truncated or damaged parts are skipped.
class Recording {
 public:
  /// Throws Error if the file cannot be read, is not a recording of format version 4 or 5, or has a
  /// damaged header.
  explicit Recording(const std::filesystem::path& file);
  Recording(const Recording&) = delete;
  Recording& operator=(const Recording&) = delete;
  ~Recording();

  /// Returns the content of the header.
  [[nodiscard]] const RecordedSetting& setting() const noexcept { return setting_; }
  [[nodiscard]] std::int64_t size() const noexcept { return size_; }  ///< Number of ticks.
  /// Returns the i-th tick, 0 <= i < size(). Cost: a binary search among chunks.
  [[nodiscard]] RecordedTick tick(std::int64_t i) const noexcept;
  /// Returns the scenes in the order in which the hand received them.
  [[nodiscard]] const std::vector<RecordedScene>& scenes() const noexcept { return scenes_; }
  /// Returns the size of the damaged chunks [bytes].
  [[nodiscard]] std::size_t damaged() const noexcept { return damaged_; }
  /// Returns the size of the incomplete chunk at the end [bytes].
  [[nodiscard]] std::size_t torn() const noexcept { return torn_; }
  /// Returns the number of ticks that are missing between the first and the last tick in the file.
  [[nodiscard]] std::int64_t lost() const noexcept { return lost_; }
  /// Describes the missing parts; empty if the recording is complete.
  [[nodiscard]] std::string incomplete() const;

 private:
  struct Chunk {
    std::int64_t first = 0;
    std::size_t at = 0;  ///< Offset of the chunk's first tick in the file [bytes].
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

/// Returns true if the file begins like a recording.
[[nodiscard]] bool isRecording(const std::filesystem::path& file) noexcept;

/// Returns the header with which a writer begins a recording.
[[nodiscard]] std::string recordingHeader(const RecordedSetting& setting);
/// Returns the bytes of the chunks of these ticks, at most 1,024 ticks each. `ticks` is not empty,
/// and the numbers of its ticks rise from 1 or more.
[[nodiscard]] std::string recordingChunk(std::span<const RecordedTick> ticks);
/// Returns the bytes of the chunk of a scene.
[[nodiscard]] std::string recordingChunk(const RecordedScene& scene);

}  // namespace palpate
