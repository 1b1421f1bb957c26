#include "palpate/devices/hid/hid_port.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <cwchar>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <hidapi/hidapi.h>
#include <linux/hid.h>
#include <mutex>
#include <set>
#include <sstream>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include "palpate/engine/error.h"

namespace palpate {

namespace {

/// Mutex for listing, opening and closing, because these calls free hidapi's global error text.
std::mutex& turn() {
  static std::mutex mutex;
  return mutex;
}

/// Paths of the devices that this process has open. Guarded by turn().
std::multiset<std::string>& openHere() {
  static std::multiset<std::string> paths;
  return paths;
}

const char* remedyForOpen(int error) {
  return error == EMFILE || error == ENFILE
             ? "close files, or raise the limit of open files (ulimit -n)"
             : "plug the arm in again";
}

/// A port through hidapi, with one handle to read and one to write. Two threads must not share a
/// handle, because hidapi frees the handle's error text on every failure.
class HidPort final : public ReportPort {
 public:
  HidPort(const std::string& path, const Say& say) : path_(path) {
    const std::lock_guard lock(turn());
    try {
      guard_ = open(path.c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK);
      if (guard_ >= 0) claim(guard_, path, say);
      in_ = guard_ >= 0 ? hid_open_path(path.c_str()) : nullptr;
      out_ = in_ != nullptr ? hid_open_path(path.c_str()) : nullptr;
      if (out_ == nullptr) {
        const int error = errno;
        throw DeviceError(path, "it cannot be opened (" + std::string(std::strerror(error)) + ")",
                          remedyForOpen(error));
      }
    } catch (...) {
      closeAll();
      throw;
    }
    openHere().insert(path_);
  }
  ~HidPort() override {
    const std::lock_guard lock(turn());
    openHere().erase(openHere().find(path_));
    closeAll();
  }

  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    const int n = hid_read_timeout(in_, reinterpret_cast<unsigned char*>(to.data()), to.size(), 0);
    size = n > 0 ? static_cast<std::size_t>(n) : 0;
    return n < 0 ? ReadStatus::kGone : n == 0 ? ReadStatus::kNothing : ReadStatus::kReport;
  }
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override {
    return hid_write(out_, reinterpret_cast<const unsigned char*>(report.data()), report.size()) >=
           0;
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte> report) noexcept override {
    return hid_send_feature_report(out_, reinterpret_cast<const unsigned char*>(report.data()),
                                   report.size()) >= 0;
  }
  [[nodiscard]] bool getFeature(std::span<std::byte> report, std::size_t& size) noexcept override {
    const int n = hid_get_feature_report(out_, reinterpret_cast<unsigned char*>(report.data()),
                                         report.size());
    size = n > 0 ? std::min(static_cast<std::size_t>(n), report.size()) : 0;
    return n > 0;
  }
  [[nodiscard]] int guardDescriptor() const noexcept override { return guard_; }

 private:
  void closeAll() noexcept {
    if (in_ != nullptr) hid_close(in_);
    if (out_ != nullptr) hid_close(out_);
    // Guardians have copies of the descriptor, so only an explicit unlock releases the lock.
    if (guard_ >= 0) (void)flock(guard_, LOCK_UN);
    if (guard_ >= 0) close(guard_);
  }
  std::string path_;
  hid_device* in_ = nullptr;
  hid_device* out_ = nullptr;
  int guard_ = -1;
};

std::ifstream sysFile(const std::string& path, const char* name) {
  const std::string node = std::filesystem::path(path).filename();
  return std::ifstream("/sys/class/hidraw/" + node + "/device/" + name, std::ios::binary);
}

/// Returns the descriptor from /sys, which every user may read. hidapi offers this only since 0.14.
std::vector<std::byte> descriptorOf(const std::string& path) {
  std::array<char, HID_MAX_DESCRIPTOR_SIZE> bytes{};
  std::ifstream in = sysFile(path, "report_descriptor");
  in.read(bytes.data(), bytes.size());
  const auto all = std::as_bytes(std::span(bytes)).first(static_cast<std::size_t>(in.gcount()));
  return {all.begin(), all.end()};
}

/// Returns HID_PHYS of the node's device, which names the port where it is plugged in.
std::string portOf(const std::string& path) {
  std::ifstream in = sysFile(path, "uevent");
  const std::string key = "HID_PHYS=";
  for (std::string line; std::getline(in, line);) {
    if (line.rfind(key, 0) == 0) return line.substr(key.size());
  }
  return {};
}

std::string narrow(const wchar_t* text) {
  std::string out;
  for (; text != nullptr && *text != L'\0'; ++text) {
    out += *text > 0x1f && *text < 0x7f ? static_cast<char>(*text) : '?';
  }
  return out;
}

std::string processOf(const std::string& pid) {
  std::string name = "?";
  std::ifstream("/proc/" + pid + "/comm") >> name;
  return name.append(" (").append(pid).append(")");
}

/// Returns false if the process has ended, even if its parent has not waited for it yet.
bool isAlive(const std::string& pid) {
  std::ifstream status("/proc/" + pid + "/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("State:", 0) != 0) continue;
    return line.find_first_of("ZX", 6) == std::string::npos;  // a line such as "State:	Z (zombie)"
  }
  return false;
}

/// Returns the id of the process that has locked the descriptor's file; empty if unknown.
std::string whoLocks(int descriptor) {
  struct stat status {};
  if (fstat(descriptor, &status) != 0) return {};
  std::array<char, 64> file{};
  std::snprintf(file.data(), file.size(), "%02x:%02x:%lu", major(status.st_dev),
                minor(status.st_dev), static_cast<unsigned long>(status.st_ino));
  std::ifstream locks("/proc/locks");
  for (std::string line; std::getline(locks, line);) {
    // A line such as: 1: FLOCK  ADVISORY  WRITE 1234 00:06:567 0 EOF
    std::istringstream words(line);
    std::string number, kind, advisory, access, pid, of;
    words >> number >> kind >> advisory >> access >> pid >> of;
    if (kind == "FLOCK" && of == file.data() && pid != "0") return pid;
  }
  return {};
}

bool isReadOnly(const std::filesystem::path& info) {
  std::ifstream in(info);
  for (std::string key, value; in >> key >> value;) {
    if (key == "flags:") return (std::strtoul(value.c_str(), nullptr, 8) & O_ACCMODE) == O_RDONLY;
  }
  return false;
}

int openNode(const std::string& path, int access) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0) {
    throw DeviceError(path, "the device does not exist",
                      "plug it in (in a container, pass it in); run palpate devices for a list");
  }
  if (!S_ISCHR(status.st_mode) || path.rfind("/dev/hidraw", 0) != 0) {
    throw DeviceError(path, "it is not a HID device", "name a HID device, such as /dev/hidraw0");
  }
  const int node = open(path.c_str(), access | O_CLOEXEC | O_NONBLOCK);
  if (node >= 0) return node;
  const int error = errno;
  if (error == EACCES || error == EPERM) {
    throw DeviceError(path, "permission is denied",
                      "install palpate's udev rules with the line for this arm (printed by "
                      "`palpate devices`), then plug the arm in again");
  }
  throw DeviceError(path, std::strerror(error), remedyForOpen(error));
}

/// A port that cannot write. The kernel gives each reader its own ring of reports.
class ReadPort final : public ReportPort {
 public:
  explicit ReadPort(int node) : node_(node) {}
  ~ReadPort() override { close(node_); }
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    const ssize_t n = ::read(node_, to.data(), to.size());
    size = n > 0 ? static_cast<std::size_t>(n) : 0;
    if (n > 0) return ReadStatus::kReport;
    return n < 0 && (errno == EAGAIN || errno == EINTR) ? ReadStatus::kNothing : ReadStatus::kGone;
  }
  [[nodiscard]] bool write(std::span<const std::byte> /*report*/) noexcept override {
    return false;
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte> /*report*/) noexcept override {
    return false;
  }

 private:
  int node_;
};

}  // namespace

std::vector<HidDeviceName> listHid() {
  std::vector<HidDeviceName> devices;
  const std::lock_guard lock(turn());
  hid_device_info* all = hid_enumerate(0, 0);
  for (const hid_device_info* one = all; one != nullptr; one = one->next) {
    devices.push_back({one->path, one->vendor_id, one->product_id, one->usage_page, one->usage,
                       narrow(one->serial_number), narrow(one->manufacturer_string),
                       narrow(one->product_string), portOf(one->path), descriptorOf(one->path)});
  }
  hid_free_enumeration(all);
  return devices;
}

std::unique_ptr<ReportPort> openHid(const std::string& path, const Say& say) {
  // openNode() rejects files of other kinds, which hidapi 0.13.1 does not handle.
  close(openNode(path, O_RDWR));
  return std::make_unique<HidPort>(path, say);
}

std::unique_ptr<ReportPort> openHidToRead(const std::string& path) {
  return std::make_unique<ReadPort>(openNode(path, O_RDONLY));
}

bool isOpenHere(const std::string& path) {
  const std::lock_guard lock(turn());
  return openHere().count(path) > 0;
}

void claim(int descriptor, const std::string& path, const Say& say) {
  using Clock = std::chrono::steady_clock;
  // Waits at least this long for every owner, because the owner may be a program that is being
  // killed.
  constexpr auto kDying = std::chrono::milliseconds(50);
  const auto begin = Clock::now();
  for (bool said = false; flock(descriptor, LOCK_EX | LOCK_NB) != 0;) {
    if (errno != EWOULDBLOCK) {
      throw DeviceError(path, std::string("it cannot be locked: ") + std::strerror(errno),
                        "use a system that can lock devices");
    }
    const std::string pid = whoLocks(descriptor);
    const bool orphaned = !pid.empty() && !isAlive(pid);
    const auto waited = Clock::now() - begin;
    if (waited < kDying || (orphaned && waited < std::chrono::duration<double>(kLongestClaim))) {
      if (orphaned && say && !said) {
        std::string words = path;
        words.append(": the program that used it (process ").append(pid);
        say(words.append(") has ended: waiting for its guardian"));
      }
      said = said || orphaned;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      continue;
    }
    std::string who = pid.empty() ? "another program" : processOf(pid);
    if (orphaned) who.assign("the guardian of a program that has ended (").append(pid).append(")");
    throw DeviceError(path, who + " uses this arm",
                      orphaned
                          ? "plug the arm in again, or end its process palpate-guard"
                          : "end that program: two programs on one arm would both send forces");
  }
}

std::vector<std::string> effectNodes(const std::string& path, const std::filesystem::path& sys) {
  namespace fs = std::filesystem;
  std::vector<std::string> nodes;
  std::error_code error;
  const fs::path inputs = sys / fs::path(path).filename() / "device" / "input";
  for (const auto& input : fs::directory_iterator(inputs, error)) {
    // The file holds a bitmap as hexadecimal words, such as "300040000 0".
    std::ifstream in(input.path() / "capabilities" / "ff");
    std::string bits;
    std::getline(in, bits);
    if (bits.find_first_not_of("0 \n") == std::string::npos) continue;
    std::error_code hidden;
    for (const auto& node : fs::directory_iterator(input.path(), hidden)) {
      const std::string name = node.path().filename();
      if (name.rfind("event", 0) == 0) nodes.push_back("/dev/input/" + name);
    }
  }
  return nodes;
}

void refuseEffects(const std::string& path, const std::vector<std::string>& nodes) {
  for (const std::string& node : nodes) {
    const auto programs = whoHas(node);
    if (programs.empty()) continue;
    throw DeviceError(path, programs[0] + " can use this arm's force effects through " + node,
                      "end that program: two programs on one arm could both send forces");
  }
}

std::vector<std::string> whoHas(const std::string& path) {
  namespace fs = std::filesystem;
  std::vector<std::string> programs;
  std::error_code error;
  for (const auto& process : fs::directory_iterator("/proc", error)) {
    const std::string pid = process.path().filename();
    if (pid.find_first_not_of("0123456789") != std::string::npos) continue;
    if (pid == std::to_string(getpid())) continue;
    std::error_code hidden;
    for (const auto& descriptor : fs::directory_iterator(process.path() / "fd", hidden)) {
      std::error_code gone;
      if (fs::read_symlink(descriptor.path(), gone) != path || gone) continue;
      if (isReadOnly(process.path() / "fdinfo" / descriptor.path().filename())) continue;
      programs.push_back(processOf(pid));
      break;
    }
  }
  return programs;
}

}  // namespace palpate
