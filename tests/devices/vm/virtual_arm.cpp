/// Simulates an arm with its own dynamics in a virtual machine: virtual_arm uhid|usb LOG.
/// `virtual_arm pid LOG` simulates devices of USB's PID class through uhid.
/// With uhid, the test uses the kernel's HID core and hidraw. With usb it also uses usbcore and
/// usbhid: the process connects by vhci_hcd and USB/IP, at full speed, with one transaction per
/// millisecond and direction.
#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <linux/input.h>
#include <linux/uhid.h>
#include <memory>
#include <poll.h>
#include <sched.h>
#include <span>
#include <string>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <unistd.h>
#include <vector>

#include "palpate/engine/loop/realtime.h"
#include "tests/devices/vm/vm_arm.h"

namespace {

using namespace palpate;
using namespace palpate::vm;

[[noreturn]] void fail(const char* what) {
  std::perror(what);
  std::exit(2);
}

/// A transport of reports.
class Wire {
 public:
  Wire() = default;
  Wire(const Wire&) = delete;
  Wire& operator=(const Wire&) = delete;
  virtual ~Wire() = default;
  virtual void plug() = 0;
  virtual void unplug() = 0;
  /// Called once per millisecond.
  virtual void frame(const In& report) = 0;
  /// Processes one event or request. Returns true if it was an output report of the host.
  virtual bool take(Out& report) = 0;
  [[nodiscard]] virtual int descriptor() const = 0;
};

class Uhid final : public Wire {
 public:
  Uhid() : uhid_(open("/dev/uhid", O_RDWR | O_CLOEXEC)) {
    if (uhid_ < 0) fail("/dev/uhid");
  }
  void plug() override {
    uhid_event event{};
    event.type = UHID_CREATE2;
    auto& create = event.u.create2;
    std::strcpy(reinterpret_cast<char*>(create.name), "Virtual Arm");
    std::strcpy(reinterpret_cast<char*>(create.uniq), kSerial);
    create.bus = BUS_USB;
    create.vendor = kVendor;
    create.product = kProduct;
    create.rd_size = kDescriptor.size();
    std::memcpy(create.rd_data, kDescriptor.data(), kDescriptor.size());
    if (write(uhid_, &event, sizeof(event)) < 0) fail("create");
  }
  void unplug() override {
    uhid_event event{};
    event.type = UHID_DESTROY;
    if (write(uhid_, &event, sizeof(event)) < 0) fail("destroy");
  }
  void frame(const In& report) override {
    uhid_event event{};
    event.type = UHID_INPUT2;
    event.u.input2.size = sizeof(report);
    std::memcpy(event.u.input2.data, &report, sizeof(report));
    if (write(uhid_, &event, offsetof(uhid_event, u.input2.data) + sizeof(report)) < 0) {
      fail("input");
    }
  }
  bool take(Out& report) override {
    uhid_event event{};
    if (read(uhid_, &event, sizeof(event)) <= 0) return false;
    if (event.type == UHID_OUTPUT && event.u.output.size == sizeof(report)) {
      std::memcpy(&report, event.u.output.data, sizeof(report));
      return report.id == 2;
    }
    uhid_event answer{};
    if (event.type == UHID_GET_REPORT) {
      answer.type = UHID_GET_REPORT_REPLY;
      answer.u.get_report_reply.id = event.u.get_report.id;
      answer.u.get_report_reply.err = EIO;
    } else if (event.type == UHID_SET_REPORT) {
      answer.type = UHID_SET_REPORT_REPLY;
      answer.u.set_report_reply.id = event.u.set_report.id;
    } else {
      return false;
    }
    if (write(uhid_, &answer, sizeof(answer)) < 0) std::perror("answer");
    return false;
  }
  [[nodiscard]] int descriptor() const override { return uhid_; }

 private:
  int uhid_;
};

/// Connects to the kernel's virtual host controller by USB/IP, through a socket pair.
class Usb final : public Wire {
 public:
  void plug() override {
    std::array<int, 2> ends{};
    if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()) != 0) fail("socketpair");
    socket_ = ends[0];
    const std::string order = "0 " + std::to_string(ends[1]) + " 65538 2";  // port, full speed
    const int attach = open("/sys/devices/platform/vhci_hcd.0/attach", O_WRONLY);
    if (attach < 0 || write(attach, order.data(), order.size()) < 0) fail("attach");
    close(attach);
    close(ends[1]);
    in_ = 0;
    out_.clear();
  }
  void unplug() override {
    const int detach = open("/sys/devices/platform/vhci_hcd.0/detach", O_WRONLY);
    if (detach < 0 || write(detach, "0", 1) < 0) std::perror("detach");
    close(detach);
    close(socket_);
    socket_ = -1;
  }
  void frame(const In& report) override {
    if (in_ != 0) {
      answer(in_, 0, &report, sizeof(report), sizeof(report));
      in_ = 0;
    }
    // Completes one of the host's output transactions per frame.
    if (!out_.empty()) {
      answer(out_.front().first, 0, nullptr, 0, out_.front().second);
      out_.erase(out_.begin());
    }
  }
  bool take(Out& report) override {
    Header header{};
    if (!all(&header, sizeof(header))) return false;
    const std::uint32_t command = ntohl(header.command);
    const std::uint32_t number = ntohl(header.number);
    constexpr std::uint32_t kUnlink = 2;
    if (command == kUnlink) {
      const std::uint32_t which = ntohl(header.words[0]);
      Header back{};
      back.command = htonl(4);
      back.number = header.number;
      if (in_ == which) {
        in_ = 0;
        back.words[0] = htonl(static_cast<std::uint32_t>(-ECONNRESET));
      }
      if (write(socket_, &back, sizeof(back)) < 0) std::perror("unlink");
      return false;
    }
    const std::uint32_t in = ntohl(header.direction);
    const std::uint32_t endpoint = ntohl(header.endpoint);
    const std::uint32_t length = ntohl(header.words[1]);
    std::array<std::uint8_t, 4096> data{};
    if (in == 0 && length > 0 && (length > data.size() || !all(data.data(), length))) return false;
    std::array<std::uint8_t, 8> setup{};
    std::memcpy(setup.data(), &header.words[5], setup.size());
    if (endpoint == 0) {
      control(number, setup, length);
      return false;
    }
    if (in != 0) {
      in_ = number;
      return false;
    }
    out_.emplace_back(number, length);
    if (length != sizeof(report)) return false;
    std::memcpy(&report, data.data(), sizeof(report));
    return report.id == 2;
  }
  [[nodiscard]] int descriptor() const override { return socket_; }

 private:
  struct Header {
    std::uint32_t command, number, device, direction, endpoint;
    std::array<std::uint32_t, 7> words;
  };
  static_assert(sizeof(Header) == 48);

  bool all(void* to, std::size_t size) {
    auto* at = static_cast<char*>(to);
    while (size > 0) {
      const ssize_t n = read(socket_, at, size);
      if (n <= 0) return false;
      at += n;
      size -= static_cast<std::size_t>(n);
    }
    return true;
  }
  void answer(std::uint32_t number, int status, const void* data, std::size_t size,
              std::size_t actual) {
    std::vector<std::uint8_t> bytes(sizeof(Header) + size);
    Header header{};
    header.command = htonl(3);
    header.number = htonl(number);
    header.words[0] = htonl(static_cast<std::uint32_t>(status));
    header.words[1] = htonl(static_cast<std::uint32_t>(actual));
    std::memcpy(bytes.data(), &header, sizeof(header));
    if (size > 0) std::memcpy(bytes.data() + sizeof(header), data, size);
    if (write(socket_, bytes.data(), bytes.size()) < 0) std::perror("answer");
  }
  void control(std::uint32_t number, const std::array<std::uint8_t, 8>& setup, std::size_t length) {
    constexpr std::uint8_t kRd = kDescriptor.size();
    const std::array<std::uint8_t, 18> device{18,   1,    0x00, 2,    0,    0, 0, 64, 0x09,
                                              0x12, 0x01, 0x00, 0x00, 0x01, 1, 2, 3,  1};
    const std::array<std::uint8_t, 41> configuration{9, 2,    41,   0, 1,  1, 0,    0x80, 50,  //
                                                     9, 4,    0,    0, 2,  3, 0,    0,    0,   //
                                                     9, 0x21, 0x11, 1, 0,  1, 0x22, kRd,  0,   //
                                                     7, 5,    0x81, 3, 64, 0, 1,               //
                                                     7, 5,    0x02, 3, 64, 0, 1};
    std::vector<std::uint8_t> out;
    const std::uint8_t kind = setup[0];
    const std::uint8_t request = setup[1];
    const std::uint8_t low = setup[2];
    const std::uint8_t high = setup[3];
    if (kind == 0x80 && request == 6 && high == 1) out.assign(device.begin(), device.end());
    if (kind == 0x80 && request == 6 && high == 2) {
      out.assign(configuration.begin(), configuration.end());
    }
    if (kind == 0x80 && request == 6 && high == 3) {
      const std::array<std::string, 4> texts{"", "palpate", "Virtual Arm", kSerial};
      if (low == 0) {
        out = {4, 3, 9, 4};
      } else if (low < texts.size()) {
        out = {static_cast<std::uint8_t>(2 + 2 * texts[low].size()), 3};
        for (const char c : texts[low]) {
          out.push_back(static_cast<std::uint8_t>(c));
          out.push_back(0);
        }
      }
    }
    if (kind == 0x81 && request == 6 && high == 0x22) {
      out.assign(kDescriptor.begin(), kDescriptor.end());
    }
    if (kind == 0x80 && request == 0) out = {0, 0};
    if (out.empty() && (kind & 0x80) == 0) {
      answer(number, 0, nullptr, 0, length);
    } else if (out.empty()) {
      answer(number, -EPIPE, nullptr, 0, 0);
    } else {
      if (out.size() > length) out.resize(length);
      answer(number, 0, out.data(), out.size(), out.size());
    }
  }

  int socket_ = -1;
  std::uint32_t in_ = 0;  ///< Sequence number of the pending input request; 0: none.
  /// Output requests that wait for the next frame.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> out_;
};

/// A device of USB's PID class whose reported position is proportional to its motors' force.
class PidArm {
 public:
  explicit PidArm(std::size_t kind)
      : model_(pidShape(kind)),
        axes_(pidShape(kind).axes),
        uhid_(open("/dev/uhid", O_RDWR | O_CLOEXEC)) {
    if (uhid_ < 0) fail("/dev/uhid");
    const auto& descriptor = model_.descriptor();
    uhid_event event{};
    event.type = UHID_CREATE2;
    auto& create = event.u.create2;
    std::strcpy(reinterpret_cast<char*>(create.name), "Virtual PID arm");
    create.bus = BUS_USB;
    create.vendor = kVendor;
    create.product = kPidProducts[kind];
    create.rd_size = static_cast<std::uint16_t>(descriptor.size());
    std::memcpy(create.rd_data, descriptor.data(), descriptor.size());
    if (write(uhid_, &event, sizeof(event)) < 0) fail("create");
  }
  void frame() {
    const double now = 1e-9 * static_cast<double>(nowNs());
    std::vector<int> stands;
    for (int a = 0; a < axes_; ++a) {
      stands.push_back(static_cast<int>(std::lround(model_.share(a, now) * model_.full())));
    }
    const auto report = model_.input(stands);
    uhid_event event{};
    event.type = UHID_INPUT2;
    event.u.input2.size = static_cast<std::uint16_t>(report.size());
    std::memcpy(event.u.input2.data, report.data(), report.size());
    if (write(uhid_, &event, offsetof(uhid_event, u.input2.data) + report.size()) < 0) {
      fail("input");
    }
  }
  void take() {
    uhid_event event{};
    if (read(uhid_, &event, sizeof(event)) <= 0) return;
    const double now = 1e-9 * static_cast<double>(nowNs());
    uhid_event answer{};
    if (event.type == UHID_OUTPUT) {
      model_.output(std::as_bytes(std::span(event.u.output.data, event.u.output.size)), now);
      return;
    }
    if (event.type == UHID_SET_REPORT) {
      model_.output(std::as_bytes(std::span(event.u.set_report.data, event.u.set_report.size)),
                    now);
      answer.type = UHID_SET_REPORT_REPLY;
      answer.u.set_report_reply.id = event.u.set_report.id;
    } else if (event.type == UHID_GET_REPORT) {
      const auto report = model_.feature(event.u.get_report.rnum);
      answer.type = UHID_GET_REPORT_REPLY;
      auto& reply = answer.u.get_report_reply;
      reply.id = event.u.get_report.id;
      reply.err = report.empty() ? EIO : 0;
      reply.size = static_cast<std::uint16_t>(report.size());
      std::memcpy(reply.data, report.data(), report.size());
    } else {
      return;
    }
    if (write(uhid_, &answer, sizeof(answer)) < 0) std::perror("answer");
  }
  [[nodiscard]] int descriptor() const { return uhid_; }

 private:
  test::PidModel model_;
  int axes_;
  int uhid_;
};

/// Runs devices of both kinds until the process is killed.
[[noreturn]] void runPidArms(int timer) {
  std::array<PidArm, 2> arms{PidArm(0), PidArm(1)};
  for (;;) {
    std::array<pollfd, 3> waits{
        {{timer, POLLIN, 0}, {arms[0].descriptor(), POLLIN, 0}, {arms[1].descriptor(), POLLIN, 0}}};
    if (poll(waits.data(), waits.size(), -1) < 0) continue;
    for (std::size_t kind = 0; kind < arms.size(); ++kind) {
      if (waits[kind + 1].revents != 0) arms[kind].take();
    }
    std::uint64_t passed = 0;
    if (waits[0].revents == 0 || read(timer, &passed, sizeof(passed)) != sizeof(passed)) continue;
    for (PidArm& arm : arms) arm.frame();
  }
}

class Arm {
 public:
  explicit Arm(const char* log) : log_(log) { hold(); }

  /// Advances the arm by 1 ms under the newest force.
  In step() {
    const Vec3 force = kForce * Vec3(force_[0], force_[1], force_[2]);
    if (moves_) {
      if (logged_) {
        lines_ += std::to_string(steps_);
        for (const auto v : {report_.position[0], report_.position[1], report_.position[2],
                             force_[0], force_[1], force_[2]}) {
          lines_ += " " + std::to_string(v);
        }
        lines_ += "\n";
        ++steps_;
      }
      device_->write(force);
    }
    if (free_in_ > 0 && --free_in_ == 0) free();
    place();
    ++report_.count;
    report_.step = steps_;
    stepped_ = nowNs();
    return report_;
  }
  void take(const Out& out) {
    if (out.command == kNothing) {
      ++report_.received;
      report_.phase = static_cast<std::uint32_t>((nowNs() - stepped_) / 1000);
      force_ = out.force;
    }
    if (out.command == kGo) {
      hold();
      moves_ = logged_ = true;
      force_ = {};
      steps_ = 0;
      lines_.clear();
      place();
    }
    if (out.command == kRuler) {
      const auto measured = [](double t) -> Vec3 {
        const auto gone = [&](double from) {
          return kRulerWay * (std::clamp(t - from, 0.0, 1.0) - std::clamp(t - 20.0, 0.0, 1.0));
        };
        return start() + Vec3(gone(6.0), gone(11.0), gone(16.0));
      };
      device_ = std::make_unique<SimulatedDevice>(armParams(), GripParams{},
                                                  HandTarget{measured, 1e9}, 1000.0);
      moves_ = true;
      logged_ = false;
      force_ = {};
      free_in_ = 24000;
    }
  }
  void reset() { report_.count = 0; }
  void save() {
    std::FILE* file = std::fopen(log_, "w");
    if (file == nullptr) fail(log_);
    std::fputs(lines_.c_str(), file);
    std::fclose(file);
  }

 private:
  void free() {
    device_ = std::make_unique<SimulatedDevice>(
        armParams(), GripParams{0.0, 0.0}, HandTarget{[](double) { return start(); }, 1e9}, 1000.0);
    moves_ = true;
    logged_ = false;
  }
  void place() {
    const Vec3 p = device_->read().position;
    for (int a = 0; a < 3; ++a) {
      report_.position[static_cast<std::size_t>(a)] =
          static_cast<std::int32_t>(std::lround(p[a] / kStep));
    }
  }
  static Vec3 start() { return handPath().at(0.0); }
  void hold() {
    HandTarget path = handPath();
    path.seconds = 1e9;  // the hand stays at the end of the path
    device_ = std::make_unique<SimulatedDevice>(armParams(), GripParams{}, path, 1000.0);
  }
  const char* log_;
  int free_in_ = 0;  ///< Number of steps until the hand lets go.
  std::unique_ptr<SimulatedDevice> device_;
  In report_;
  std::array<std::int32_t, 3> force_{};
  bool moves_ = false;
  bool logged_ = false;
  std::uint32_t steps_ = 0;
  std::int64_t stepped_ = 0;  ///< Time of the last step [ns].
  std::string lines_;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const bool pid = std::strcmp(argv[1], "pid") == 0;
  std::unique_ptr<Wire> wire;
  if (pid) {
    // each PidArm opens uhid itself (runPidArms)
  } else if (std::strcmp(argv[1], "usb") == 0) {
    wire = std::make_unique<Usb>();
  } else {
    wire = std::make_unique<Uhid>();
  }
  sched_param priority{};
  // Requests a high priority: a simulated device must be as punctual as real hardware.
  priority.sched_priority = 98;
  sched_setscheduler(0, SCHED_FIFO, &priority);
  const int timer = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC);
  const itimerspec period{{0, 1000000}, {0, 1000000}};
  timerfd_settime(timer, 0, &period, nullptr);

  if (pid) runPidArms(timer);
  Arm arm(argv[2]);
  wire->plug();
  bool plugged = true;
  int away = 0;  // milliseconds until the device returns
  int late = 0;  // [ms]; printed at the end, because printing delays the arm
  for (;;) {
    std::array<pollfd, 2> waits{{{timer, POLLIN, 0}, {wire->descriptor(), POLLIN, 0}}};
    if (poll(waits.data(), plugged ? 2 : 1, -1) < 0) continue;
    if (plugged && waits[1].revents != 0) {
      Out out;
      if (wire->take(out)) {
        arm.take(out);
        if (out.command == kUnplug || out.command == kEnd) {
          wire->unplug();
          plugged = false;
          away = out.command == kUnplug ? 200 : -1;
          if (away < 0) {
            arm.save();
            std::printf("arm: %d ms late in all\n", late);
            return 0;
          }
        }
      }
    }
    if (waits[0].revents != 0) {
      std::uint64_t passed = 0;
      if (read(timer, &passed, sizeof(passed)) != sizeof(passed)) continue;
      late += static_cast<int>(passed - 1);
      for (; passed > 0; --passed) {
        const In report = arm.step();
        if (plugged) wire->frame(report);
        if (!plugged && --away == 0) {
          arm.reset();
          wire->plug();
          plugged = true;
        }
      }
    }
  }
}
