/// An arm on a HID device, by its profile.
#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "palpate/devices/arm.h"
#include "palpate/devices/hid_port.h"
#include "palpate/devices/hid_profile.h"
#include "palpate/devices/motor_heat.h"
#include "palpate/engine/mailbox.h"

namespace palpate {

/// The newest numbers that a device has sent. One thread.
class HidInput {
 public:
  explicit HidInput(const HidProfile& profile);  ///< Keeps a reference to it. Allocates.

  /// Takes all that waits. kReport: every report that a joint comes from is new; kNothing also
  /// where the ring had overflowed, so
  /// that all was old. RT: as ReportPort::read.
  [[nodiscard]] Got takeNewest(ReportPort& port) noexcept PALPATE_NONBLOCKING;
  /// Whether one has come since forget(), and none was lost after it.
  [[nodiscard]] bool known(std::size_t report) const noexcept { return known_[report]; }
  /// Whether one was among what takeNewest has taken last.
  [[nodiscard]] bool came(std::size_t report) const noexcept { return came_[report]; }
  /// Raw, as last taken; before that 0, of rate control the puck at rest. The same for all fields
  /// where there are several reports.
  [[nodiscard]] double raw(const FieldRef& field) const noexcept {
    return values_[first_[field.report] + field.field];
  }

  /// As before the first report; what is counted stays.
  void forget() noexcept;
  /// What another of the same profile has taken. RT: no allocation.
  void adopt(const HidInput& other) noexcept;

  /// Reports since it was made, by what became of them.
  struct Counts {
    std::int64_t reports = 0;    ///< Used.
    std::int64_t taken = 0;      ///< Of any kind that the profile knows.
    std::int64_t passed_by = 0;  ///< Not used: a newer one waited.
    std::int64_t dropped = 0;    ///< Of rings that had overflowed.
    std::int64_t strange = 0;    ///< Too short, or of no number that the profile knows.
    std::int64_t repeated = 0;   ///< Sent again, by HidReportSpec::sequence.
  };
  [[nodiscard]] const Counts& counts() const noexcept { return counts_; }  ///< So far.

 private:
  enum class Taken : std::uint8_t { kUsed, kStrange, kRepeated };
  [[nodiscard]] Taken take(std::span<const std::byte> report) noexcept;

  const HidProfile& profile_;
  std::size_t head_ = 0;            ///< Bytes of numbers before a report: 1 where there are any.
  std::vector<std::size_t> first_;  ///< Of a report's fields in values_.
  std::vector<double> values_;
  std::vector<bool> joints_in_;  ///< A report has a joint's field ...
  std::vector<bool> fresh_;      ///< ... and has come since the last kReport.
  std::vector<bool> came_;       ///< In the last takeNewest.
  std::vector<bool> known_;      ///< Of each report one has come.
  Counts counts_;
  std::array<std::byte, 2048> buffer_{};
};

/// What an arm on a HID device asks of the program that opens it. All may be empty.
struct HidHost : ArmHost {
  /// Where to find the device again, by its numbers; null while it is not there. Never in a tick.
  std::function<std::unique_ptr<ReportPort>()> find = nullptr;
};

/// What has been sent.
struct HidWrites {
  std::int64_t count = 0;       ///< Reports given to the port, those that it refused among them.
  std::int64_t weakened = 0;    ///< Forces that a motor's limit, or its heat, has made smaller,
                                ///< direction kept.
  std::int64_t longest_ns = 0;  ///< Of one, until the port was done with it [ns].
};

/// Reads and drives an arm. The haptic thread has read() and write(); a thread of its own sends the
/// newest force, one report a tick, since sending waits for the wire, and no more a second than the
/// profile's output_rate; another finds the device again when it has been unplugged.
///
/// The kernel keeps the OLDEST 63 reports: where so many wait, all are old, and thrown away. Where
/// nobody has read for longer than HidLimits::stale the arm is not ready until a fresh one comes.
///
/// A device that is gone is Fault::kGone until it is back, one whose counters may have gone round
/// unseen Fault::kMiscounted first, where no force has gone out for 20 ms beyond a period of the
/// output's rate although one was to Fault::kWrite, an arm that is not homed, not enabled or beyond
/// its own reach is not ready.
class HidDevice final : public Arm {
 public:
  /// Runs the profile's "open" and "home" (slow), on this thread, and "close" where they fail.
  /// Throws DeviceError: what is wrong, in words.
  ///
  /// @param tested  It has passed `palpate devices --test`; else kUntestedForce and
  ///                kUntestedStiffness hold.
  HidDevice(HidProfile profile, std::unique_ptr<ReportPort> port, bool tested, HidHost host = {});
  /// Zero force, then the profile's "close" (at most kLongestClose).
  ~HidDevice() override;

  /// By the profile's limits, those of an untested arm where it is one; never changes.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  void carry(bool may) noexcept override {
    carries_ = may;
    if (!may) carried_share_ = 0.0;
  }
  [[nodiscard]] double given() const noexcept override { return given_; }
  [[nodiscard]] ZeroForce zeroForce() const noexcept override;

  [[nodiscard]] const HidProfile& profile() const noexcept { return profile_; }  ///< As given.
  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] std::string whyNotReady() const override;
  [[nodiscard]] std::vector<double> steps() const override;
  [[nodiscard]] ArmTraffic traffic() const override {
    return {input_.counts().dropped, count_, longest_ns_};
  }
  /// The tip's step for one count of each joint, at the last reading [m].
  [[nodiscard]] std::array<double, kMostJoints> resolution() const noexcept;
  /// On the thread that reads, or when it has ended.
  [[nodiscard]] const HidInput::Counts& reads() const noexcept { return input_.counts(); }
  /// Since the opening; what the steps of the profile send does not count. From any thread.
  [[nodiscard]] HidWrites writes() const noexcept { return {count_, weakened_, longest_ns_}; }
  /// How often it has been plugged in since, the first time included.
  [[nodiscard]] std::uint32_t pluggings() const noexcept { return plugging_; }

 private:
  static constexpr std::int64_t kNever = -1;
  struct Outgoing {
    std::array<std::byte, 1025> bytes{};
  };
  /// Keeps the port from being closed while it is used.
  class Using {
   public:
    Using(std::atomic<ReportPort*>& port, std::atomic<bool>& in) noexcept : in_(in) {
      in_.store(true);
      port_ = port.load();
    }
    Using(const Using&) = delete;
    Using& operator=(const Using&) = delete;
    ~Using() { in_.store(false); }
    [[nodiscard]] ReportPort* operator->() const noexcept { return port_; }
    [[nodiscard]] ReportPort& operator*() const noexcept { return *port_; }
    explicit operator bool() const noexcept { return port_ != nullptr; }

   private:
    std::atomic<bool>& in_;
    ReportPort* port_;
  };

  /// The rest of the opening, once the arm is prepared.
  void begin();
  /// What has come while it was prepared counts from now on.
  void knowFlags(std::int64_t now) noexcept;
  void endThreads() noexcept;
  /// What a device needs before it is felt. Throws DeviceError.
  void prepare(ReportPort& port, HidInput& input);
  /// Zero force and what it needs afterwards. Of a device that is gone nothing is left to do.
  void leave(ReportPort& port, HidInput& input) noexcept;
  /// @param stop  Asked between two steps, and while one waits.
  /// A step that waits for what the user does waits for him to do it, not for what he did before.
  void runSequence(ReportPort& port, HidInput& input, const std::vector<HidStep>& steps,
                   const std::function<bool()>& stop);
  /// Until a field has its value. Throws DeviceError: it has not come to that.
  void waitFor(ReportPort& port, HidInput& input, const HidStep& step,
               const std::function<bool()>& stop);
  /// What the arm says beside where its tip is.
  void lookAtHandle() noexcept;
  /// No flag of a report is older than it may be; `hand` is stale, or not ready, where one is.
  void lookAtFlags(std::int64_t now, HandState& hand) noexcept;
  /// No force waits for longer than it may, in its writer or in a write.
  void lookAtWrites(std::int64_t now, HandState& hand) noexcept;
  /// What the energy tank may rely on, in the pose that it is in.
  [[nodiscard]] ArmDissipation dissipation() const noexcept;
  /// After such a pause the counters of joints can still be followed [s].
  [[nodiscard]] bool countedOn(double pause) const noexcept;
  void follow(double dt) noexcept;
  void lookForMotion(std::int64_t now) noexcept;
  /// HandState::drives, in the pose that it is in.
  [[nodiscard]] Mat3 drivesHere() const noexcept;
  /// True for devices that say nothing while they rest.
  [[nodiscard]] bool silent() const noexcept { return profile_.rate_control > 0.0; }
  void encode(const Vec3& force_W, std::span<std::byte> report) noexcept;
  /// Lets the motors' heat follow what they were told until now; returns how long that was [s].
  double heatMotors() noexcept;
  /// What motors give to carry the arm's weight, raw, within their limits.
  [[nodiscard]] std::array<double, kMostJoints> carried() const noexcept;
  void lost() noexcept;
  void writeLoop() noexcept;
  void mendLoop() noexcept;
  void closePort() noexcept;

  HidProfile profile_;
  DeviceInfo info_;
  ArmTraits traits_;
  HidHost host_;
  std::vector<std::byte> zero_;  ///< The report that drives no motor.

  std::unique_ptr<ReportPort> port_;             ///< Changed by the mending thread only.
  std::atomic<ReportPort*> open_port_{nullptr};  ///< Null while there is none.
  std::atomic<bool> reading_{false};
  std::atomic<bool> writing_{false};
  std::atomic<bool> gone_{false};
  std::atomic<bool> miscounted_{false};  ///< Gone since its counters cannot be followed.
  std::atomic<bool> quit_{false};
  std::atomic<int> guard_{-1};  ///< Its number stays, whatever it leads to.
  std::atomic<std::uint32_t> plugging_{1};

  // The mending thread's; read when it is done.
  HidInput mended_;
  bool homeless_ = false;  ///< Only its user can say where it is.

  // The haptic thread's.
  HidInput input_;
  std::vector<Unwrapped> counters_;     ///< Of joints.
  std::vector<double> about_;           ///< Of counters that wrap, the raw number that the first is
                                        ///< nearest to: the middle of the hand's world, or home.
  bool ticked_ = false;                 ///< read() has been called.
  std::vector<double> home_raw_;        ///< Of joints at home, where they are homed at the opening.
  std::vector<bool> flags_in_;          ///< A report has a flag,
  std::vector<std::int64_t> flags_at_;  ///< and came last then [ns]; kNever: not since the opening.
  bool heard_ = false;                  ///< A report has come since the last opening.
  std::uint32_t plugging_seen_ = 1;
  std::int64_t heard_at_ = 0;    ///< [ns]
  std::int64_t counted_at_ = 0;  ///< [ns], the last report that moved the joints.
  std::int64_t read_at_ = 0;     ///< [ns], last call of read().
  bool numbered_ = false;        ///< A report that is sent again is known as that.
  std::vector<double> counts_;   ///< Of joints, raw, at the last reading,
  std::int64_t moved_at_ = 0;    ///< and when any of them changed last [ns].
  Joints joints_{};
  ArmPose pose_;
  Mat3 drives_W_ = Mat3::Identity();   ///< ProfileFacts::drives.
  std::vector<std::size_t> undriven_;  ///< Joints that move the tip and have no motor.
  Vec3 position_W_ = Vec3::Zero();
  Handle handle_;
  double given_ = 1.0;
  std::vector<MotorHeat> heat_;  ///< Of joints' motors.
  double cool_ = 1.0;            ///< Share of the force that their heat leaves.
  std::int64_t told_at_ = 0;     ///< [ns], last call of write(); 0: none yet.
  bool tested_;
  bool carries_ = false;            ///< carry() has allowed it,
  bool upright_ = false;            ///< and so has the last reading.
  double carried_share_ = 0.0;      ///< Of the weight, that is carried yet.
  std::uint32_t written_seen_ = 0;  ///< Of written_,
  std::int64_t written_at_ = 0;     ///< and since when that is so while more is sent [ns].

  Mailbox<Outgoing> out_;
  std::atomic<bool> rests_{false};         ///< What was published last drives no motor.
  std::atomic<std::uint32_t> sent_{0};     ///< Counts what is published,
  std::atomic<std::uint32_t> written_{0};  ///< and what the writer is done with.
  std::atomic<std::int64_t> count_{0}, weakened_{0}, longest_ns_{0};

  std::thread writer_;
  std::thread mender_;
  std::mutex mend_mutex_;  ///< The mending thread's sleep; no tick touches it.
  std::condition_variable mend_;
};

}  // namespace palpate
