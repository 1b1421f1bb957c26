/// What stands for Haply's Inverse Service: a WebSocket server on a thread of its own that says the
/// published messages for two arms and two handles, misbehaves on command, and keeps what it is
/// told.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace palpate::test {

/// Which messages it says.
enum class Speaks { k30, k31, k35 };

/// What it does wrong with its answers.
enum class Lie {
  kNone,
  kDrops,       ///< Gives no answer.
  kNaN,         ///< A position of NaN, as some writers of JSON spell it.
  kHuge,        ///< 1e300 m.
  kOverflows,   ///< 1e999 m.
  kStrings,     ///< Strings for numbers.
  kNoPosition,  ///< No cursor_position.
  kNoState,     ///< No state.
  kOtherIds,    ///< Ids of other arms.
  kBadIds,      ///< Ids that end the string they are in.
  kDeep,        ///< Nests 50,000 deep.
  kLong,        ///< 10 MB, of which the first object is right.
  kBinary,      ///< The right bytes in a binary frame.
  kHalf,        ///< The first half of the bytes.
  kEmptyLists,  ///< Its arms have been unplugged.
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
  double scale = 1.0;  ///< Of its workspace.
};

/// A force that has come.
struct Told {
  std::string id;
  std::array<double, 3> force{};
  std::int64_t when = 0;  ///< CLOCK_MONOTONIC [ns].
  int connection = 0;     ///< The first is 1.
};

/// How often messages have come.
struct Heard {
  long messages = 0;
  long unknown = 0;  ///< What no published message is, or another generation's.
  long asked_for_all = 0;
  long introduced = 0;  ///< With a session profile.
  int connections = 0;
  int ended = 0;
  int cut_off = 0;  ///< Connections that ended with an answer due.
};

class MockService {
 public:
  /// On a free port of this machine; `port` 0 chooses it.
  explicit MockService(Speaks speaks, int port = 0);
  ~MockService();
  MockService(const MockService&) = delete;
  MockService& operator=(const MockService&) = delete;

  [[nodiscard]] int port() const;
  [[nodiscard]] std::string url() const;

  void set(int arm, const MockArm& as);
  [[nodiscard]] MockArm arm(int arm) const;
  void lie(Lie lie);
  /// Answers come so much later.
  void delay(std::int64_t nanoseconds);
  /// Says no word on connecting either.
  void mute(bool is);
  /// Says its list only where it is asked for.
  void shy(bool is);
  /// Closes what is connected.
  void hangUp();
  /// Listens no more; then again, at the same port.
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
