/// Private to devices: the connection to Haply's Inverse Service. A process has one connection for
/// all its arms, on a thread of its own.
///
/// The service sends one state for each message that it receives. So the thread keeps sending the
/// newest forces, as soon as the last message is answered and at most once per kPeriod. The haptic
/// thread reads and writes through mailboxes.
///
/// A force is sent while three conditions hold: it was written less than kForceHolds ago; the last
/// valid position of the arm arrived less than kSilence ago; a zero force was written since the
/// last stop() or silence. Otherwise the thread sends zero at once.
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

/// These two use the host's clock, which may be a test's clock.
inline constexpr std::int64_t kForceHolds = 40'000'000;  ///< [ns]; so a force ends before 50 ms.
inline constexpr std::int64_t kSilence = 30'000'000;     ///< [ns]
/// These four use the machine's clock.
inline constexpr std::int64_t kPeriod = 500'000;      ///< Between messages, after an answer [ns].
inline constexpr std::int64_t kAskAgain = 5'000'000;  ///< Between messages, without an answer [ns].
inline constexpr std::int64_t kAskForArms = 250'000'000;  ///< While no arm is open [ns].
inline constexpr std::int64_t kTryAgain = 100'000'000;  ///< Until the next attempt to connect [ns].

/// A reading, still in the service's axes.
struct Reading {
  std::int64_t taken = 0;  ///< Arrival time of its message, by the host's clock [ns].
  ArmState arm;
  GripState grip;
};

/// A force that the haptic thread has written.
struct Order {
  Triple force_D{};
  std::int64_t when = 0;           ///< Time of the write, by the host's clock [ns].
  std::uint64_t acknowledged = 1;  ///< Value of Line::stops when zero was last written.
};

/// The data of an open arm that the threads share.
struct Line {
  Mailbox<Reading> readings;  ///< Service thread to haptic thread.
  Mailbox<Order> orders;      ///< Haptic thread to service thread.
  DeviceId id;
  std::atomic<std::uint64_t> stops{1};  ///< Events so far that end the force until zero is written.
  std::atomic<std::uint64_t> obeyed{0};  ///< Value of `stops` that the last message obeyed.
  std::atomic<std::uint64_t> losses{0};  ///< Times that the arm has fallen silent.
  std::atomic<int> powered{-1};          ///< ArmState::powered of the last message that had it.
  std::atomic<int> ready{-1};
  std::atomic<int> calibrated{-1};
  std::atomic<bool> away{true};     ///< The arm is silent, or the connection is down.
  std::atomic<bool> leaves{false};  ///< Requests zero force and then the arm's release.
  std::atomic<bool> left{false};    ///< Only the owner's thread still refers to this line.

  // Used by the service thread only.
  bool told_zero = false;      ///< A zero force was sent after `leaves` was set.
  std::int64_t leaves_at = 0;  ///< Time when the thread first saw `leaves` [ns].
  long told_in = 0;            ///< Number of the message with that zero force.
  std::int64_t heard = 0;      ///< Time of the last valid position, by the host's clock [ns].
};

/// An arm in the service's list.
struct Named {
  DeviceId id;
  ArmConfig config;
};

/// The known state of the service.
struct Inventory {
  bool connected = false;
  bool answered = false;  ///< A list of devices has arrived.
  int refusals = 0;       ///< Failed attempts to connect.
  Generation generation = Generation::kUnknown;
  std::vector<Named> arms;
  int button_count = 0;  ///< Largest button count of its handles.
  bool grips = false;    ///< A handle reports its orientation.
};

/// Address of the service.
struct Address {
  std::string host = "127.0.0.1";
  int port = 10001;
  std::string path = "/";
  std::string words = "ws://localhost:10001";  ///< The address shown to the user.
};

/// Reads `url`, ws://HOST[:PORT][/PATH]. HOST must be this machine (localhost, 127.0.0.1, [::1])
/// unless `anywhere` is set. On failure returns false, with cause and remedy in `why`.
bool readUrl(const std::string& url, bool anywhere, Address& out, std::string& why);

/// Private to devices: the connection. Created, queried and destroyed on the main thread.
class Service {
 public:
  /// `now`: the host's clock, called on any thread.
  Service(Address address, std::int64_t (*now)());
  ~Service();
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  [[nodiscard]] Inventory inventory();
  /// Adds an arm. Returns false if kMaxArms arms are served already. `line` must live until
  /// release() has returned.
  bool serve(Line& line);
  /// Removes an arm. If there is a connection, first sends zero force and waits for the answer, at
  /// most 1 s.
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
  std::mutex mutex_;  ///< Guards inventory_ between main and service thread.
  Inventory inventory_;

  // Used by the service thread only.
  lws* wsi_ = nullptr;
  bool up_ = false;
  bool introduced_ = false;
  bool answered_ = false;         ///< An answer has arrived since the last message.
  long asked_ = 0;                ///< Messages sent on this connection.
  long got_ = 0;                  ///< Answers on this connection.
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
