/// An OpenIGTLink server with its own thread: shows a run in 3D Slicer, and receives requests.
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

struct IgtlPlace {
  std::string address = "127.0.0.1";  ///< A numeric address of this machine.
  std::uint16_t port = 0;             ///< Port; 0: any free port.
};
/// Parses `[ADDRESS:]PORT`, in which an IPv6 address has brackets. Throws Error.
[[nodiscard]] IgtlPlace igtlPlace(const std::string& words);

inline constexpr double kIgtlRate = 30.0;  ///< Default rate at which messages are sent [Hz].
/// Largest rate of the messages [Hz]: the rate at which the main thread observes the run.
inline constexpr double kIgtlMostRate = 100.0;

/// State of a hand at the last tick that the main thread has read.
struct IgtlHand {
  Vec3 probe = Vec3::Zero();  ///< Position of the probe [m].
  Vec3 proxy = Vec3::Zero();  ///< Position of the proxy [m].
  Vec3 force = Vec3::Zero();  ///< Force that was sent to the device [N].
  Fault fault = Fault::kNone;
  bool begun = false;
};

struct IgtlShown {
  static constexpr std::size_t kHands = 4;
  std::array<IgtlHand, kHands> hands{};
  std::size_t count = 0;
};

/// Shows a run to at most four clients. Up to 16 more clients wait, and can only cut the force.
///
/// A client can cut the force, replace a volume, and lead a hand that has no arm. Only a user at
/// the arm can restore the force. A client that sends invalid data or does not read cannot delay
/// other clients. After invalid data, the server closes the connection and prints a line. After an
/// invalid image in a valid message, the connection continues.
// Padding is intended: it keeps the mailboxes' data of two threads on separate cache lines.
class IgtlServer {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Listens, and answers connections after begin(). Throws Error if the address or port cannot be
  /// used. `rate` must be above 0 and at most kIgtlMostRate [Hz]. If `images` is true, clients can
  /// replace volumes.
  IgtlServer(const IgtlPlace& place, double rate, bool images);
  ~IgtlServer();
  IgtlServer(const IgtlServer&) = delete;
  IgtlServer& operator=(const IgtlServer&) = delete;

  /// Returns address and port, in the form that a client needs.
  [[nodiscard]] const std::string& place() const noexcept { return place_; }
  /// Returns the hand that clients lead. The hand starts at `start` [m]. Call hand() before
  /// begin().
  [[nodiscard]] HandTarget hand(const Vec3& start);
  void begin();

  // Only the run's thread calls the following functions.
  /// Sets the hands that clients can cut. Cuts these hands at once if a client has already
  /// requested a cut.
  void cuts(std::vector<HapticThread*> hands);
  void expect(const BuiltScene& scene);
  void show(const IgtlShown& shown);
  /// Reports the result of the image that was taken last to all clients. If the image was refused,
  /// its sender also gets a STATUS.
  void tell(const std::string& news, bool refused);
  /// Returns a new image once; otherwise null. While an image waits for this call, the server
  /// answers other images with kBusy.
  [[nodiscard]] std::shared_ptr<const IgtlImage> takeImage();
  [[nodiscard]] OrderedJson summary() const;

 private:
  struct Stage {
    Placement first;  ///< Placement of the volume with the first name. Without volumes: W in
                      ///< millimetres.
    std::set<std::string> volumes;
  };
  struct Client;
  struct Counts;
  /// Prints at most one line a second, the newest, because clients can cause any number of lines.
  class Seldom {
   public:
    void say(const std::string& line);
    void look();
    /// Prints the waiting line now.
    void end();

   private:
    std::string last_;
    std::int64_t next_ = 0;  ///< Time from which the next line may be printed [ns].
    std::int64_t more_ = 0;  ///< Number of lines since the last printed line.
  };

  void run();
  void round();
  void accept();
  void read(Client& client);
  /// Processes bytes as they arrive. Throws Error if the bytes are not a valid message.
  void feed(Client& client, ByteView bytes);
  void beginBody(Client& client);
  void endBody(Client& client);
  /// Stores an image for takeImage(), or answers that the image is invalid.
  void keepImage(Client& client, const IgtlHead& head, Bytes body);
  /// Sends the refusal of an image to its sender.
  void answerRefusal();
  void obey(Client& client, const std::string& words);
  void reply(Client& client, IgtlCode code, const std::string& text);
  void send();
  void flush(Client& client);
  void endLate(Client& client);
  void drop(Client& client, const std::string& why);
  /// Returns true if an image is arriving or has not been taken yet.
  [[nodiscard]] bool full();
  [[nodiscard]] std::string statusOf(const IgtlShown& shown);

  double rate_;
  bool images_;
  bool led_ = false;
  std::string place_;
  int listener_ = -1;
  /// Time from which connections are accepted again, after accept() has failed [ns].
  std::int64_t deaf_until_ = 0;
  std::vector<std::unique_ptr<Client>> clients_;
  std::unique_ptr<Counts> counts_;

  Published<LiveHand> aim_;
  Mailbox<IgtlShown> shown_;
  Mailbox<Stage> stage_;
  // Protects data that a mailbox cannot pass on: the hands to cut, the result of an image, and an
  // image. No haptic thread takes this lock.
  std::mutex mutex_;
  std::vector<HapticThread*> hands_;
  bool cut_asked_ = false;  ///< True if a client has requested a cut before cuts() was called.
  std::shared_ptr<const IgtlImage> image_;
  /// Client that has sent `image_`, and client whose image was taken last; 0: none.
  std::uint64_t sender_ = 0;
  std::uint64_t taken_from_ = 0;
  struct Refusal {
    std::uint64_t client = 0;
    std::string why;  ///< Empty: no refusal.
  };
  Refusal refusal_;  ///< Refusal that the image's sender has not received yet.
  std::string news_;

  std::int64_t next_ = 0;  ///< Time at which the next messages are sent [ns].
  Seldom complaints_;
  Seldom greetings_;
  std::int64_t next_status_ = 0;
  std::string status_;
  std::atomic<bool> quit_{false};
  std::thread thread_;
};

}  // namespace palpate::cli
