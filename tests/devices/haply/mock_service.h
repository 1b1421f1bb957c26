/// Simulates Haply's Inverse Service with a WebSocket server on its own thread. The server sends
/// the published messages for two arms and two handles, sends wrong messages on request, stores the
/// forces that it receives, and counts the received messages.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace palpate::test {

/// Version of the service's message format.
enum class Speaks { k30, k31, k35 };

/// Errors that the test can put into the answers.
enum class Lie {
  kNone,
  kDrops,       ///< Sends no answer.
  kNaN,         ///< A position of NaN, which is not valid JSON.
  kHuge,        ///< A position of 1e300 m.
  kOverflows,   ///< A position of 1e999 m.
  kStrings,     ///< Strings for numbers.
  kNoPosition,  ///< Leaves out cursor_position.
  kNoState,     ///< Leaves out the state.
  kOtherIds,    ///< Ids of other arms.
  kBadIds,      ///< Ids that contain quotation marks and brackets.
  kDeep,        ///< JSON nested 50,000 levels deep.
  kLong,        ///< A correct object, then 10 MB of blanks.
  kBinary,      ///< The correct bytes in a binary frame.
  kHalf,        ///< The first half of the bytes.
  kEmptyLists,  ///< Empty lists, as if all arms were unplugged.
  kNotJson,
};

/// An arm with its handle, in the service's axes.
struct MockArm {
  std::string id;
  std::array<double, 3> position{0.0, -0.12, 0.15};
  std::array<double, 3> velocity{};
  std::array<double, 3> degrees{};
  std::array<double, 4> orientation{1.0, 0.0, 0.0, 0.0};
  std::array<bool, 3> buttons{};
  bool calibrated = true;
  bool ready = true;
  bool powered = true;
  std::string preset = "defaults";
  std::string basis = "XYZ";
  std::string type = "inverse3";
  double scale = 1.0;  ///< Scale of the workspace.
};

/// A force that the service has received.
struct Told {
  std::string id;
  std::array<double, 3> force{};
  std::int64_t when = 0;  ///< CLOCK_MONOTONIC [ns].
  int connection = 0;     ///< Number of the connection, counted from 1.
};

/// Counts of received messages.
struct Heard {
  long messages = 0;
  long unknown = 0;  ///< Messages that are unpublished or belong to another version.
  long asked_for_all = 0;
  long introduced = 0;  ///< Messages with a session profile.
  int connections = 0;
  int ended = 0;
  int cut_off = 0;  ///< Connections that ended while an answer was due.
};

class MockService {
 public:
  /// Listens on a local port; `port` 0 chooses a free one.
  explicit MockService(Speaks speaks, int port = 0);
  ~MockService();
  MockService(const MockService&) = delete;
  MockService& operator=(const MockService&) = delete;

  [[nodiscard]] int port() const;
  [[nodiscard]] std::string url() const;

  void set(int arm, const MockArm& as);
  [[nodiscard]] MockArm arm(int arm) const;
  void lie(Lie lie);
  /// Delays answers by this time.
  void delay(std::int64_t nanoseconds);
  /// Sends no messages at all.
  void mute(bool is);
  /// Sends the list of arms only on request, not on connecting.
  void shy(bool is);
  /// Closes all connections.
  void hangUp();
  /// Stops listening and closes all connections; begin() listens on the same port again.
  void end();
  void begin();

  [[nodiscard]] std::vector<Told> told() const;
  [[nodiscard]] Heard heard() const;
  void forget();

 private:
  struct Inside;
  std::unique_ptr<Inside> inside_;
};

}  // namespace palpate::test
