/// The connection to Haply's Inverse Service: one for all arms of a process, on a thread of its
/// own.
///
/// The service says one state for each message that it is sent, so the thread keeps asking, with
/// the newest forces, as fast as it is answered and at most every kPeriod. What the haptic thread
/// reads and writes goes through mailboxes.
///
/// A force is sent while three things hold, and zero otherwise, at once: it was written less than
/// kForceHolds ago; the arm has been heard of less than kSilence ago; neither stop() nor a silence
/// has come since a zero force was written.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "palpate/devices/plugins/haply_messages.h"
#include "palpate/engine/mailbox.h"

struct lws;
struct lws_context;

namespace palpate::haply {

/// By the clock of the host, which may be a test's.
inline constexpr std::int64_t kForceHolds = 40'000'000;  ///< [ns], so that 50 ms are never full.
inline constexpr std::int64_t kSilence = 30'000'000;     ///< [ns]
/// By the machine's.
inline constexpr std::int64_t kPeriod = 500'000;          ///< Between messages, once answered [ns].
inline constexpr std::int64_t kAskAgain = 5'000'000;      ///< Where no answer comes [ns].
inline constexpr std::int64_t kAskForArms = 250'000'000;  ///< While no arm is open [ns].
inline constexpr std::int64_t kTryAgain = 100'000'000;  ///< Until the next attempt to connect [ns].

/// What a reading has, still in the service's axes.
struct Reading {
  std::int64_t taken = 0;  ///< When its message arrived, by the host's clock [ns].
  ArmState arm;
  GripState grip;
};

/// What the haptic thread has written.
struct Order {
  Triple force_D{};
  std::int64_t when = 0;           ///< By the host's clock [ns].
  std::uint64_t acknowledged = 1;  ///< So many stops were known when zero was written last.
};

/// An arm that is open: what the threads share of it.
struct Line {
  Mailbox<Reading> readings;  ///< Service thread to haptic thread.
  Mailbox<Order> orders;      ///< Haptic thread to service thread.
  DeviceId id;
  std::atomic<std::uint64_t> stops{1};   ///< Reasons so far for no force until zero is written.
  std::atomic<std::uint64_t> obeyed{0};  ///< Those that the last message has obeyed.
  std::atomic<std::uint64_t> losses{0};  ///< How often it has fallen silent.
  std::atomic<int> powered{-1};          ///< As ArmState, as far as it has been said.
  std::atomic<int> ready{-1};
  std::atomic<int> calibrated{-1};
  std::atomic<bool> away{true};     ///< It is silent, or there is no connection.
  std::atomic<bool> leaves{false};  ///< It is to have zero force, and to be let go of.
  std::atomic<bool> left{false};    ///< No thread but its owner's knows it any more.

  // The service thread's own.
  bool told_zero = false;      ///< Since it leaves,
  std::int64_t leaves_at = 0;  ///< When that was seen first [ns].
  long told_in = 0;            ///< in the message of this number.
  std::int64_t heard = 0;      ///< By the host's clock [ns].
};

/// An arm that the service has named.
struct Named {
  DeviceId id;
  ArmConfig config;
};

/// What is known of the service.
struct Inventory {
  bool connected = false;
  bool answered = false;  ///< A list of devices has come.
  int refusals = 0;       ///< Attempts to connect that have failed.
  Generation generation = Generation::kUnknown;
  std::vector<Named> arms;
  int button_count = 0;  ///< Of its handles, the most.
  bool grips = false;    ///< There is a handle that says how it is held.
};

/// Where the service is.
struct Address {
  std::string host = "127.0.0.1";
  int port = 10001;
  std::string path = "/";
  std::string words = "ws://localhost:10001";  ///< As the user would say it.
};

/// Reads `url`, ws://HOST[:PORT][/PATH]. HOST is this machine (localhost, 127.0.0.1, [::1]) unless
/// `anywhere`. False: `why`, with a remedy.
bool readUrl(const std::string& url, bool anywhere, Address& out, std::string& why);

/// The connection. Made, asked and ended on the main thread.
class Service {
 public:
  /// `now`: the host's clock, called on any thread.
  Service(Address address, std::int64_t (*now)());
  ~Service();
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  [[nodiscard]] Inventory inventory();
  /// False: there are as many as it can serve. `line` lives until release() has returned.
  bool serve(Line& line);
  /// Zero force first, where there is a connection, and until it has been answered or 1 s.
  void release(Line& line);

  /// What libwebsockets calls, on the thread.
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
  std::mutex mutex_;  ///< Of inventory_: main and service thread.
  Inventory inventory_;

  // The thread's own.
  lws* wsi_ = nullptr;
  bool up_ = false;
  bool introduced_ = false;
  bool answered_ = false;         ///< Something has come since the last message.
  long asked_ = 0;                ///< Messages of this connection,
  long got_ = 0;                  ///< and answers.
  std::int64_t answered_at_ = 0;  ///< [ns], the last one.
  Generation generation_ = Generation::kUnknown;
  std::int64_t tried_ = 0;
  std::int64_t sent_ = 0;
  std::string partial_;
  bool too_long_ = false;
  Message in_;
  std::thread thread_;
};

}  // namespace palpate::haply
