/// Receives and answers clients' messages.
#include <algorithm>
#include <array>
#include <cerrno>
#include <sys/socket.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/loop/realtime.h"
#include "palpate/scenes/network/slicer/igtl_client.h"

namespace palpate::cli {
namespace {

constexpr std::size_t kPiece = 1U << 16U;
/// Limit of the size of all messages except IMAGE [bytes].
constexpr std::uint64_t kMostSmall = 1U << 16U;
/// Limit of the coordinates of the hand that a client leads [units of the volume's file, such as
/// mm].
constexpr double kFarthestHand = 1e9;
constexpr std::array<const char*, 6> kTypes{"TRANSFORM", "STRING",     "IMAGE",
                                            "STATUS",    "GET_STATUS", "GET_CAPABIL"};

bool begins(const std::string& text, const char* with) {
  return text.rfind(with, 0) == 0;
}

}  // namespace

bool IgtlServer::full() {
  const auto on_its_way = [](const auto& client) { return client->isImage(); };
  if (std::any_of(clients_.begin(), clients_.end(), on_its_way)) return true;
  const std::lock_guard lock(mutex_);
  return image_ != nullptr;
}

void IgtlServer::read(Client& client) {
  if (client.socket < 0) return;
  std::array<std::uint8_t, kPiece> piece;  // NOLINT: filled by recv
  const ssize_t got = recv(client.socket, piece.data(), piece.size(), MSG_DONTWAIT);
  if (got == 0) return drop(client, "");
  if (got < 0) {
    if (errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR) drop(client, "");
    return;
  }
  feed(client, {piece.data(), static_cast<std::size_t>(got)});
}

void IgtlServer::feed(Client& client, ByteView bytes) {
  while (!bytes.empty()) {
    if (client.at == Client::At::kHead) {
      if (!client.within()) client.begun = nowNs();
      const std::size_t take = std::min(bytes.size(), kIgtlHead - client.head_count);
      std::copy_n(bytes.begin(), take, client.head_bytes.begin() + client.head_count);
      client.head_count += take;
      bytes = bytes.subspan(take);
      if (client.head_count < kIgtlHead) return;
      beginBody(client);
    } else {
      const std::size_t take =
          static_cast<std::size_t>(std::min<std::uint64_t>(bytes.size(), client.left));
      const ByteView taken = bytes.first(take);
      client.crc = igtlCrc(taken, client.crc);
      // Allocates memory only as bytes arrive, because a client can announce any size.
      if (client.at == Client::At::kBody) {
        const std::size_t most = client.body.size() + static_cast<std::size_t>(client.left);
        if (client.body.size() + take > client.body.capacity()) {
          client.body.reserve(std::min(most, 2 * (client.body.size() + take)));
        }
        client.body.insert(client.body.end(), taken.begin(), taken.end());
      }
      client.left -= take;
      bytes = bytes.subspan(take);
    }
    if (client.left == 0) endBody(client);
  }
}

void IgtlServer::beginBody(Client& client) {
  client.head = readIgtlHead(client.head_bytes);
  const IgtlHead& head = client.head;
  const bool image = head.type == "IMAGE" && !client.waits;
  const bool busy = image && full();
  const bool kept = image || (head.type == "TRANSFORM" && !client.waits) || head.type == "STRING";
  constexpr int kNewest = 3;
  if (head.version < 1 || head.version > kNewest || head.type.empty()) {
    throw Error("a message", "its header is not one of OpenIGTLink (unknown version, or no type)",
                "send version 1, 2 or 3, and a type");
  }
  const std::uint64_t most = kept && !image ? kMostSmall : kIgtlMostImage + kPiece;
  if (head.size > most) {
    throw Error(
        head.type, fmt::format("its body has {} bytes", head.size),
        image ? std::string("send at most 512 MiB") : fmt::format("send at most {} bytes", most));
  }
  client.left = head.size;
  client.crc = 0;
  client.body.clear();
  client.answers = false;
  client.at = kept ? Client::At::kBody : Client::At::kSkip;
  if (!image) return;
  (void)stage_.refresh();
  const auto refuse = [&](IgtlCode code, const char* why) {
    client.at = Client::At::kSkip;
    client.answers = true;
    client.answer = code;
    client.why = "IMAGE " + head.name + ": " + why;
  };
  if (!images_) {
    refuse(
        IgtlCode::kDisabled,
        "the run is recorded, and a recording cannot hold images: start palpate without --record");
  } else if (stage_.current().volumes.count(head.name) == 0) {
    refuse(IgtlCode::kNotFound,
           "the scene has no volume of that name in memory: name the image like a volume that is "
           "neither in bricks nor a sequence");
  } else if (busy) {
    // Rejects the image before its body, because a cut may follow the body.
    refuse(IgtlCode::kBusy, "another image is still loading: send this image again");
  }
}

void IgtlServer::endBody(Client& client) {
  const IgtlHead head = std::exchange(client.head, {});
  Bytes body = std::exchange(client.body, {});
  const bool kept = std::exchange(client.at, Client::At::kHead) == Client::At::kBody;
  client.head_count = 0;
  if (client.crc != head.crc) {
    throw Error(head.type, "its checksum is wrong", "send the CRC-64 of the body");
  }
  ++counts_->received;
  if (client.answers) {
    complaints_.say("igtl: " + client.peer + ": " + client.why);
    return reply(client, client.answer, client.why);
  }
  if (!kept) {
    if (client.waits) return;
    if (head.type == "GET_STATUS") return reply(client, IgtlCode::kOk, "palpate");
    if (head.type == "GET_CAPABIL") {
      const Bytes answer = igtlCapability("Palpate", sinceEpoch(), kTypes);
      if (client.out.size() < Client::kMostOut) {
        client.out.insert(client.out.end(), answer.begin(), answer.end());
      }
      return flush(client);
    }
    if (begins(head.type, "GET_") || begins(head.type, "STT_") || begins(head.type, "STP_")) {
      reply(client, IgtlCode::kUnknown,
            head.type + ": the server sends all data without a request");
    }
    return;
  }
  if (head.type == "IMAGE") return keepImage(client, head, std::move(body));
  const ByteView content = igtlContent(head, body);
  if (head.type == "STRING") {
    const std::string words = readIgtlString(content);
    if (head.name == "PalpateCommand") obey(client, words);
    return;
  }
  const Vec3 place = readIgtlTransform(content);
  if (head.name != "PalpateSteer") return;
  if (!led_) {
    return reply(client, IgtlCode::kDisabled,
                 "no hand follows clients: start palpate with --device igtl");
  }
  if (place.lpNorm<Eigen::Infinity>() > kFarthestHand) {
    throw Error("PalpateSteer", "a coordinate is beyond 1e9 units of the volume's file",
                "send the position in this unit, such as mm");
  }
  (void)stage_.refresh();
  const Vec3 p_W = stage_.current().first(place);
  aim_.write({{p_W.x(), p_W.y(), p_W.z()}});
}

void IgtlServer::keepImage(Client& client, const IgtlHead& head, Bytes body) {
  std::shared_ptr<const IgtlImage> image;
  try {
    image = std::make_shared<const IgtlImage>(readIgtlImage(head, std::move(body)));
  } catch (const Error& error) {
    // The size and the checksum of the message are right, so the connection continues.
    complaints_.say("igtl: " + client.peer + ": " + error.what());
    return reply(client, IgtlCode::kInvalid, error.what());
  }
  ++counts_->images;
  const std::lock_guard lock(mutex_);
  image_ = std::move(image);
  sender_ = client.number;
}

void IgtlServer::answerRefusal() {
  Refusal refusal;
  {
    const std::lock_guard lock(mutex_);
    refusal = std::exchange(refusal_, {});
  }
  if (refusal.why.empty()) return;
  for (const auto& client : clients_) {
    if (client->socket < 0 || client->number != refusal.client) continue;
    reply(*client, IgtlCode::kInvalid, refusal.why);
  }
}

void IgtlServer::obey(Client& client, const std::string& words) {
  if (words == "cut") {
    {
      const std::lock_guard lock(mutex_);
      for (HapticThread* hand : hands_) hand->cut();
      cut_asked_ = hands_.empty();  // cuts() then cuts the hands
    }
    return reply(client, IgtlCode::kOk, "cut");
  }
  if (words == "clear") {
    return reply(client, IgtlCode::kDenied, "only a user at the arm can restore the force");
  }
  reply(client, IgtlCode::kUnknown, "unknown command: send cut");
}

void IgtlServer::reply(Client& client, IgtlCode code, const std::string& text) {
  // A client that does not read its answers gets no further answers.
  if (client.out.size() >= Client::kMostOut) return;
  const Bytes answer = igtlStatus("Palpate", sinceEpoch(), code, sentence(text).text());
  client.out.insert(client.out.end(), answer.begin(), answer.end());
  flush(client);
}

}  // namespace palpate::cli
