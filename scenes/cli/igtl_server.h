/// A run as 3D Slicer sees it, and what its user may ask of it: a server of OpenIGTLink, on a
/// thread of its own.
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

#include "palpate/devices/simulated_device.h"
#include "palpate/engine/haptic_thread.h"
#include "palpate/engine/mailbox.h"
#include "palpate/engine/safety.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/cli/igtl_message.h"
#include "palpate/scenes/cli/say.h"
#include "palpate/scenes/live.h"

namespace palpate::cli {

/// Where it listens.
struct IgtlPlace {
  std::string address = "127.0.0.1";  ///< Of this machine, by numbers.
  std::uint16_t port = 0;             ///< 0: one that is free.
};
/// `[ADDRESS:]PORT`; an address of IPv6 in brackets. Throws Error.
[[nodiscard]] IgtlPlace igtlPlace(const std::string& words);

inline constexpr double kIgtlRate = 30.0;       ///< Usual rate of what is sent [Hz].
inline constexpr double kIgtlMostRate = 100.0;  ///< [Hz]: as often as a run is looked at.

/// One hand, of the newest tick that was looked at.
struct IgtlHand {
  Vec3 probe = Vec3::Zero();  ///< [m]
  Vec3 proxy = Vec3::Zero();  ///< [m]
  Vec3 force = Vec3::Zero();  ///< That was sent [N].
  Fault fault = Fault::kNone;
  bool begun = false;  ///< There has been a tick.
};

/// What a run shows.
struct IgtlShown {
  static constexpr std::size_t kHands = 4;
  std::array<IgtlHand, kHands> hands{};
  std::size_t count = 0;  ///< Entries of `hands`.
};

/// Shows a run to a few clients, and takes from them what somebody at the keyboard could do as
/// well: cut the force, change a volume, lead a hand that has no arm. Nobody but who is there lets
/// force out again. Whatever a client sends or does not take, it holds up no one but itself; what
/// is no message ends its connection, told in a line.
// The mailboxes keep what each side writes on cache lines of their own.
class IgtlServer {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Listens from now on, and answers from begin() on. `rate`: of what is sent [Hz], above 0 to
  /// kIgtlMostRate. `images`: volumes are taken. Throws Error where the place cannot be had.
  IgtlServer(const IgtlPlace& place, double rate, bool images);
  ~IgtlServer();
  IgtlServer(const IgtlServer&) = delete;
  IgtlServer& operator=(const IgtlServer&) = delete;

  /// Where it listens, as a client takes it.
  [[nodiscard]] const std::string& place() const noexcept { return place_; }
  /// The hand that clients lead, which begins at `start` [m]; before begin().
  [[nodiscard]] HandTarget hand(const Vec3& start);
  /// Starts the thread.
  void begin();

  // For the thread of the run.
  /// Whose force is cut where a client asks for it, or has asked before there was one, until the
  /// next call.
  void cuts(std::vector<HapticThread*> hands);
  /// The scene that is felt from now on: where its volumes stand, and which it has.
  void expect(const BuiltScene& scene);
  /// What is sent next.
  void show(const IgtlShown& shown);
  /// What has become of the last image, for its sender.
  void tell(const std::string& news);
  /// An image, once; null where none has come. Until it is taken senders of others are told that
  /// it is busy.
  [[nodiscard]] std::shared_ptr<const IgtlImage> takeImage();
  /// What went in and out.
  [[nodiscard]] OrderedJson summary() const;

 private:
  /// Where volumes stand, for this thread.
  struct Stage {
    Placement first;  ///< Of the first volume by name.
    std::set<std::string> volumes;
  };
  struct Client;
  struct Counts;
  /// Lines of a kind of which a client can bring about any number: of each second the last.
  class Seldom {
   public:
    void say(const std::string& line);
    /// Says what there is, once it may.
    void look();
    /// Says it now: there is no more to come.
    void end();

   private:
    std::string last_;
    std::int64_t next_ = 0;  ///< No line before [ns].
    std::int64_t more_ = 0;  ///< That were not said.
  };

  void run();
  void round();
  void accept();
  void read(Client& client);
  /// Takes bytes as they come; throws Error where they are no message.
  void feed(Client& client, ByteView bytes);
  void beginBody(Client& client);
  void endBody(Client& client);
  void obey(Client& client, const std::string& words);
  void reply(Client& client, IgtlCode code, const std::string& text);
  /// To all that have taken what they had before.
  void send();
  void flush(Client& client);
  void endLate(Client& client);
  void drop(Client& client, const std::string& why);
  /// No image may begin: one is on its way, or waits to be taken.
  [[nodiscard]] bool full();
  [[nodiscard]] std::string statusOf(const IgtlShown& shown);

  double rate_;
  bool images_;
  bool led_ = false;  ///< A hand follows `aim_`.
  std::string place_;
  int listener_ = -1;
  std::int64_t deaf_until_ = 0;  ///< Nobody is taken in: there was no descriptor left [ns].
  std::vector<std::unique_ptr<Client>> clients_;
  std::unique_ptr<Counts> counts_;

  Published<LiveHand> aim_;
  Mailbox<IgtlShown> shown_;
  Mailbox<Stage> stage_;
  // What a mailbox cannot say: a hand's end, news that all have heard, and that an image's memory
  // is given away. None of those who lock it is a haptic thread.
  std::mutex mutex_;
  std::vector<HapticThread*> hands_;
  bool cut_asked_ = false;  ///< While there was no hand.
  std::shared_ptr<const IgtlImage> image_;
  std::string news_;

  std::int64_t next_ = 0;  ///< When is sent next [ns].
  Seldom complaints_;
  Seldom greetings_;
  std::int64_t next_status_ = 0;
  std::string status_;
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
