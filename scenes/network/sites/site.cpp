#include "palpate/scenes/network/sites/site.h"

#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <dds/dds.h>
#include <mutex>
#include <netdb.h>
#include <new>
#include <optional>
#include <string_view>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/devices/arm/arm.h"
#include "palpate/engine/error.h"
#include "palpate/samplers/module.h"
#include "palpate/scenes/network/sites/site_security.h"
#include "site_topics.h"

namespace palpate {
namespace {

using Clock = std::chrono::steady_clock;

/// If no other site is heard for this time after the start, takeNews() returns a line about it.
constexpr auto kAlone = std::chrono::seconds(3);
constexpr auto kEvery = std::chrono::milliseconds(4);  ///< Time between two polls.
constexpr auto kRest = std::chrono::milliseconds(50);  ///< Time between messages of a resting hand.
constexpr double kSmallWay = 1e-4;   ///< A smaller motion of the proxy waits for kRest [m].
constexpr double kSmallGift = 1e-5;  ///< A smaller change of an energy waits for kRest [J].
constexpr std::uint32_t kMostAtOnce = 64;
constexpr auto kSceneEvery = std::chrono::milliseconds(200);  ///< Time between two scene texts.
/// While this number of texts or more waits for takeScenes(), hearScenes() reads no further texts.
constexpr std::size_t kMostScenes = kMostLinks;

/// Returns a number for the site's name; not 0.
std::uint64_t numberOfSite(const std::string& name) noexcept {
  return fingerprintOf(name) | 1U;
}

/// Returns the local address from which packets to `address` are sent. Throws Error.
std::string addressTowards(const std::string& address) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_DGRAM;
  hints.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (getaddrinfo(address.c_str(), "7400", &hints, &found) != 0) {
    throw Error("--with", fmt::format("\"{}\" is not a numeric address", address),
                "give an address such as 10.0.0.2");
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> freed(found, &freeaddrinfo);
  const int s = socket(found->ai_family, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_storage own{};
  socklen_t size = sizeof own;
  std::array<char, NI_MAXHOST> text{};
  // connect() of a datagram socket sends no packet, but selects the local address.
  const bool known = s >= 0 && connect(s, found->ai_addr, found->ai_addrlen) == 0 &&
                     getsockname(s, reinterpret_cast<sockaddr*>(&own), &size) == 0 &&
                     getnameinfo(reinterpret_cast<sockaddr*>(&own), size, text.data(), text.size(),
                                 nullptr, 0, NI_NUMERICHOST) == 0;
  const int error = errno;
  if (s >= 0) close(s);
  if (!known) {
    throw Error("--with",
                fmt::format("this machine cannot send to {} ({})", address, std::strerror(error)),
                "check the address and the network");
  }
  return text.data();
}

/// Returns DDS's configuration. The configuration disables multicast, so DDS announces this site
/// only to the named machines.
std::string configOf(const SiteParams& params) {
  std::vector<std::string> peers = params.with;
  if (peers.empty()) peers.emplace_back("127.0.0.1");
  std::string text;
  for (const std::string& peer : peers) text += fmt::format("<Peer address=\"{}\"/>", peer);
  return fmt::format(
      "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface address=\"{}\"/>"
      "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>"
      "auto</ParticipantIndex><MaxAutoParticipantIndex>{}</MaxAutoParticipantIndex><Peers>{}"
      "</Peers><LeaseDuration>2s</LeaseDuration><SPDPInterval>500ms</SPDPInterval></"
      "Discovery><Tracing><Verbosity>none</Verbosity>"
      "</Tracing></Domain></CycloneDDS>",
      addressTowards(peers.front()), 2 * kMostLinks, text);
}

/// Stores only DDS's first log line, because a peer can cause any number of lines. DDS has one log
/// sink, so only one object may exist.
class Complaints {
 public:
  Complaints() {
    {
      const std::lock_guard lock(mutex());
      told() = {};
    }
    dds_set_log_sink(&Complaints::hear, nullptr);
  }
  Complaints(const Complaints&) = delete;
  Complaints& operator=(const Complaints&) = delete;
  ~Complaints() { dds_set_log_sink(nullptr, nullptr); }

  /// Returns the first line once; otherwise "".
  [[nodiscard]] static std::string take() {
    const std::lock_guard lock(mutex());
    return std::exchange(told().line, {});
  }

 private:
  static constexpr std::size_t kLongest = 200;
  struct Told {
    bool any = false;
    std::string line;
  };
  static void hear(void* /*unused*/, const dds_log_data_t* of) noexcept {
    std::string_view words(of->message, std::min(of->size, kLongest));
    while (words.ends_with('\n')) words.remove_suffix(1);
    const std::lock_guard lock(mutex());
    if (std::exchange(told().any, true)) return;
    try {
      told().line = words;
      // A name in a certificate may contain any characters.
      std::replace_if(
          told().line.begin(), told().line.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
    } catch (const std::bad_alloc&) {
      told().line.clear();
    }
  }
  static std::mutex& mutex() noexcept {
    static std::mutex one;
    return one;
  }
  static Told& told() noexcept {
    static Told one;
    return one;
  }
};

using Qos = std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)>;

/// Returns the entity. Throws Error with the reason if DDS could not create it.
dds_entity_t need(dds_entity_t entity, const char* what) {
  if (entity >= 0) return entity;
  throw Error("--site", fmt::format("DDS cannot create {} ({})", what, dds_strretcode(-entity)),
              "check the network, and the number of sites on this machine");
}

std::array<double, 3> numbers(const Vec3& v) noexcept {
  return {v.x(), v.y(), v.z()};
}

class DdsSite final : public Site {
 public:
  DdsSite(const SiteParams& params, HandLinks& links)
      : name_(params.name), number_(numberOfSite(name_)), links_(links) {
    open(params);
    try {
      thread_ = std::thread([this] { run(); });
    } catch (...) {
      dds_delete(domain_);
      throw;
    }
  }
  DdsSite(const DdsSite&) = delete;
  DdsSite& operator=(const DdsSite&) = delete;
  ~DdsSite() override {
    {
      const std::lock_guard lock(mutex_);
      quit_ = true;
    }
    wake_.notify_all();
    thread_.join();
    dds_delete(domain_);
  }

  std::vector<std::string> takeNews() override {
    const std::lock_guard lock(mutex_);
    if (std::exchange(failed_, false)) {
      news_.emplace_back(
          "site: the connection to other sites ended for lack of memory: free memory, and start "
          "again");
    }
    if (const std::string line = Complaints::take(); !line.empty()) {
      news_.push_back(fmt::format("site: DDS: {}; further messages of DDS are not shown", line));
    }
    return std::exchange(news_, {});
  }
  std::map<std::string, SiteState> others() const override {
    const std::lock_guard lock(mutex_);
    std::map<std::string, SiteState> all;
    for (const auto& [name, other] : others_) all.emplace(name, other.state);
    return all;
  }
  void tellScene(std::string text) override {
    const std::lock_guard lock(mutex_);
    scene_ = std::move(text);
  }
  std::map<std::string, std::string> takeScenes() override {
    const std::lock_guard lock(mutex_);
    return std::exchange(scenes_, {});
  }

 private:
  struct Other {
    SiteState state;
    std::size_t slot = kMostLinks;  ///< kMostLinks: no slot.
    dds_instance_handle_t writer = 0;
    std::uint64_t first = 0;   ///< First message number of this writer.
    std::uint64_t newest = 0;  ///< Newest message number of this writer, or 0.
    std::uint64_t count = 0;
    Clock::time_point last;
    bool gone = true;
  };

  [[nodiscard]] static dds_entity_t join(dds_domainid_t domain, const std::string& keys) {
    if (keys.empty()) {
      return need(dds_create_participant(domain, nullptr, nullptr), "a participant");
    }
    const Qos qos(dds_create_qos(), &dds_delete_qos);
    secure(qos.get(), keys);
    const dds_entity_t participant = dds_create_participant(domain, qos.get(), nullptr);
    if (participant >= 0) return participant;
    std::string why = Complaints::take();
    if (why.empty()) why = dds_strretcode(-participant);
    throw Error(
        "--site-keys",
        fmt::format("DDS rejects the keys in {}, or cannot join its domain ({})", keys, why),
        "make new keys with site_keys.sh (docs/sites.md), or check the network and the number of "
        "sites on this machine");
  }

  void open(const SiteParams& params) {
    const auto domain = static_cast<dds_domainid_t>(params.domain);
    domain_ = need(dds_create_domain(domain, configOf(params).c_str()), "its domain");
    try {
      const dds_entity_t participant = join(domain, params.keys);
      const dds_entity_t topic = need(
          dds_create_topic(participant, &palpate_site_Hand_desc, "palpate_hand", nullptr, nullptr),
          "the topic of hands");
      const Qos held(dds_create_qos(), &dds_delete_qos);
      dds_qos_t* qos = held.get();
      dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
      dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
      dds_qset_liveliness(qos, DDS_LIVELINESS_AUTOMATIC, DDS_SECS(2));
      dds_qset_ignorelocal(qos, DDS_IGNORELOCAL_PARTICIPANT);
      // Limits the memory for data from all senders.
      dds_qset_resource_limits(qos, 256, 64, 1);
      reader_ = need(dds_create_reader(participant, topic, qos, nullptr), "the reader of hands");
      writer_ = need(dds_create_writer(participant, topic, qos, nullptr), "the writer of the hand");
      if (!params.scene) return;
      const dds_entity_t scenes = need(dds_create_topic(participant, &palpate_site_Scene_desc,
                                                        "palpate_scene", nullptr, nullptr),
                                       "the topic of scenes");
      // The writer does not wait for sites that read no data. Late joiners get the newest text.
      dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, 0);
      dds_qset_durability(qos, DDS_DURABILITY_TRANSIENT_LOCAL);
      // A full reader would block all of DDS. So the reader has no limit. hearScenes() limits the
      // number of texts in scenes_.
      dds_qset_resource_limits(qos, DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED, 1);
      scene_reader_ =
          need(dds_create_reader(participant, scenes, qos, nullptr), "the reader of scenes");
      scene_writer_ =
          need(dds_create_writer(participant, scenes, qos, nullptr), "the writer of the scene");
    } catch (...) {
      dds_delete(domain_);
      throw;
    }
  }

  void run() noexcept {
    std::unique_lock lock(mutex_);
    auto due = Clock::now();
    try {
      while (!quit_) {
        hear();
        tell();
        if (scene_reader_ != 0) hearScenes();
        if (scene_writer_ != 0 && scene_) tellOfScene();
        due = std::max(due + kEvery, Clock::now());
        wake_.wait_until(lock, due, [this] { return quit_; });
      }
    } catch (const std::exception&) {
      // If memory runs out, this site stops sending, so the other sites release its hand.
      failed_ = true;
    }
  }

  /// Adds a line that a peer can cause. Limits the lines per second, and counts the other lines.
  void say(std::string line) {
    constexpr std::size_t kMostLines = 3 * kMostLinks;
    constexpr std::size_t kMostNews = 100;  // lines not taken yet
    if (news_.size() >= kMostNews) return;
    if (const auto now = Clock::now(); now - said_at_ > std::chrono::seconds(1)) {
      if (said_ > kMostLines) {
        news_.push_back(
            fmt::format("site: {} more lines about sites that join and leave", said_ - kMostLines));
      }
      said_at_ = now;
      said_ = 0;
    }
    if (++said_ <= kMostLines) news_.push_back(std::move(line));
  }

  struct Loan {
    Loan(dds_entity_t r, std::array<void*, kMostAtOnce>& s, dds_return_t n)
        : reader(r), samples(s), count(n) {}
    Loan(const Loan&) = delete;
    Loan& operator=(const Loan&) = delete;
    ~Loan() {
      if (count > 0) (void)dds_return_loan(reader, samples.data(), count);
    }
    dds_entity_t reader;
    std::array<void*, kMostAtOnce>& samples;
    dds_return_t count;
  };

  void hear() {
    std::array<void*, kMostAtOnce> samples{};
    std::array<dds_sample_info_t, kMostAtOnce> infos{};
    const auto now = Clock::now();
    if (!alone_told_ && now - begun_ > kAlone) {
      alone_told_ = true;
      if (others_.empty()) {
        news_.emplace_back(
            "site: no other site is heard yet: if one is running, check --with, domain and "
            "--site-keys of both sites, and that the network passes UDP");
      }
    }
    const dds_return_t count =
        dds_take(reader_, samples.data(), infos.data(), kMostAtOnce, kMostAtOnce);
    const Loan loan{reader_, samples, count};
    for (dds_return_t i = 0; i < count; ++i) {
      const auto n = static_cast<std::size_t>(i);
      const auto& hand = *static_cast<const palpate_site_Hand*>(samples[n]);
      if (infos[n].valid_data) {
        take(hand, infos[n].publication_handle, now);
      } else if (infos[n].instance_state != DDS_IST_ALIVE) {
        leave(hand.site);
      }
    }
    for (auto& [name, other] : others_) {
      const std::chrono::duration<double> since(now - other.last);
      if (!other.state.here || since.count() < kLinkSilence) continue;
      other.state.here = false;
      say(fmt::format(
          "site {}: no message for {} s: the spring to its hand fades out until the next message",
          name, kLinkSilence));
    }
    if (count > 0) links_.hear(heard_);
  }

  void hearScenes() {
    // DDS stores further texts until takeScenes() has emptied scenes_.
    if (scenes_.size() >= kMostScenes) return;
    std::array<void*, kMostAtOnce> samples{};
    std::array<dds_sample_info_t, kMostAtOnce> infos{};
    const auto most = static_cast<std::uint32_t>(kMostScenes);
    const dds_return_t count = dds_take(scene_reader_, samples.data(), infos.data(), most, most);
    const Loan loan{scene_reader_, samples, count};
    for (dds_return_t i = 0; i < count; ++i) {
      const auto n = static_cast<std::size_t>(i);
      if (!infos[n].valid_data) continue;
      const auto& scene = *static_cast<const palpate_site_Scene*>(samples[n]);
      const std::string name(scene.site, strnlen(scene.site, sizeof scene.site));
      if (!isSiteName(name) || name == name_) continue;
      scenes_[name].assign(scene.text, strnlen(scene.text, sizeof scene.text));
    }
  }

  void tellOfScene() {
    const auto now = Clock::now();
    if (now - scene_at_ < kSceneEvery || scene_->size() > kMostSceneText) return;
    const auto scene = std::make_unique<palpate_site_Scene>();
    name_.copy(scene->site, sizeof scene->site - 1);
    scene_->copy(scene->text, sizeof scene->text - 1);
    scene_at_ = now;
    if (dds_write(scene_writer_, scene.get()) == DDS_RETCODE_OK) scene_.reset();
  }

  void take(const palpate_site_Hand& hand, dds_instance_handle_t writer, Clock::time_point now) {
    const std::string name(hand.site, strnlen(hand.site, sizeof hand.site));
    if (!isSiteName(name)) return;
    if (name == name_) {
      if (!std::exchange(told_same_, true)) {
        say(fmt::format("site {}: another site has the same name: give each site its own name",
                        name));
      }
      return;
    }
    if (others_.find(name) == others_.end() && !makeRoom()) return;
    Other& other = others_[name];
    SiteState& state = other.state;
    // A new writer is another program with this name, or a program that DDS has found again. This
    // site ignores the new writer until the previous writer is silent and its spring has faded out.
    if (other.slot != kMostLinks && writer != other.writer) {
      if (state.here || state.presence > 0.0) return;
      letGo(other);
    }
    if (other.slot == kMostLinks && !seat(name, other)) return;
    other.writer = writer;
    ++state.heard;
    ++other.count;
    if (hand.number <= other.newest) return;
    if (other.newest == 0) {
      other.first = hand.number;
      other.count = 1;
      ++state.lives;
    }
    other.newest = hand.number;
    const std::uint64_t sent = other.newest - other.first + 1;
    state.missed = sent > other.count ? sent - other.count : 0;
    other.last = now;
    other.gone = false;
    if (!state.here) {
      state.here = true;
      say(fmt::format("site {}: its hand is connected", name));
    }
    LinkWord word;
    word.number = hand.number;
    word.proxy = {hand.proxy[0], hand.proxy[1], hand.proxy[2]};
    for (std::uint32_t w = 0; w < hand.words._length; ++w) {
      const palpate_site_Word& one = hand.words._buffer[w];
      if (one.to_site != number_) continue;
      word.from = one.life;
      word.to = one.to_life;
      word.given = one.given;
    }
    // The other site sends a word to this site only after it knows this site.
    if (word.from != 0) heard_.words[other.slot] = word;
  }

  template <class Is>
  std::map<std::string, Other>::iterator longestSilent(Is is) {
    auto longest = others_.end();
    for (auto one = others_.begin(); one != others_.end(); ++one) {
      if (one->second.state.here || !is(one->second)) continue;
      if (longest == others_.end() || one->second.last < longest->second.last) longest = one;
    }
    return longest;
  }

  void full() {
    if (std::exchange(told_full_, true)) return;
    say(fmt::format(
        "site: more than {} hands of other sites: some are not felt: end unneeded sites",
        kMostLinks));
  }

  /// If too many sites are known, forgets the site that has been silent longest. Returns false if
  /// no site is silent.
  bool makeRoom() {
    if (others_.size() < 4 * kMostLinks) return true;
    const auto longest = longestSilent([](const Other&) { return true; });
    if (longest == others_.end()) {
      full();
      return false;
    }
    letGo(longest->second);
    others_.erase(longest);
    return true;
  }

  void letGo(Other& other) {
    if (other.slot == kMostLinks) return;
    heard_.who[other.slot] = site_[other.slot] = 0;
    other.slot = kMostLinks;
    other.newest = 0;
  }

  /// Assigns a free slot among the links to a site, or the slot of the site that has been silent
  /// longest. Returns false if no slot is free and no site is silent.
  bool seat(const std::string& name, Other& other) {
    std::size_t slot = 0;
    while (slot < kMostLinks && heard_.who[slot] != 0) ++slot;
    if (slot == kMostLinks) {
      const auto longest = longestSilent([](const Other& one) { return one.slot != kMostLinks; });
      if (longest == others_.end()) {
        full();
        return false;
      }
      slot = longest->second.slot;
      letGo(longest->second);
    }
    other.slot = slot;
    heard_.who[slot] = ++seats_;  // a new number restarts the link
    heard_.words[slot] = {};
    site_[slot] = numberOfSite(name);
    return true;
  }

  void leave(const char* site) {
    const auto found =
        others_.find(std::string(site, strnlen(site, sizeof palpate_site_Hand::site)));
    if (found == others_.end() || std::exchange(found->second.gone, true)) return;
    found->second.state.here = false;
    say(fmt::format("site {}: it has left", found->first));
  }

  void tell() {
    const LinksTold& told = links_.told();
    for (auto& [name, other] : others_) {
      if (other.slot == kMostLinks) continue;
      other.state.presence = told.presence[other.slot];
      other.state.paid = told.paid[other.slot];
      other.state.energy = told.energy[other.slot];
    }
    // If the loop has not ticked since the last call, sends no message.
    if (told.words[0].number == ticked_) return;
    ticked_ = told.words[0].number;
    const auto now = Clock::now();
    double gift = 0.0;
    for (std::size_t i = 0; i < kMostLinks; ++i) {
      gift = std::max(gift, std::abs(told.words[i].given - sent_[i]));
    }
    const bool news = (told.proxy - sent_proxy_).norm() > kSmallWay || gift > kSmallGift;
    if (!news && now - sent_at_ < kRest) return;
    std::array<palpate_site_Word, kMostLinks> words{};
    std::uint32_t count = 0;
    for (std::size_t i = 0; i < kMostLinks; ++i) {
      sent_[i] = told.words[i].given;
      // The loop may not have seen the new site in this slot yet.
      if (heard_.who[i] == 0 || heard_.who[i] != told.who[i]) continue;
      words[count++] = {site_[i], told.words[i].from, told.words[i].to, told.words[i].given};
    }
    palpate_site_Hand hand{};
    name_.copy(hand.site, sizeof hand.site - 1);
    hand.number = ++messages_;
    std::copy_n(numbers(told.hand).begin(), 3, hand.probe);
    std::copy_n(numbers(told.proxy).begin(), 3, hand.proxy);
    std::copy_n(numbers(told.force).begin(), 3, hand.force);
    hand.words = {count, count, words.data(), false};
    (void)dds_write(writer_, &hand);
    sent_at_ = now;
    sent_proxy_ = told.proxy;
  }

  std::string name_;
  std::uint64_t number_;
  HandLinks& links_;
  Complaints complaints_;
  Clock::time_point begun_ = Clock::now();
  dds_entity_t domain_ = 0;
  dds_entity_t reader_ = 0;
  dds_entity_t writer_ = 0;
  dds_entity_t scene_reader_ = 0;  ///< 0: sites exchange no scenes.
  dds_entity_t scene_writer_ = 0;

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool quit_ = false;
  bool failed_ = false;
  bool alone_told_ = false;
  std::vector<std::string> news_;
  std::map<std::string, Other> others_;
  std::optional<std::string> scene_;
  std::map<std::string, std::string> scenes_;

  // Only the site's own thread uses these members, except thread_.
  LinksHeard heard_;
  std::array<std::uint64_t, kMostLinks> site_{};  ///< Site in each slot, by numberOfSite; 0: free.
  std::uint64_t seats_ = 0;
  std::uint64_t ticked_ = 0;
  bool told_same_ = false;
  bool told_full_ = false;
  Clock::time_point said_at_;
  std::size_t said_ = 0;  ///< Number of lines in the present second.
  std::uint64_t messages_ = 0;
  Clock::time_point sent_at_;
  Clock::time_point scene_at_;
  Vec3 sent_proxy_ = Vec3::Zero();
  std::array<double, kMostLinks> sent_{};
  std::thread thread_;
};

std::unique_ptr<Site> joinSite(const SiteParams& params, HandLinks& links) {
  return std::make_unique<DdsSite>(params, links);
}

}  // namespace
}  // namespace palpate

// NOLINTNEXTLINE(readability-identifier-naming): the name of the symbol in module.map.
extern "C" const palpate::ModuleEntry<palpate::SiteFactory> palpate_module{&palpate::joinSite};
