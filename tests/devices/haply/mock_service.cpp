#include "tests/devices/haply/mock_service.h"

#include <atomic>
#include <cmath>
#include <ctime>
#include <deque>
#include <libwebsockets.h>
#include <mutex>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <utility>

#include <nlohmann/json.hpp>

namespace palpate::test {
namespace {

std::int64_t monotonicNs() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

std::string vec(const std::array<double, 3>& v,
                const std::array<const char*, 3>& names = {"x", "y", "z"}) {
  std::ostringstream out;
  out.precision(17);
  for (std::size_t i = 0; i < 3; ++i) {
    out << (i == 0 ? "{" : ",") << '"' << names[i] << "\":" << v[i];
  }
  out << '}';
  return out.str();
}

const char* truth(bool is) {
  return is ? "true" : "false";
}

}  // namespace

struct MockService::Inside {
  /// An answer that is sent after a delay.
  struct Waiting {
    std::int64_t due = 0;
    bool full = false;
  };
  struct Session {
    int number = 0;
    std::string partial;
    std::deque<Waiting> waiting;
  };

  const Speaks speaks;
  std::atomic<int> port;
  mutable std::mutex mutex;  // Guards the members from `arms` to `heard`.
  std::array<MockArm, 2> arms;
  Lie lie = Lie::kNone;
  std::int64_t delay = 0;
  bool mute = false;
  bool shy = false;
  std::vector<Told> told;
  Heard heard;
  std::atomic<bool> ends{false};
  std::atomic<bool> hang_up{false};
  std::atomic<bool> listens{false};
  std::thread thread;
  // Used by the server's thread only.
  std::vector<std::pair<lws*, std::unique_ptr<Session>>> sessions;

  explicit Inside(Speaks s, int p) : speaks(s), port(p) {
    arms[0].id = "049D";
    arms[1].id = "04BA";
  }

  [[nodiscard]] std::string armText(const MockArm& arm, bool full) const {
    std::string id = arm.id;
    if (lie == Lie::kOtherIds) id = "FFFF";
    if (lie == Lie::kBadIds) id = R"(04\"}],\"x\":[{\"9D)";
    std::string position = vec(arm.position);
    if (lie == Lie::kNaN) position = R"({"x":NaN,"y":0,"z":0})";
    if (lie == Lie::kHuge) position = R"({"x":1e300,"y":0,"z":0})";
    if (lie == Lie::kOverflows) position = R"({"x":1e999,"y":0,"z":0})";
    if (lie == Lie::kStrings) position = R"({"x":"0.0","y":"-0.12","z":"0.15"})";
    std::string out = "{";
    if (speaks != Speaks::k30) out += "\"device_id\":\"" + id + "\",";
    if (full) {
      out += R"("config":{"type":")" + arm.type + R"(","port":"COM12","handedness":"right")";
      if (speaks == Speaks::k35) {
        out += R"(,"preset":")" + arm.preset + R"(","basis":{"permutation":")" + arm.basis + "\"}";
      }
      out += "},";
    }
    if (lie != Lie::kNoState) {
      out += R"("state":{"angular_position":)" + vec(arm.degrees, {"a0", "a1", "a2"});
      if (lie != Lie::kNoPosition) out += ",\"cursor_position\":" + position;
      out += ",\"cursor_velocity\":" + vec(arm.velocity);
      out += R"(,"body_orientation":{"w":1,"x":0,"y":0,"z":0},"transform":{"scale":)" +
             vec({arm.scale, arm.scale, arm.scale}) + "}},";
    }
    out += std::string(R"("status":{"calibrated":)") + truth(arm.calibrated) +
           ",\"in_use\":false,\"power_supply\":" + truth(arm.powered) +
           ",\"ready\":" + truth(arm.ready) + ",\"started\":true}}";
    return speaks == Speaks::k30 ? '"' + id + "\":" + out : out;
  }

  [[nodiscard]] std::string gripText(const MockArm& arm, int number) const {
    const auto& q = arm.orientation;
    std::ostringstream out;
    out.precision(17);
    out << R"({"device_id":"6154)" << number << R"(","state":{"orientation":{"w":)" << q[0]
        << ",\"x\":" << q[1] << ",\"y\":" << q[2] << ",\"z\":" << q[3]
        << "},\"buttons\":{\"a\":" << truth(arm.buttons[0]) << ",\"b\":" << truth(arm.buttons[1])
        << ",\"c\":" << truth(arm.buttons[2]) << "}},\"status\":{\"connected\":true}}";
    return out.str();
  }

  [[nodiscard]] std::string text(bool full) const {
    if (lie == Lie::kNotJson) return "200 OK";
    if (lie == Lie::kDeep) return std::string(50'000, '[');
    const bool by_id = speaks == Speaks::k30;
    std::string out = "{";
    // Haply does not publish whether updates also have session_id; in this mock they do not.
    if (speaks == Speaks::k35 && full) out += "\"session_id\":7,";
    out += std::string("\"inverse3\":") + (by_id ? "{" : "[");
    if (lie != Lie::kEmptyLists) out += armText(arms[0], full) + "," + armText(arms[1], full);
    out += std::string(by_id ? "}" : "]") + ",\"wireless_verse_grip\":[";
    if (lie != Lie::kEmptyLists) out += gripText(arms[0], 1) + "," + gripText(arms[1], 2);
    out += "]}";
    if (lie == Lie::kHalf) out.resize(out.size() / 2);
    if (lie == Lie::kLong) out += std::string(10'000'000, ' ');
    return out;
  }

  /// Parses a message, stores its forces and counts it.
  void understand(const std::string& bytes, int connection) {
    const std::int64_t when = monotonicNs();
    const auto json = nlohmann::json::parse(bytes, nullptr, false);
    bool known = false;
    if (json.is_object() && json.contains("session")) {
      const auto& session = json["session"];
      if (session.contains("force_render_full_state")) {
        ++heard.asked_for_all;
        known = true;
      }
      if (session.contains("configure")) ++heard.introduced;
    }
    // Forces in the format of another version are not stored, and their message counts as unknown.
    const char* name = speaks == Speaks::k35 ? "vector" : "values";
    if (json.is_object() && json.contains("inverse3") && speaks != Speaks::k30) {
      known = true;
      for (const auto& arm : json["inverse3"]) {
        const nlohmann::json none = nlohmann::json::object();
        const auto command = arm.value("commands", none).value("set_cursor_force", none);
        if (!arm.contains("device_id") || !command.contains(name)) {
          known = false;
          continue;
        }
        const auto& force = command[name];
        const auto along = [&](const char* axis) { return force.value(axis, std::nan("")); };
        told.push_back({arm["device_id"].get<std::string>(),
                        {along("x"), along("y"), along("z")},
                        when,
                        connection});
      }
    }
    ++heard.messages;
    if (!known) ++heard.unknown;
  }

  Session* of(lws* wsi) {
    for (auto& [one, session] : sessions) {
      if (one == wsi) return session.get();
    }
    return nullptr;
  }

  int writable(lws* wsi, Session& session) {
    if (session.waiting.empty() || session.waiting.front().due > monotonicNs()) return 0;
    const bool full = session.waiting.front().full;
    session.waiting.pop_front();
    bool binary = false;
    std::string words;
    {
      const std::lock_guard lock(mutex);
      if (lie == Lie::kDrops) return 0;
      words = text(full);
      binary = lie == Lie::kBinary;
    }
    std::string room(LWS_PRE, '\0');
    room += words;
    auto* at = reinterpret_cast<unsigned char*>(room.data()) + LWS_PRE;
    if (lws_write(wsi, at, words.size(), binary ? LWS_WRITE_BINARY : LWS_WRITE_TEXT) < 0) return -1;
    if (!session.waiting.empty()) lws_callback_on_writable(wsi);
    return 0;
  }

  int call(lws* wsi, lws_callback_reasons reason, const void* bytes, std::size_t size) {
    Session* session = of(wsi);
    switch (reason) {
      case LWS_CALLBACK_ESTABLISHED: {
        sessions.emplace_back(wsi, std::make_unique<Session>());
        session = sessions.back().second.get();
        const std::lock_guard lock(mutex);
        session->number = ++heard.connections;
        if (!mute && !shy) session->waiting.push_back({monotonicNs() + delay, true});
        break;
      }
      case LWS_CALLBACK_RECEIVE: {
        session->partial.append(static_cast<const char*>(bytes), size);
        if (lws_is_final_fragment(wsi) == 0 || lws_remaining_packet_payload(wsi) != 0) break;
        const std::lock_guard lock(mutex);
        const long asked = heard.asked_for_all;
        understand(session->partial, session->number);
        session->partial.clear();
        if (!mute) session->waiting.push_back({monotonicNs() + delay, heard.asked_for_all > asked});
        break;
      }
      case LWS_CALLBACK_SERVER_WRITEABLE:
        if (session != nullptr) return writable(wsi, *session);
        break;
      case LWS_CALLBACK_CLOSED:
        if (session != nullptr) {
          const std::lock_guard lock(mutex);
          ++heard.ended;
          if (!session->waiting.empty()) ++heard.cut_off;
        }
        std::erase_if(sessions, [&](const auto& one) { return one.first == wsi; });
        break;
      default:
        break;
    }
    return 0;
  }

  void run();
};

namespace {

template <class Inside>
int called(lws* wsi, lws_callback_reasons reason, void*, void* bytes, std::size_t size) {
  auto* inside = static_cast<Inside*>(lws_context_user(lws_get_context(wsi)));
  if (inside == nullptr) return 0;
  return inside->call(wsi, reason, bytes, size);
}

}  // namespace

void MockService::Inside::run() {
  static const std::array<lws_protocols, 2> kProtocols{{
      {"mock", called<Inside>, 0, 65536, 0, nullptr, 0},
      {nullptr, nullptr, 0, 0, 0, nullptr, 0},
  }};
  lws_set_log_level(0, nullptr);
  lws_context_creation_info info{};
  info.port = port;
  info.iface = "127.0.0.1";
  info.protocols = kProtocols.data();
  info.user = this;
  info.options = LWS_SERVER_OPTION_DISABLE_IPV6;
  lws_context* context = lws_create_context(&info);
  if (context == nullptr) return;
  port = lws_get_vhost_listen_port(lws_get_vhost_by_name(context, "default"));
  listens = true;
  while (!ends) {
    const std::int64_t now = monotonicNs();
    for (auto& [wsi, session] : sessions) {
      if (!session->waiting.empty() && session->waiting.front().due <= now) {
        lws_callback_on_writable(wsi);
      }
      if (hang_up) lws_set_timeout(wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
    }
    hang_up = false;
    lws_service(context, -1);
    const timespec time{0, 100'000};
    nanosleep(&time, nullptr);
  }
  lws_context_destroy(context);
  sessions.clear();
  listens = false;
}

MockService::MockService(Speaks speaks, int port)
    : inside_(std::make_unique<Inside>(speaks, port)) {
  begin();
}

MockService::~MockService() {
  end();
}

int MockService::port() const {
  return inside_->port;
}

std::string MockService::url() const {
  return "ws://localhost:" + std::to_string(port());
}

void MockService::set(int arm, const MockArm& as) {
  const std::lock_guard lock(inside_->mutex);
  inside_->arms.at(static_cast<std::size_t>(arm)) = as;
}

MockArm MockService::arm(int arm) const {
  const std::lock_guard lock(inside_->mutex);
  return inside_->arms.at(static_cast<std::size_t>(arm));
}

void MockService::lie(Lie lie) {
  const std::lock_guard lock(inside_->mutex);
  inside_->lie = lie;
}

void MockService::delay(std::int64_t nanoseconds) {
  const std::lock_guard lock(inside_->mutex);
  inside_->delay = nanoseconds;
}

void MockService::mute(bool is) {
  const std::lock_guard lock(inside_->mutex);
  inside_->mute = is;
}

void MockService::shy(bool is) {
  const std::lock_guard lock(inside_->mutex);
  inside_->shy = is;
}

void MockService::hangUp() {
  inside_->hang_up = true;
}

void MockService::end() {
  inside_->ends = true;
  if (inside_->thread.joinable()) inside_->thread.join();
}

void MockService::begin() {
  inside_->ends = false;
  inside_->thread = std::thread([this] { inside_->run(); });
  for (int i = 0; i < 10'000 && !inside_->listens; ++i) {
    const timespec time{0, 1'000'000};
    nanosleep(&time, nullptr);
  }
  if (inside_->listens) return;
  end();
  throw std::runtime_error("the mock service does not listen after 10 s");
}

std::vector<Told> MockService::told() const {
  const std::lock_guard lock(inside_->mutex);
  return inside_->told;
}

Heard MockService::heard() const {
  const std::lock_guard lock(inside_->mutex);
  return inside_->heard;
}

void MockService::forget() {
  const std::lock_guard lock(inside_->mutex);
  inside_->told.clear();
}

}  // namespace palpate::test
