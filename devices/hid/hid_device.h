/// An arm on a HID device, described by a profile.
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

#include "palpate/devices/arm/arm.h"
#include "palpate/devices/arm/motor_heat.h"
#include "palpate/devices/hid/hid_input.h"
#include "palpate/devices/hid/hid_port.h"
#include "palpate/devices/hid/hid_profile.h"
#include "palpate/engine/loop/mailbox.h"

namespace palpate {

/// Functions and settings that an arm on a HID device needs from its program. The functions may be
/// empty.
struct HidHost : ArmHost {
  /// Finds the device again by its vendor and product numbers and its serial number or port;
  /// returns null, or throws, while it is absent. Not called in a tick.
  std::function<std::unique_ptr<ReportPort>()> find = nullptr;
};

/// Counts of writes.
struct HidWrites {
  /// Reports that were given to the port, including those that it refused.
  std::int64_t count = 0;
  /// Forces that were reduced, with their direction kept, because of a motor's limit or heat.
  std::int64_t weakened = 0;
  std::int64_t longest_ns = 0;  ///< Longest time that the port took to send one report [ns].
};

/// Reads and drives an arm. The haptic thread calls read() and write(). A second thread sends the
/// newest force, because sending blocks. It sends at most one report a tick and, on average, at
/// most output_rate reports a second; a report that ends a force does not wait. A third thread
/// finds the device again after it was unplugged.
///
/// The kernel keeps the OLDEST 63 reports. If 60 or more wait, HidDevice discards them as old.
/// After a pause of more than HidLimits::stale without read(), the arm is not ready until a new
/// report comes. A device with rate control stays ready.
///
/// Faults:
/// - Fault::kGone: the device is absent, or has refused a report.
/// - Fault::kMiscounted, before kGone: counters may have wrapped unnoticed.
/// - Fault::kWrite: a force waits, and nothing was sent for 20 ms plus a period of output_rate.
/// - Fault::kStale: a report with flags is too old.
/// - Fault::kTemperature, kPower, kSwitch: a flag of the profile reports this state.
///
/// An arm that is not homed, not enabled or out of reach is not ready, nor is an arm whose position
/// or flags have not come yet.
class HidDevice final : public Arm {
 public:
  /// Runs the profile's "open" steps, waits for a position, and runs the "home" steps, on this
  /// thread (slow). A device with rate control needs no position. If one of these fails, runs the
  /// "close" steps and throws DeviceError with the problem in words.
  ///
  /// @param tested  True: the arm has passed `palpate devices --test`. False: the limits of an arm
  ///                with motors are at most kUntestedForce and kUntestedStiffness.
  HidDevice(HidProfile profile, std::unique_ptr<ReportPort> port, bool tested, HidHost host = {});
  /// Sends zero force, then runs the profile's "close" steps, which wait at most kLongestClose.
  ~HidDevice() override;

  /// Returns the profile's limits, or those of an untested arm. They never change.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  void carry(bool may) noexcept override {
    carries_ = may;
    if (!may) carried_share_ = 0.0;
  }
  [[nodiscard]] double given() const noexcept override { return given_; }
  [[nodiscard]] ZeroForce zeroForce() const noexcept override;

  /// Returns the profile that was passed to the constructor.
  [[nodiscard]] const HidProfile& profile() const noexcept { return profile_; }
  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] std::string whyNotReady() const override;
  [[nodiscard]] std::vector<double> steps() const override;
  [[nodiscard]] ArmTraffic traffic() const override {
    return {input_.counts().dropped, count_, longest_ns_};
  }
  /// Returns the tip's travel for one count of each joint, at the last reading [m].
  [[nodiscard]] std::array<double, kMostJoints> resolution() const noexcept;
  /// Returns the counts of reports. Call it on the thread that reads, or after its end.
  [[nodiscard]] const HidInput::Counts& reads() const noexcept { return input_.counts(); }
  /// Returns the counts since the opening. Reports that prepare or close the device do not count.
  /// Callable from any thread.
  [[nodiscard]] HidWrites writes() const noexcept { return {count_, weakened_, longest_ns_}; }
  /// Returns how often the device was opened: at the construction, and each time it was found
  /// again.
  [[nodiscard]] std::uint32_t pluggings() const noexcept { return plugging_; }

 private:
  static constexpr std::int64_t kNever = -1;
  struct Outgoing {
    std::array<std::byte, 1025> bytes{};
  };
  /// Prevents the thread that closes ports from closing this port while this object exists.
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

  void begin();
  /// Sets the time of each report that came during the preparation to `now` [ns].
  void knowFlags(std::int64_t now) noexcept;
  void endThreads() noexcept;
  void prepare(ReportPort& port, HidInput& input);
  /// Sends zero force and runs the "close" steps. Ignores failures, because the device may be
  /// absent.
  void leave(ReportPort& port, HidInput& input) noexcept;
  /// Runs the steps of a sequence. If a step waits for an action of the user, an earlier action
  /// does not count. Calls `stop` before each step, and while a step waits or pauses. Throws
  /// DeviceError.
  void runSequence(ReportPort& port, HidInput& input, const std::vector<HidStep>& steps,
                   const std::function<bool()>& stop);
  /// Throws DeviceError if the field does not get its value in time, if the device is gone, or if
  /// `stop` returns true.
  void waitFor(ReportPort& port, HidInput& input, const HidStep& step,
               const std::function<bool()>& stop);
  /// Sets `hand.fault` if the device is absent, or if its counters may have wrapped unnoticed.
  void readReports(std::int64_t now, double dt, HandState& hand) noexcept;
  void adoptMended(std::int64_t now) noexcept;
  /// Makes the arm wait for new reports after a pause.
  void forgetReports(std::int64_t now) noexcept;
  void forgetCounters() noexcept;
  void lookAtHandle() noexcept;
  void applyFlags(HandState& hand) noexcept;
  /// Sets Fault::kStale if a report with flags is too old. Sets `hand` not ready if such a report
  /// has not come yet.
  void lookAtFlags(std::int64_t now, HandState& hand) noexcept;
  /// Sets a fault if a force waits too long, in the writer thread or in a write.
  void lookAtWrites(std::int64_t now, HandState& hand) noexcept;
  [[nodiscard]] ArmDissipation dissipation() const noexcept;
  /// Returns true if the joints' counters cannot have wrapped unnoticed during a pause [s].
  [[nodiscard]] bool countedOn(double pause) const noexcept;
  void follow(double dt) noexcept;
  void lookForMotion(std::int64_t now) noexcept;
  [[nodiscard]] Mat3 drivesHere() const noexcept;
  /// Returns true for devices that send no reports while they rest.
  [[nodiscard]] bool silent() const noexcept { return profile_.rate_control > 0.0; }
  void encode(const Vec3& force_W, std::span<std::byte> report) noexcept;
  /// Advances the motors' heat. Returns the time since the last write [s], 0 at the first.
  double heatMotors() noexcept;
  /// Returns the motors' raw values that carry the permitted share of the arm's weight.
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

  /// Only the thread that finds the device again changes it.
  std::unique_ptr<ReportPort> port_;
  std::atomic<ReportPort*> open_port_{nullptr};  ///< Null while the device is absent.
  std::atomic<bool> reading_{false};
  std::atomic<bool> writing_{false};
  std::atomic<bool> gone_{false};
  /// The counters may have wrapped. The device is then treated as absent.
  std::atomic<bool> miscounted_{false};
  std::atomic<bool> quit_{false};
  /// Guardian's descriptor; its number stays the same when the device changes.
  std::atomic<int> guard_{-1};
  std::atomic<std::uint32_t> plugging_{1};

  // `mended_` is used by the thread that finds the device again, then by the haptic thread.
  HidInput mended_;
  /// The arm has miscounted, and only the user can bring it to its home pose.
  bool homeless_ = false;

  // Members for the haptic thread only.
  HidInput input_;
  std::vector<Unwrapped> counters_;
  /// For counters that wrap: raw value to which the first reading must be nearest.
  std::vector<double> about_;
  bool ticked_ = false;
  /// If the profile has home_at_open: raw values of the joints' fields in the home pose.
  std::vector<double> home_raw_;
  std::vector<bool> flags_in_;  ///< For each report: true if its flags can become stale.
  /// For each report: time at which it last came [ns], or kNever.
  std::vector<std::int64_t> flags_at_;
  bool heard_ = false;
  std::uint32_t plugging_seen_ = 1;
  std::int64_t heard_at_ = 0;    ///< Time of the last position, or of a later pause [ns].
  std::int64_t counted_at_ = 0;  ///< Time of the last update of `joints_` [ns].
  std::int64_t read_at_ = 0;     ///< Time of the last call of read() [ns].
  /// All reports with a joint have a counter, by which a repeated report is recognised.
  bool numbered_ = false;
  std::vector<double> counts_;
  /// Time of the last change of a count that moves the tip, or of a later pause [ns].
  std::int64_t moved_at_ = 0;
  Joints joints_{};
  ArmPose pose_;
  Mat3 drives_W_ = Mat3::Identity();  ///< ProfileFacts::drives, in W.
  std::vector<std::size_t> undriven_;
  Vec3 position_W_ = Vec3::Zero();
  Handle handle_;
  double given_ = 1.0;
  std::vector<MotorHeat> heat_;
  double cool_ = 1.0;         ///< Share of the force that the motors' heat permits.
  std::int64_t told_at_ = 0;  ///< Time of the last write() [ns]; 0: never.
  bool tested_;
  bool carries_ = false;  ///< carry() permits the motors to carry the arm's weight.
  /// The last reading permits the motors to carry the arm's weight.
  bool upright_ = false;
  double carried_share_ = 0.0;  ///< Share of the weight that is carried so far.
  std::uint32_t written_seen_ = 0;
  /// Time of the writer's last progress [ns]: written_ changed, or a first force began to wait.
  std::int64_t written_at_ = 0;

  Mailbox<Outgoing> out_;
  std::atomic<bool> rests_{false};  ///< The last published report drives no motor.
  std::atomic<std::uint32_t> sent_{0};
  /// Value of sent_ for the last report that the writer has finished: sent, or failed to send.
  std::atomic<std::uint32_t> written_{0};
  std::atomic<std::int64_t> count_{0}, weakened_{0}, longest_ns_{0};

  std::thread writer_;
  std::thread mender_;
  /// No tick locks it. The thread that finds the device again waits with it.
  std::mutex mend_mutex_;
  std::condition_variable mend_;
};

}  // namespace palpate
