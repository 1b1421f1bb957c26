/// Private to devices: the connection to Haply's Inverse Service, on a thread of its own, for all
/// arms of the process.
///
/// The service sends one state for each message that it receives. So the thread sends the newest
/// forces again and again. While an arm is open, the next message follows kPeriod after the last
/// one if that was answered, else kAskAgain after it. At most three messages wait for an answer.
///
/// A force is sent while three conditions hold: it is younger than kForceHolds; the arm's last
/// valid position came less than kSilence ago; a zero force was written since the last stop(),
/// silence or lost connection. Otherwise the next message has zero force.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "palpate/devices/plugins/haply_messages.h"
#include "palpate/engine/loop/mailbox.h"

struct lws;
struct lws_context;

namespace palpate::haply {

/// Largest age of a force that is sent, by the host's clock [ns]. A test may replace that clock.
inline constexpr std::int64_t kForceHolds = 40'000'000;
/// Time without a valid position until the force is zero, by the host's clock [ns].
inline constexpr std::int64_t kSilence = 30'000'000;
/// Shortest time between two messages if the first was answered [ns]. This time and the next three
/// are measured by the machine's clock.
inline constexpr std::int64_t kPeriod = 500'000;
/// Time between two messages if the first was not answered [ns].
inline constexpr std::int64_t kAskAgain = 5'000'000;
/// Time between two messages while no arm is open, or while the generation is unknown or k30 [ns].
inline constexpr std::int64_t kAskForArms = 250'000'000;
/// Time until the next attempt to connect [ns].
inline constexpr std::int64_t kTryAgain = 100'000'000;

/// A reading of an arm, in the service's axes.
struct Reading {
  std::int64_t taken = 0;  ///< Arrival time of its message, by the host's clock [ns].
  ArmState arm;
  GripState grip;
};

struct Order {
  Triple force_D{};
  std::int64_t when = 0;           ///< Time of the write, by the host's clock [ns].
  std::uint64_t acknowledged = 1;  ///< Value of Line::stops when the host last wrote zero force.
};

/// The data of an open arm that the threads share.
struct Line {
  Mailbox<Reading> readings;  ///< Service thread to haptic thread.
  Mailbox<Order> orders;      ///< Haptic thread to service thread.
  DeviceId id;
  /// 1 plus the number of stops and losses. After each, the force is off until zero is written.
  std::atomic<std::uint64_t> stops{1};
  /// Value of `stops` when the force of the last sent message was chosen.
  std::atomic<std::uint64_t> obeyed{0};
  std::atomic<std::uint64_t> losses{0};  ///< Number of silences of the arm and lost connections.
  std::atomic<int> powered{-1};  ///< ArmState::powered of the last message that contained it.
  std::atomic<int> ready{-1};
  std::atomic<int> calibrated{-1};
  std::atomic<bool> away{true};  ///< The arm is silent, or the connection is down.
  /// Set by the owner: the thread sends zero force, then releases the arm.
  std::atomic<bool> leaves{false};
  std::atomic<bool> left{false};  ///< The service thread no longer refers to this line.

  // Used by the service thread only.
  bool told_zero = false;      ///< A message without force was sent after `leaves`.
  std::int64_t leaves_at = 0;  ///< Time when the thread first saw `leaves` [ns].
  long told_in = 0;            ///< Index of the message that carried this zero force.
  std::int64_t heard = 0;      ///< Time of the last valid position, by the host's clock [ns].
};

struct Named {
  DeviceId id;
  ArmConfig config;
};

struct Inventory {
  bool connected = false;
  bool answered = false;  ///< At least one list of devices has arrived.
  int refusals = 0;
  Generation generation = Generation::kUnknown;
  std::vector<Named> arms;
  int button_count = 0;  ///< Largest number of buttons of a handle.
  bool grips = false;    ///< At least one handle reports its orientation.
};

struct Address {
  std::string host = "127.0.0.1";
  int port = 10001;
  std::string path = "/";
  std::string words = "ws://localhost:10001";  ///< The address shown to the user.
};

/// Parses ws://HOST[:PORT][/PATH]. HOST must be this machine (localhost, 127.0.0.1, [::1]) unless
/// `anywhere` is set. On failure returns false and sets `why` to the cause and the remedy.
bool readUrl(const std::string& url, bool anywhere, Address& out, std::string& why);

/// The connection. Construct, use and destroy it on the main thread.
class Service {
 public:
  /// @param now  The host's clock; called on the service thread.
  Service(Address address, std::int64_t (*now)());
  ~Service();
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  [[nodiscard]] Inventory inventory();
  /// Returns false if kMaxArms arms are served already. `line` must live until release() returns.
  bool serve(Line& line);
  /// Removes an arm. First sends zero force, if connected, and waits at most 1 s for the answer.
  void release(Line& line);

  /// Callbacks of libwebsockets, on the service thread.
  int connected();
  void disconnected();
  void received(const char* bytes, std::size_t size, bool is_text, bool last);
  int writable(lws* to);

 private:
  void run();
  void connect(lws_context* context, std::int64_t machine);
  void message(std::string_view bytes);
  void attend(std::int64_t machine);
  [[nodiscard]] Triple wanted(Line& line, std::int64_t now) const;
  static void lose(Line& line);
  void letGo(std::int64_t machine);

  const Address address_;
  std::int64_t (*const now_)();
  std::atomic<bool> ends_{false};
  std::array<std::atomic<Line*>, kMaxArms> lines_{};
  std::mutex mutex_;  ///< Guards inventory_, which the main thread and the service thread use.
  Inventory inventory_;

  // Used by the service thread only.
  lws* wsi_ = nullptr;
  bool up_ = false;
  bool introduced_ = false;
  bool answered_ = false;  ///< The last message was answered.
  long asked_ = 0;
  long got_ = 0;
  std::int64_t answered_at_ = 0;  ///< Time of the last answer [ns].
  Generation generation_ = Generation::kUnknown;
  std::int64_t tried_ = 0;
  std::int64_t sent_ = 0;
  std::string partial_;
  bool too_long_ = false;
  Message in_;
  std::thread thread_;
};

}  // namespace palpate::haply
