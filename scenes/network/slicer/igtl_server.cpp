#include "palpate/scenes/network/slicer/igtl_server.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <exception>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <new>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/realtime.h"
#include "palpate/scenes/apps/common/asked.h"
#include "palpate/scenes/network/slicer/igtl_client.h"

namespace palpate::cli {
namespace {

const char* const kSubject = "--igtl";
constexpr std::size_t kMostClients = 4;
/// Number of clients that may wait. These clients can only cut the force.
constexpr std::size_t kMostWaiting = 16;
constexpr int kBacklog = 128;           ///< Connections that the system queues for the server.
constexpr int kMostAtOnce = 64;         ///< Connections accepted in one round.
constexpr int kSocketBuffer = 1 << 16;  ///< Size of a client's send buffer in the system [bytes].
constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kLook = kSecond / 10;
constexpr std::int64_t kPatience =
    5 * kSecond;                      ///< Base of the time in which a message must arrive [ns].
constexpr std::int64_t kByte = 1000;  ///< Additional time for each byte [ns].
/// The server ends a connection if the client has not read for this time [ns].
constexpr std::int64_t kStuck = 5 * kSecond;

std::string shownPlace(const sockaddr_storage& address, socklen_t size) {
  std::array<char, NI_MAXHOST> host{};
  std::array<char, NI_MAXSERV> port{};
  if (getnameinfo(reinterpret_cast<const sockaddr*>(&address), size, host.data(), host.size(),
                  port.data(), port.size(), NI_NUMERICHOST | NI_NUMERICSERV) != 0) {
    return "an unknown client";
  }
  const std::string name = host.data();
  return (name.find(':') == std::string::npos ? name : "[" + name + "]") + ":" + port.data();
}

/// Returns `what` for the first hand, and `what` with a number from 2 for the others.
std::string nameOf(const char* what, std::size_t hand) {
  return hand == 0 ? what : fmt::format("{}{}", what, hand + 1);
}

}  // namespace

std::int64_t sinceEpoch() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

IgtlPlace igtlPlace(const std::string& words) {
  IgtlPlace place;
  std::string port = words;
  const std::size_t colon = words.rfind(':');
  if (colon != std::string::npos) {
    place.address = words.substr(0, colon);
    port = words.substr(colon + 1);
    if (place.address.size() > 2 && place.address.front() == '[' && place.address.back() == ']') {
      place.address = place.address.substr(1, place.address.size() - 2);
    }
  }
  constexpr int kMostPort = 65535;
  const bool digits =
      !port.empty() && port.size() <= 5 &&
      std::all_of(port.begin(), port.end(), [](char c) { return c >= '0' && c <= '9'; });
  const int number = digits ? std::stoi(port) : -1;
  if (number < 0 || number > kMostPort || place.address.empty()) {
    throw Error(kSubject,
                "\"" + words + "\" is not a port of 0 to 65535, or an address and such a port",
                "give a port such as 18944, or an address and a port such as 192.168.0.2:18944");
  }
  place.port = static_cast<std::uint16_t>(number);
  return place;
}

IgtlServer::IgtlServer(const IgtlPlace& place, double rate, bool images)
    : rate_(rate), images_(images), counts_(std::make_unique<Counts>()) {
  addrinfo wanted{};
  wanted.ai_socktype = SOCK_STREAM;
  wanted.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV | AI_PASSIVE;
  addrinfo* found = nullptr;
  const std::string port = std::to_string(place.port);
  if (getaddrinfo(place.address.c_str(), port.c_str(), &wanted, &found) != 0) {
    throw Error(kSubject, "\"" + place.address + "\" is not a numeric address",
                "give an address of this machine, such as 127.0.0.1");
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> owner(found, &freeaddrinfo);
  listener_ = socket(found->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  const int yes = 1;
  if (listener_ < 0 || setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
      bind(listener_, found->ai_addr, found->ai_addrlen) != 0 || listen(listener_, kBacklog) != 0) {
    const int error = errno;
    if (listener_ >= 0) close(listener_);
    throw Error(kSubject, place.address + ":" + port + ": " + std::strerror(error),
                error == EADDRINUSE ? "give another port, or end the program that uses port " + port
                                    : "give an address of this machine and a port above 1023");
  }
  sockaddr_storage here{};
  socklen_t size = sizeof here;
  getsockname(listener_, reinterpret_cast<sockaddr*>(&here), &size);
  place_ = shownPlace(here, size);
}

IgtlServer::~IgtlServer() {
  quit_ = true;
  if (thread_.joinable()) thread_.join();
  close(listener_);
}

HandTarget IgtlServer::hand(const Vec3& start) {
  led_ = true;
  return behindMouse(aim_, start);
}

void IgtlServer::begin() {
  thread_ = std::thread([this] { run(); });
}

void IgtlServer::cuts(std::vector<HapticThread*> hands) {
  const std::lock_guard lock(mutex_);
  hands_ = std::move(hands);
  if (hands_.empty() || !std::exchange(cut_asked_, false)) return;
  for (HapticThread* hand : hands_) hand->cut();
}

void IgtlServer::expect(const BuiltScene& scene) {
  Stage& stage = stage_.draft();
  stage = {};
  if (scene.placements.empty()) {
    stage.first.scale = 1e-3;  // without a volume, messages are in W, in millimetres
  }
  for (const auto& [name, volume] : scene.volumes) {
    const bool whole = scene.computed.count(name) == 0 && scene.windows.count(name) == 0 &&
                       scene.sequences.count(name) == 0;
    if (whole) stage.volumes.insert(name);
  }
  for (const auto& [name, place] : scene.placements) {
    if (scene.computed.count(name) != 0) continue;
    stage.first = place;
    break;
  }
  stage_.publish();
}

void IgtlServer::show(const IgtlShown& shown) {
  shown_.draft() = shown;
  shown_.publish();
}

void IgtlServer::tell(const std::string& news, bool refused) {
  const std::lock_guard lock(mutex_);
  news_ = sentence(news).text();
  if (refused) refusal_ = {taken_from_, news};
}

std::shared_ptr<const IgtlImage> IgtlServer::takeImage() {
  const std::lock_guard lock(mutex_);
  taken_from_ = sender_;
  return std::exchange(image_, nullptr);
}

OrderedJson IgtlServer::summary() const {
  return {{"place", place_},
          {"connections", counts_->connections.load()},
          {"refused", counts_->refused.load()},
          {"ended", counts_->ended.load()},
          {"sent", counts_->sent.load()},
          {"skipped", counts_->skipped.load()},
          {"received", counts_->received.load()},
          {"images", counts_->images.load()}};
}

void IgtlServer::run() {
  while (!quit_) {
    try {
      round();
    } catch (const std::exception& error) {
      // If memory has run out, the next round may succeed.
      clients_.clear();
      const bool memory = dynamic_cast<const std::bad_alloc*>(&error) != nullptr;
      complaints_.say(
          memory ? "igtl: all connections are closed, because memory ran out: end other programs, "
                   "and connect again"
                 : fmt::format("igtl: all connections are closed, because the server failed ({}): "
                               "connect again, and report this message",
                               error.what()));
    }
  }
  clients_.clear();
  complaints_.end();
  greetings_.end();
}

void IgtlServer::round() {
  std::vector<pollfd> wanted;
  for (const auto& client : clients_) {
    const bool out = client->out_at < client->out.size();
    wanted.push_back({client->socket, static_cast<short>(POLLIN | (out ? POLLOUT : 0)), 0});
  }
  std::int64_t now = nowNs();
  wanted.push_back({now < deaf_until_ ? -1 : listener_, POLLIN, 0});
  std::int64_t rest = kLook;
  if (!clients_.empty()) rest = std::min(rest, std::max<std::int64_t>(0, next_ - now));
  const timespec until{0, rest};
  (void)ppoll(wanted.data(), wanted.size(), &until, nullptr);

  now = nowNs();
  for (std::size_t i = 0; i < clients_.size(); ++i) {
    Client& client = *clients_[i];
    try {
      if ((wanted[i].revents & POLLOUT) != 0) flush(client);
      if ((wanted[i].revents & (POLLIN | POLLHUP | POLLERR)) != 0) read(client);
      if (client.socket >= 0) endLate(client);
    } catch (const std::bad_alloc&) {
      drop(client, "there is not enough memory for its message");
    } catch (const Error& error) {
      drop(client, error.what());
    }
  }
  answerRefusal();
  if ((wanted.back().revents & POLLIN) != 0) accept();
  complaints_.look();
  greetings_.look();
  if (now >= next_) {
    const auto period = static_cast<std::int64_t>(1e9 / rate_);
    next_ += period;
    if (next_ <= now) next_ = now + period;
    send();
  }
  std::erase_if(clients_, [](const auto& client) { return client->socket < 0; });
  // Assigns free places to the clients that connected first.
  for (std::size_t i = 0; i < std::min(clients_.size(), kMostClients); ++i) {
    if (std::exchange(clients_[i]->waits, false)) {
      greetings_.say("igtl: " + clients_[i]->peer + " is connected");
    }
  }
}

void IgtlServer::accept() {
  for (int i = 0; i < kMostAtOnce; ++i) {
    sockaddr_storage from{};
    socklen_t size = sizeof from;
    const int socket =
        accept4(listener_, reinterpret_cast<sockaddr*>(&from), &size, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (socket < 0) {
      // If accept4() fails, for example for lack of descriptors, accepts no connection for 0.1 s.
      if (errno != EAGAIN && errno != EWOULDBLOCK) deaf_until_ = nowNs() + kLook;
      return;
    }
    ++counts_->connections;
    const auto waits = [](const auto& client) { return client->waits && client->socket >= 0; };
    const auto served = [](const auto& client) { return !client->waits && client->socket >= 0; };
    const bool crowded = std::count_if(clients_.begin(), clients_.end(), served) >=
                         static_cast<std::ptrdiff_t>(kMostClients);
    if (crowded) {
      ++counts_->refused;
      complaints_.say(fmt::format("igtl: {} waits: {} clients are connected: disconnect one",
                                  shownPlace(from, size), kMostClients));
      // Drops the client that has waited longest: this client had the most time to send a cut.
      if (std::count_if(clients_.begin(), clients_.end(), waits) >=
          static_cast<std::ptrdiff_t>(kMostWaiting)) {
        drop(**std::find_if(clients_.begin(), clients_.end(), waits), "");
      }
    }
    const int yes = 1;
    setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    setsockopt(socket, SOL_SOCKET, SO_SNDBUF, &kSocketBuffer, sizeof kSocketBuffer);
    clients_.push_back(std::make_unique<Client>(socket, shownPlace(from, size)));
    clients_.back()->number = static_cast<std::uint64_t>(counts_->connections);
    clients_.back()->took = nowNs();
    clients_.back()->waits = crowded;
    if (crowded) continue;
    greetings_.say("igtl: " + clients_.back()->peer + " is connected");
  }
}

void IgtlServer::drop(Client& client, const std::string& why) {
  if (client.socket < 0) return;
  close(client.socket);
  client.socket = -1;
  client.body = {};
  if (why.empty()) return;
  ++counts_->ended;
  complaints_.say("igtl: " + client.peer + ": " + why + ": its connection is closed");
}

void IgtlServer::Seldom::say(const std::string& line) {
  last_ = line;
  ++more_;
  look();
}

void IgtlServer::Seldom::look() {
  const std::int64_t now = nowNs();
  if (more_ == 0 || now < next_) return;
  next_ = now + kSecond;
  const std::int64_t before = std::exchange(more_, 0) - 1;
  complain(before > 0 ? fmt::format("{} ({} earlier lines not shown)", last_, before) : last_);
}

void IgtlServer::Seldom::end() {
  next_ = 0;
  look();
}

std::string IgtlServer::statusOf(const IgtlShown& shown) {
  OrderedJson hands = OrderedJson::array();
  for (std::size_t h = 0; h < shown.count; ++h) {
    const Fault fault = shown.hands[h].fault;
    const bool cut = fault != Fault::kNone;
    hands.push_back({{"state", cut                    ? "cut"
                               : shown.hands[h].begun ? "felt"
                                                      : "waits"},
                     {"fault", cut ? OrderedJson(wordsFor(fault)) : OrderedJson()},
                     {"remedy", cut ? OrderedJson(remedyFor(fault)) : OrderedJson()}});
  }
  const std::lock_guard lock(mutex_);
  const OrderedJson status{{"hands", hands},
                           {"image", news_.empty() ? OrderedJson() : OrderedJson(news_)}};
  return status.dump(-1, ' ', true, OrderedJson::error_handler_t::replace);
}

void IgtlServer::send() {
  if (clients_.empty()) return;
  (void)shown_.refresh();
  (void)stage_.refresh();
  const IgtlShown& shown = shown_.current();
  if (shown.count == 0) return;
  const Placement& place = stage_.current().first;
  const std::int64_t at = sinceEpoch();
  Bytes all;
  const auto add = [&all](const Bytes& message) {
    all.insert(all.end(), message.begin(), message.end());
  };
  for (std::size_t h = 0; h < shown.count; ++h) {
    const IgtlHand& hand = shown.hands[h];
    if (!hand.begun) continue;
    const auto in_file = [&](const Vec3& p_W) -> Vec3 {
      return place.rotation.transpose() * (p_W - place.translate) / place.scale;
    };
    add(igtlTransform(nameOf("PalpateHand", h), at, in_file(hand.probe)));
    add(igtlTransform(nameOf("PalpateProxy", h), at, in_file(hand.proxy)));
    const Vec3 force = place.rotation.transpose() * hand.force;
    add(igtlString(nameOf("PalpateForce", h), at,
                   fmt::format("{:.6g} {:.6g} {:.6g}", force.x(), force.y(), force.z())));
  }
  const std::int64_t now = nowNs();
  std::string status = statusOf(shown);
  if (status != status_ || now >= next_status_) {
    next_status_ = now + kSecond;
    status_ = std::move(status);
    for (const auto& client : clients_) client->wants_status = true;
  }
  const Bytes told = igtlString("PalpateStatus", at, status_);
  for (const auto& client : clients_) {
    if (client->socket < 0 || client->waits) continue;
    // A client that has not read all previous messages gets no new messages.
    if (client->out_at < client->out.size()) {
      ++counts_->skipped;
      continue;
    }
    ++counts_->sent;
    client->out.insert(client->out.end(), all.begin(), all.end());
    if (std::exchange(client->wants_status, false)) {
      client->out.insert(client->out.end(), told.begin(), told.end());
    }
    flush(*client);
  }
}

void IgtlServer::flush(Client& client) {
  while (client.socket >= 0 && client.out_at < client.out.size()) {
    const ssize_t sent = ::send(client.socket, client.out.data() + client.out_at,
                                client.out.size() - client.out_at, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent < 0) {
      if (errno == EINTR) continue;
      if (errno != EAGAIN && errno != EWOULDBLOCK) drop(client, "");
      return;
    }
    client.out_at += static_cast<std::size_t>(sent);
    client.took = nowNs();
  }
  client.out.clear();
  client.out_at = 0;
  client.took = nowNs();
}

void IgtlServer::endLate(Client& client) {
  const std::int64_t now = nowNs();
  if (client.out_at < client.out.size() && now - client.took > kStuck) {
    return drop(client, "it has not read its data for 5 s");
  }
  if (!client.within()) return;
  const auto come = static_cast<std::int64_t>(client.head.size - client.left);
  if (now - client.begun > kPatience + come * kByte) {
    drop(client, "its message takes longer than 5 s plus 1 s per MB");
  }
}

}  // namespace palpate::cli
