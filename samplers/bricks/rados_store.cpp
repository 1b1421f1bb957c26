#include "palpate/samplers/bricks/rados_store.h"

#include <algorithm>
#include <cerrno>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>
#include <mutex>
#include <new>
#include <optional>
#include <rados/librados.h>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

constexpr char kLibrary[] = "librados.so.2";
/// Size of the pieces in which get() reads longer objects [bytes].
constexpr std::size_t kPiece = std::size_t{4} << 20U;

/// Loads librados. Never unloads it, because librados has threads of its own.
void* load() {
  void* const library = dlopen(kLibrary, RTLD_NOW | RTLD_LOCAL);
  if (library != nullptr) return library;
  const char* const why = dlerror();
  throw VolumeError(
      kLibrary,
      std::string("it cannot be loaded (") + (why == nullptr ? "unknown error" : why) + ")",
      "install librados2, Ceph's client");
}

/// The address of a function of librados, which converts to any function type.
struct Call {
  void* address;
  template <class Function>
  operator Function*() const noexcept {  // NOLINT(google-explicit-constructor)
    return reinterpret_cast<Function*>(address);
  }
};

Call call(const char* name) {
  static void* const library = load();
  void* const found = dlsym(library, name);
  if (found != nullptr) return {found};
  throw VolumeError(kLibrary, std::string("it does not have the function ") + name,
                    "install a newer librados2");
}

struct Librados {
  decltype(rados_create)* create = call("rados_create");
  decltype(rados_conf_read_file)* conf_read_file = call("rados_conf_read_file");
  decltype(rados_conf_parse_env)* conf_parse_env = call("rados_conf_parse_env");
  decltype(rados_conf_set)* conf_set = call("rados_conf_set");
  decltype(rados_connect)* connect = call("rados_connect");
  decltype(rados_shutdown)* shutdown = call("rados_shutdown");
  decltype(rados_ioctx_create)* ioctx_create = call("rados_ioctx_create");
  decltype(rados_ioctx_destroy)* ioctx_destroy = call("rados_ioctx_destroy");
  decltype(rados_read)* read = call("rados_read");
  decltype(rados_aio_create_completion2)* aio_create_completion2 =
      call("rados_aio_create_completion2");
  decltype(rados_aio_read)* aio_read = call("rados_aio_read");
  decltype(rados_aio_cancel)* aio_cancel = call("rados_aio_cancel");
  decltype(rados_aio_get_return_value)* aio_get_return_value = call("rados_aio_get_return_value");
  decltype(rados_aio_release)* aio_release = call("rados_aio_release");
};

const Librados& librados() {
  static const Librados calls;
  return calls;
}

struct Address {
  std::string user;
  std::string pool;
  std::string folder;
};

std::optional<Address> parse(std::string_view name) {
  constexpr std::string_view kScheme = "rados://";
  if (!name.starts_with(kScheme)) return std::nullopt;
  std::string_view rest = name.substr(kScheme.size());
  Address address{"admin", "", ""};
  if (const std::size_t at = rest.find('@'); at != std::string_view::npos) {
    address.user = rest.substr(0, at);
    rest.remove_prefix(at + 1);
  }
  const std::size_t slash = rest.find('/');
  if (slash == std::string_view::npos) return std::nullopt;
  address.pool = rest.substr(0, slash);
  address.folder = rest.substr(slash + 1);
  while (address.folder.ends_with('/')) address.folder.pop_back();
  const auto is_name = [](const std::string& text) {
    return !text.empty() && text.find_first_of(std::string_view(" \t\r\n@\0", 6)) == text.npos;
  };
  if (!is_name(address.user) || address.user.find('/') != std::string::npos ||
      !is_name(address.pool) || !is_name(address.folder)) {
    return std::nullopt;
  }
  return address;
}

/// A read in progress. Owns the buffer to which librados may write even after drop().
struct Read {
  ~Read() {
    if (completion != nullptr) librados().aio_release(completion);
  }

  ObjectRequest* request = nullptr;  ///< Null if the read was dropped.
  std::vector<char> bytes;
  rados_completion_t completion = nullptr;
  bool done = false;
  class RadosStore* of = nullptr;
};

/// Returns the description of an error of librados; the string stays valid.
const char* nameOf(int error) noexcept {
  // ::strerror is not thread-safe.
  const char* const name = strerrordesc_np(-error);
  return name == nullptr ? "unknown error" : name;
}

void conclude(ObjectRequest& request, const char* bytes, int result) noexcept {
  if (result == -ENOENT) {
    request.status = BrickStatus::kMissing;
  } else if (result < 0) {
    request.fail(nameOf(result));
  } else if (static_cast<std::size_t>(result) > request.limit) {
    request.status = BrickStatus::kCut;
  } else {
    try {
      const auto* first = reinterpret_cast<const std::byte*>(bytes);
      request.body.assign(first, first + result);
      request.status = BrickStatus::kArrived;
    } catch (const std::bad_alloc&) {
      request.fail(kNoMemory);
    }
  }
}

/// Returns the size to request. For a whole object this is one byte above the limit, to detect a
/// longer object.
std::size_t sizeOf(const ObjectRequest& request) noexcept {
  return request.limit + (request.part ? 0 : 1);
}

class RadosStore final : public ObjectStore {
 public:
  RadosStore(const std::string& name, const StoreParams& params);
  ~RadosStore() override;

  std::unique_ptr<ObjectRequest> make() override { return std::make_unique<ObjectRequest>(); }
  void get(const std::string& name, ObjectRequest& request) noexcept override;
  bool begin(const std::string& name, ObjectRequest& request) noexcept override;
  void drop(ObjectRequest& request) noexcept override;
  ObjectRequest* ended(std::chrono::milliseconds patience) noexcept override;
  void wake() noexcept override {
    const std::lock_guard lock(mutex_);
    woken_ = true;
    changed_.notify_one();
  }

 private:
  static void finish(rados_completion_t completion, void* read) noexcept;

  const Librados& call_ = librados();
  Address address_;
  rados_t cluster_ = nullptr;
  rados_ioctx_t pool_ = nullptr;
  std::mutex mutex_;  ///< Guards all members below.
  std::condition_variable changed_;
  std::vector<std::unique_ptr<Read>> reads_;
  bool woken_ = false;
};

std::string seconds(std::chrono::milliseconds time) {
  return std::to_string(std::max<long>(1, std::chrono::ceil<std::chrono::seconds>(time).count()));
}

RadosStore::RadosStore(const std::string& name, const StoreParams& params) {
  std::optional<Address> address = parse(name);
  if (!address)
    throw VolumeError(name, "it is not an address of a folder", "give rados://pool/folder");
  address_ = std::move(*address);
  const auto fail = [&](int how, const std::string& what, const char* remedy) {
    if (pool_ != nullptr) call_.ioctx_destroy(pool_);
    if (cluster_ != nullptr) call_.shutdown(cluster_);
    throw VolumeError(name, what + " (" + nameOf(how) + ")", remedy);
  };
  int how = call_.create(&cluster_, address_.user.c_str());
  if (how < 0) fail(how, "Ceph's client cannot be initialized", "reinstall librados2");
  how = call_.conf_read_file(cluster_, nullptr);
  if (how < 0) {
    fail(how, "the configuration of Ceph cannot be read",
         std::getenv("CEPH_CONF") != nullptr
             ? "correct the path in CEPH_CONF, or the file's syntax or permissions"
             : "set CEPH_CONF to a ceph.conf, or write or correct /etc/ceph/ceph.conf");
  }
  how = call_.conf_parse_env(cluster_, nullptr);
  if (how < 0) fail(how, "Ceph rejects the options in CEPH_ARGS", "correct or unset CEPH_ARGS");
  const std::pair<const char*, std::string> options[] = {
      {"client_mount_timeout", seconds(params.connect)},
      {"rados_mon_op_timeout", seconds(params.connect)},
      {"rados_osd_op_timeout", seconds(params.stalled)},
      {"log_to_stderr", "false"},  // palpate reports errors itself
      {"err_to_stderr", "false"}};
  for (const auto& [option, value] : options) {
    how = call_.conf_set(cluster_, option, value.c_str());
    if (how < 0) {
      fail(how, std::string("Ceph rejects the option ") + option,
           "install another version of librados2");
    }
  }
  how = call_.connect(cluster_);
  if (how == -ETIMEDOUT) fail(how, "no monitor of Ceph answers", "check mon_host and the network");
  if (how < 0) {
    fail(how,
         "Ceph rejects the user \"" + address_.user + "\", or mon_host or the keyring is missing",
         "check mon_host, the user (rados://user@pool/folder) and the user's keyring");
  }
  how = call_.ioctx_create(cluster_, address_.pool.c_str(), &pool_);
  if (how == -ENOENT) {
    fail(how, "Ceph does not have the pool \"" + address_.pool + "\"", "check its name");
  }
  if (how < 0) {
    fail(how, "the pool \"" + address_.pool + "\" cannot be opened",
         "check that the user may read the pool");
  }
}

RadosStore::~RadosStore() {
  std::unique_lock lock(mutex_);
  // Waits for dropped reads. Each ends at the latest by a time-out of librados.
  changed_.wait(lock, [&] {
    return std::all_of(reads_.begin(), reads_.end(), [](const auto& read) { return read->done; });
  });
  reads_.clear();
  lock.unlock();
  call_.ioctx_destroy(pool_);
  call_.shutdown(cluster_);
}

void RadosStore::get(const std::string& name, ObjectRequest& request) noexcept {
  try {
    const std::string object = address_.folder + "/" + name;
    const std::size_t size = sizeOf(request);
    std::vector<char> bytes;
    int result = 0;
    while (bytes.size() < size) {
      const std::size_t before = bytes.size();
      const std::size_t piece = std::min(kPiece, size - before);
      bytes.resize(before + piece);
      result = call_.read(pool_, object.c_str(), bytes.data() + before, piece, before);
      if (result < 0) break;
      bytes.resize(before + static_cast<std::size_t>(result));
      if (static_cast<std::size_t>(result) < piece) break;
    }
    conclude(request, bytes.data(), result < 0 ? result : static_cast<int>(bytes.size()));
  } catch (const std::bad_alloc&) {
    request.fail(kNoMemory);
  }
}

bool RadosStore::begin(const std::string& name, ObjectRequest& request) noexcept {
  try {
    const std::string object = address_.folder + "/" + name;
    auto owned = std::make_unique<Read>();
    Read* const read = owned.get();
    read->request = &request;
    read->of = this;
    read->bytes.resize(sizeOf(request));
    if (call_.aio_create_completion2(read, &RadosStore::finish, &read->completion) != 0) {
      request.fail(kNoMemory);
      return false;
    }
    {
      const std::lock_guard lock(mutex_);
      reads_.push_back(std::move(owned));
    }
    const int how = call_.aio_read(pool_, object.c_str(), read->completion, read->bytes.data(),
                                   read->bytes.size(), 0);
    if (how == 0) return true;
    request.fail(nameOf(how));
    const std::lock_guard lock(mutex_);
    std::erase_if(reads_, [&](const auto& one) { return one.get() == read; });
  } catch (const std::bad_alloc&) {
    request.fail(kNoMemory);
  }
  return false;
}

/// Marks a read as done. librados calls this function in one of its own threads, or in aio_cancel.
void RadosStore::finish(rados_completion_t /*completion*/, void* of) noexcept {
  auto& read = *static_cast<Read*>(of);
  RadosStore& store = *read.of;
  const std::lock_guard lock(store.mutex_);
  read.done = true;
  store.changed_.notify_one();
}

void RadosStore::drop(ObjectRequest& request) noexcept {
  rados_completion_t completion = nullptr;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& read : reads_) {
      if (read->request != &request) continue;
      read->request = nullptr;
      completion = read->completion;
    }
  }
  // aio_cancel may call finish(), which locks the mutex, so the mutex is not locked here.
  if (completion != nullptr) call_.aio_cancel(pool_, completion);
}

ObjectRequest* RadosStore::ended(std::chrono::milliseconds patience) noexcept {
  const auto is_done = [](const auto& read) { return read->done; };
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, patience,
                    [&] { return woken_ || std::any_of(reads_.begin(), reads_.end(), is_done); });
  woken_ = false;
  while (true) {
    const auto found = std::find_if(reads_.begin(), reads_.end(), is_done);
    if (found == reads_.end()) return nullptr;
    const std::unique_ptr<Read> read = std::move(*found);
    reads_.erase(found);
    const int result = call_.aio_get_return_value(read->completion);
    if (read->request == nullptr) continue;
    conclude(*read->request, read->bytes.data(), result);
    return read->request;
  }
}

}  // namespace

std::unique_ptr<ObjectStore> makeRadosStore(const std::string& address, const StoreParams& params) {
  return std::make_unique<RadosStore>(address, params);
}

}  // namespace palpate
