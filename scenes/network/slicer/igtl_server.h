/// A server of OpenIGTLink on a thread of its own: shows a run to 3D Slicer and takes requests of
/// the Slicer user.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/loop/mailbox.h"
#include "palpate/engine/safety/safety.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/apps/common/say.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"
#include "palpate/scenes/network/slicer/igtl_message.h"

namespace palpate::cli {

/// Address and port of the server.
struct IgtlPlace {
  std::string address = "127.0.0.1";  ///< Numeric address of this machine.
  std::uint16_t port = 0;             ///< 0: any free port.
};
/// Parses `[ADDRESS:]PORT`; an IPv6 address is in brackets. Throws Error.
[[nodiscard]] IgtlPlace igtlPlace(const std::string& words);

inline constexpr double kIgtlRate = 30.0;       ///< Default rate of the messages [Hz].
inline constexpr double kIgtlMostRate = 100.0;  ///< [Hz]: the rate at which the run is observed.

/// One hand at the newest observed tick.
struct IgtlHand {
  Vec3 probe = Vec3::Zero();  ///< [m]
  Vec3 proxy = Vec3::Zero();  ///< [m]
  Vec3 force = Vec3::Zero();  ///< Force that was sent [N].
  Fault fault = Fault::kNone;
  bool begun = false;  ///< There has been a tick.
};

/// State of a run for the clients.
struct IgtlShown {
  static constexpr std::size_t kHands = 4;
  std::array<IgtlHand, kHands> hands{};
  std::size_t count = 0;  ///< Entries of `hands`.
};

/// Shows a run to a few clients. A client can request what a user at the keyboard can do too: cut
/// the force, replace a volume, lead a hand that has no arm. Only a user at the arm can restore the
/// force. A client that sends bad data, or does not read, delays only itself. Invalid data end the
/// client's connection; the server reports this in a line.
// The mailboxes keep the data of each side on separate cache lines.
class IgtlServer {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Listens from now on, and answers from begin() on. `rate`: of the messages [Hz], above 0 to
  /// kIgtlMostRate. `images`: accepts volumes. Throws Error if the place is not available.
  IgtlServer(const IgtlPlace& place, double rate, bool images);
  ~IgtlServer();
  IgtlServer(const IgtlServer&) = delete;
  IgtlServer& operator=(const IgtlServer&) = delete;

  /// Returns the place in the form that a client takes.
  [[nodiscard]] const std::string& place() const noexcept { return place_; }
  /// Returns the hand that clients lead, from `start` [m] on. Call before begin().
  [[nodiscard]] HandTarget hand(const Vec3& start);
  /// Starts the thread.
  void begin();

  // Called by the run's thread.
  /// Sets the hands whose force a client can cut, until the next call. If a client requested a cut
  /// before any hand was set, the cut takes effect now.
  void cuts(std::vector<HapticThread*> hands);
  /// Sets the scene from now on: the places and the names of its volumes.
  void expect(const BuiltScene& scene);
  /// Sets the state that is sent next.
  void show(const IgtlShown& shown);
  /// Reports the result of the last image, for its sender.
  void tell(const std::string& news);
  /// Returns an image, once; null if no image has arrived. Until the run takes it, senders of other
  /// images get the answer busy.
  [[nodiscard]] std::shared_ptr<const IgtlImage> takeImage();
  /// Returns counts of the traffic.
  [[nodiscard]] OrderedJson summary() const;

 private:
  /// Places of the volumes, for the server's thread.
  struct Stage {
    Placement first;  ///< Placement of the first volume by name.
    std::set<std::string> volumes;
  };
  struct Client;
  struct Counts;
  /// Limits lines that a client can cause in any number: prints the last line of each second.
  class Seldom {
   public:
    void say(const std::string& line);
    /// Prints the pending line, if its time has come.
    void look();
    /// Prints the pending line now. Call it after the last line.
    void end();

   private:
    std::string last_;
    std::int64_t next_ = 0;  ///< Time before which no line is printed [ns].
    std::int64_t more_ = 0;  ///< Number of lines not yet printed.
  };

  void run();
  void round();
  void accept();
  void read(Client& client);
  /// Takes bytes as they arrive; throws Error if they are not a message.
  void feed(Client& client, ByteView bytes);
  void beginBody(Client& client);
  void endBody(Client& client);
  void obey(Client& client, const std::string& words);
  void reply(Client& client, IgtlCode code, const std::string& text);
  /// Sends to all clients that have taken the previous messages.
  void send();
  void flush(Client& client);
  void endLate(Client& client);
  void drop(Client& client, const std::string& why);
  /// Returns true if no image may begin: another one is arriving, or waits to be taken.
  [[nodiscard]] bool full();
  [[nodiscard]] std::string statusOf(const IgtlShown& shown);

  double rate_;
  bool images_;
  bool led_ = false;  ///< A hand follows `aim_`.
  std::string place_;
  int listener_ = -1;
  std::int64_t deaf_until_ = 0;  ///< No accept until then, because accept failed [ns].
  std::vector<std::unique_ptr<Client>> clients_;
  std::unique_ptr<Counts> counts_;

  Published<LiveHand> aim_;
  Mailbox<IgtlShown> shown_;
  Mailbox<Stage> stage_;
  // Guards data that a mailbox cannot carry: the end of a hand, news for all clients, and the
  // transfer of an image's memory. No haptic thread locks it.
  std::mutex mutex_;
  std::vector<HapticThread*> hands_;
  bool cut_asked_ = false;  ///< A client requested a cut before any hand was set.
  std::shared_ptr<const IgtlImage> image_;
  std::string news_;

  std::int64_t next_ = 0;  ///< Time of the next messages [ns].
  Seldom complaints_;
  Seldom greetings_;
  std::int64_t next_status_ = 0;
  std::string status_;
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
