#include "palpate/devices/plugins/haply_service.h"

#include <algorithm>
#include <ctime>
#include <libwebsockets.h>
#include <poll.h>
#include <utility>

namespace palpate::haply {
namespace {

constexpr std::int64_t kLeaving = 1'000'000'000;  ///< Longest wait of release() [ns].
constexpr long kMostUnanswered = 3;               // largest number of unanswered messages
/// Longest sleep of the thread without a connection [ns].
constexpr std::int64_t kIdle = 10'000'000;

std::int64_t machineNow() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

void sleepFor(int fd, std::int64_t nanoseconds) {
  pollfd one{fd, POLLIN, 0};
  const timespec time{nanoseconds / 1'000'000'000, nanoseconds % 1'000'000'000};
  ppoll(&one, fd >= 0 ? 1 : 0, &time, nullptr);
}

int called(lws* wsi, lws_callback_reasons reason, void*, void* bytes, std::size_t size) {
  auto* service = static_cast<Service*>(lws_context_user(lws_get_context(wsi)));
  switch (reason) {
    case LWS_CALLBACK_CLIENT_ESTABLISHED:
      return service->connected();
    case LWS_CALLBACK_CLIENT_CONNECTION_ERROR:
    case LWS_CALLBACK_CLIENT_CLOSED:
      service->disconnected();
      return 0;
    case LWS_CALLBACK_CLIENT_RECEIVE:
      service->received(static_cast<const char*>(bytes), size, lws_frame_is_binary(wsi) == 0,
                        lws_is_final_fragment(wsi) != 0 && lws_remaining_packet_payload(wsi) == 0);
      return 0;
    case LWS_CALLBACK_CLIENT_WRITEABLE:
      return service->writable(wsi);
    default:
      return 0;
  }
}

constexpr std::size_t kChunk = 16384;  ///< Largest number of bytes received at a time.
const std::array<lws_protocols, 2> kProtocols{{
    {"palpate-haply", called, 0, kChunk, 0, nullptr, 0},
    {nullptr, nullptr, 0, 0, 0, nullptr, 0},
}};

}  // namespace

bool readUrl(const std::string& url, bool anywhere, Address& out, std::string& why) {
  const std::string remedy = ": set PALPATE_HAPLY_URL to ws://localhost:10001, or unset it";
  constexpr std::string_view kScheme = "ws://";
  if (url.compare(0, kScheme.size(), kScheme) != 0) {
    why = "\"" + url + "\" is not a ws:// address" + remedy;
    return false;
  }
  out.words = url;
  std::string rest = url.substr(kScheme.size());
  const std::size_t slash = rest.find('/');
  out.path = slash == std::string::npos ? "/" : rest.substr(slash);
  rest.resize(std::min(slash, rest.size()));
  // In a name such as [::1]:10001, the port begins after the colon behind the bracket.
  const std::size_t bracket = rest.find(']');
  const std::size_t colon = rest.find(':', bracket == std::string::npos ? 0 : bracket);
  out.host = rest.substr(0, colon);
  out.port = 10001;
  if (colon != std::string::npos) {
    const std::string digits = rest.substr(colon + 1);
    const bool good = !digits.empty() && digits.size() <= 5 &&
                      digits.find_first_not_of("0123456789") == std::string::npos;
    out.port = good ? std::stoi(digits) : 0;
    if (out.port < 1 || out.port > 65535) {
      why = "\"" + url + "\" has no port from 1 to 65535" + remedy;
      return false;
    }
  }
  if (out.host == "[::1]") {
    out.host = "::1";
  } else if (out.host == "localhost" || out.host == "127.0.0.1") {
    // The system may resolve the name "localhost" to another machine.
    out.host = "127.0.0.1";
  } else if (!anywhere && !out.host.empty()) {
    why = "\"" + url + "\" is not this machine, and palpate sends no forces over a network" +
          remedy + ", or set PALPATE_HAPLY_ANYWHERE to 1 if you trust that network";
    return false;
  }
  if (out.host.empty()) {
    why = "\"" + url + "\" names no host" + remedy;
    return false;
  }
  return true;
}

Service::Service(Address address, std::int64_t (*now)()) : address_(std::move(address)), now_(now) {
  thread_ = std::thread([this] { run(); });
}

Service::~Service() {
  ends_ = true;
  thread_.join();
}

Inventory Service::inventory() {
  const std::lock_guard lock(mutex_);
  return inventory_;
}

bool Service::serve(Line& line) {
  return std::any_of(lines_.begin(), lines_.end(), [&](std::atomic<Line*>& one) {
    Line* none = nullptr;
    return one.compare_exchange_strong(none, &line);
  });
}

void Service::release(Line& line) {
  line.leaves = true;
  while (!line.left) sleepFor(-1, kPeriod);
}

void Service::lose(Line& line) {
  // Sets the stop first, so that a thread that sees the loss finds the force off.
  line.stops.fetch_add(1);
  line.away = true;
  line.losses.fetch_add(1);
}

Triple Service::wanted(Line& line, std::int64_t now) const {
  line.orders.refresh();
  const Order& order = line.orders.current();
  const bool given = !line.leaves && !line.away && order.acknowledged == line.stops.load() &&
                     now - order.when < kForceHolds;
  return given ? order.force_D : Triple{};
}

int Service::connected() {
  up_ = true;
  introduced_ = false;
  answered_ = false;
  asked_ = 0;
  got_ = 0;
  generation_ = Generation::kUnknown;
  sent_ = machineNow();
  partial_.clear();
  too_long_ = false;
  const std::lock_guard lock(mutex_);
  inventory_.connected = true;
  return 0;
}

void Service::disconnected() {
  const bool was_up = std::exchange(up_, false);
  wsi_ = nullptr;
  for (auto& one : lines_) {
    Line* line = one.load();
    if (line == nullptr) continue;
    if (!line->away) lose(*line);
  }
  const std::lock_guard lock(mutex_);
  const int refusals = inventory_.refusals + (was_up ? 0 : 1);
  inventory_ = {};
  inventory_.refusals = refusals;
}

void Service::received(const char* bytes, std::size_t size, bool is_text, bool last) {
  too_long_ = too_long_ || !is_text || partial_.size() + size > kMessageLimit;
  if (too_long_) {
    partial_.clear();
  } else {
    partial_.append(bytes, size);
  }
  if (!last) return;
  // A message that cannot be read also counts as an answer, so the next message may be sent.
  answered_ = true;
  // The first message of a connection may come without a request, so got_ must not exceed asked_.
  got_ = std::min(got_ + 1, asked_);
  answered_at_ = machineNow();
  if (!too_long_) message(partial_);
  partial_.clear();
  too_long_ = false;
}

void Service::message(std::string_view bytes) {
  const std::int64_t now = now_();
  if (readMessage(bytes, in_) != Verdict::kState) return;
  // Later messages may lack session_id, so the highest generation of a connection is kept.
  generation_ = std::max(generation_, in_.generation);
  // No message states which handle is on which arm. Assigns the first awake handle to the first
  // arm, the second to the second.
  std::array<const GripState*, kMaxGrips> awake{};
  std::size_t awake_count = 0;
  for (std::size_t i = 0; i < in_.grip_count; ++i) {
    if (in_.grips[i].turned) awake[awake_count++] = &in_.grips[i];
  }
  for (std::size_t i = 0; i < in_.arm_count; ++i) {
    const ArmState& arm = in_.arms[i];
    for (auto& one : lines_) {
      Line* line = one.load();
      if (line == nullptr || line->id.view() != arm.id.view()) continue;
      if (arm.powered >= 0) line->powered = arm.powered;
      if (arm.ready >= 0) line->ready = arm.ready;
      if (arm.calibrated >= 0) line->calibrated = arm.calibrated;
      if (!arm.placed) continue;
      Reading& reading = line->readings.draft();
      reading.taken = now;
      reading.arm = arm;
      reading.grip = i < awake_count ? *awake[i] : GripState{};
      line->readings.publish();
      line->heard = now;
      line->away = false;
    }
  }
  const std::lock_guard lock(mutex_);
  inventory_.answered = true;
  inventory_.generation = generation_;
  // Keeps the properties that the service sends only once.
  std::vector<Named> named;
  for (std::size_t i = 0; i < in_.arm_count; ++i) {
    const ArmState& arm = in_.arms[i];
    const auto known = std::find_if(inventory_.arms.begin(), inventory_.arms.end(),
                                    [&](const Named& n) { return n.id.view() == arm.id.view(); });
    ArmConfig config = arm.config;
    if (!arm.configured && known != inventory_.arms.end()) config = known->config;
    named.push_back({arm.id, config});
  }
  inventory_.arms = std::move(named);
  for (std::size_t i = 0; i < in_.grip_count; ++i) {
    inventory_.button_count = std::max(inventory_.button_count, in_.grips[i].button_count);
    inventory_.grips = inventory_.grips || in_.grips[i].turned;
  }
}

void Service::attend(std::int64_t machine) {
  const std::int64_t now = now_();
  bool served = false;
  for (auto& one : lines_) {
    Line* line = one.load();
    if (line == nullptr || line->told_zero) continue;
    served = true;
    if (!line->away && now - line->heard >= kSilence) lose(*line);
  }
  const bool known = generation_ == Generation::k31 || generation_ == Generation::k35;
  const std::int64_t pause = !served || !known ? kAskForArms : answered_ ? kPeriod : kAskAgain;
  // The service handles all waiting messages before a new zero force, so their number is limited.
  const bool full = asked_ - got_ >= kMostUnanswered;
  // After kSilence without an answer, the missing answers count as lost.
  if (full && machine - std::max(sent_, answered_at_) >= kSilence) got_ = asked_;
  if (!full && machine - sent_ >= pause) lws_callback_on_writable(wsi_);
}

int Service::writable(lws* to) {
  const std::int64_t now = now_();
  std::array<char, LWS_PRE + kRoom> room{};
  const std::span<char> text(room.data() + LWS_PRE, kRoom);
  std::array<ForceTo, kMaxArms> forces{};
  std::array<Line*, kMaxArms> served{};
  // Line::leaves, read before the arm's force: if it is true, the force is zero.
  std::array<bool, kMaxArms> leaving{};
  std::array<std::uint64_t, kMaxArms> stops{};
  std::size_t count = 0;
  for (auto& one : lines_) {
    Line* line = one.load();
    if (line == nullptr) continue;
    leaving[count] = line->leaves;
    stops[count] = line->stops;
    served[count] = line;
    forces[count++] = {line->id.view(), wanted(*line, now)};
  }
  std::size_t size =
      count == 0 ? 0 : writeForces(generation_, {forces.data(), count}, !introduced_, text);
  const bool driving = size > 0;
  if (!driving) {
    size = kAskForAll.size();
    std::copy(kAskForAll.begin(), kAskForAll.end(), text.begin());
  }
  if (lws_write(to, reinterpret_cast<unsigned char*>(text.data()), size, LWS_WRITE_TEXT) < 0) {
    return -1;
  }
  answered_ = false;
  ++asked_;
  sent_ = machineNow();
  introduced_ = introduced_ || driving;
  for (std::size_t i = 0; i < count; ++i) {
    // The force was chosen after `stops` was read, so it obeys all these stops.
    served[i]->obeyed = stops[i];
    if (leaving[i] && !served[i]->told_zero) {
      served[i]->told_zero = true;
      served[i]->told_in = asked_;
    }
  }
  return 0;
}

void Service::letGo(std::int64_t machine) {
  for (auto& one : lines_) {
    Line* line = one.load();
    if (line == nullptr || !line->leaves) continue;
    // Waits for the answer to the zero force: if a socket is closed with an unread answer, the zero
    // may be lost.
    if (line->leaves_at == 0) line->leaves_at = machine;
    const bool told =
        (line->told_zero && got_ >= line->told_in) || machine - line->leaves_at > kLeaving;
    if (up_ && !told) continue;
    one = nullptr;
    line->left = true;
  }
}

void Service::connect(lws_context* context, std::int64_t machine) {
  tried_ = machine;
  lws_client_connect_info info{};
  info.context = context;
  info.address = address_.host.c_str();
  info.host = info.address;
  info.origin = info.address;
  info.port = address_.port;
  info.path = address_.path.c_str();
  info.local_protocol_name = kProtocols[0].name;
  info.ietf_version_or_minus_one = -1;
  info.pwsi = &wsi_;
  if (lws_client_connect_via_info(&info) == nullptr) wsi_ = nullptr;
}

void Service::run() {
  lws_set_log_level(0, nullptr);
  lws_context_creation_info info{};
  info.port = CONTEXT_PORT_NO_LISTEN;
  info.protocols = kProtocols.data();
  info.user = this;
  // Without this, libwebsockets would connect to the proxy in the environment variable http_proxy.
  info.http_proxy_address = "";
  lws_context* context = lws_create_context(&info);
  while (!ends_) {
    const std::int64_t machine = machineNow();
    if (context != nullptr && wsi_ == nullptr && (tried_ == 0 || machine - tried_ >= kTryAgain)) {
      connect(context, machine);
    }
    if (up_) attend(machine);
    if (context != nullptr) lws_service(context, -1);
    letGo(machineNow());
    const int fd = wsi_ != nullptr ? static_cast<int>(lws_get_socket_fd(wsi_)) : -1;
    sleepFor(fd, up_ ? kPeriod / 2 : std::min(kIdle, kTryAgain));
  }
  if (context != nullptr) lws_context_destroy(context);
}

}  // namespace palpate::haply
