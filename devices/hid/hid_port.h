/// Sends and receives reports of one device, by hidapi or in a test.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// Result of a read.
enum class ReadStatus : std::uint8_t {
  kReport,
  kNothing,
  kGone,  ///< The device is unplugged, or its file is no longer a device. No more reports come.
};

/// One open device. One thread reads and one writes; neither waits for the other.
class ReportPort {
 public:
  ReportPort() = default;
  ReportPort(const ReportPort&) = delete;
  ReportPort& operator=(const ReportPort&) = delete;
  virtual ~ReportPort() = default;

  /// Reads the oldest waiting report, with its number first if the device numbers them. Never
  /// blocks.
  ///
  /// @param to    Room for the longest report; a longer one is cut off.
  /// @param size  Its bytes.
  ///
  /// RT: no allocation except when the device is gone; a system call or two (3 us).
  [[nodiscard]] virtual ReadStatus read(std::span<std::byte> to,
                                        std::size_t& size) noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a report, its number (0: none) first. Blocks until the device has it, over USB a
  /// millisecond. Returns false if the device is gone.
  [[nodiscard]] virtual bool write(std::span<const std::byte> report) noexcept = 0;
  /// Sends a feature report, its number first. Returns false if it is refused or the device is
  /// gone. On the thread that writes.
  [[nodiscard]] virtual bool sendFeature(std::span<const std::byte> report) noexcept = 0;
  /// Requests a feature report. On the thread that writes; blocks as a write does.
  ///
  /// @param report  Its number (0: none) first, and room for the longest.
  /// @param size    Its bytes, including the number.
  /// @return        False: refused, or gone, or requests are not possible here.
  [[nodiscard]] virtual bool getFeature([[maybe_unused]] std::span<std::byte> report,
                                        [[maybe_unused]] std::size_t& size) noexcept {
    return false;
  }
  /// Returns a separate descriptor, for a guardian, that takes the same bytes as write(); -1: not
  /// available.
  [[nodiscard]] virtual int guardDescriptor() const noexcept { return -1; }
};

/// A plugged-in device.
struct HidDeviceName {
  std::string path;              ///< Path such as /dev/hidraw0; changes with each plugging in.
  std::uint16_t vendor = 0;      ///< USB's idVendor.
  std::uint16_t product = 0;     ///< USB's idProduct.
  std::uint16_t usage_page = 0;  ///< Usage page of a top-level collection.
  std::uint16_t usage = 0;       ///< Its usage; a device is listed once for each collection.
  std::string serial;            ///< May be empty, or the same for all devices of a kind.
  std::string maker;             ///< In words.
  std::string product_name;      ///< In words; may be empty.
  std::string port;              ///< Port where it is plugged in, from the kernel; may be empty.
  /// The device's report descriptor (parseHidDescriptor); empty if the system does not show it.
  std::vector<std::byte> descriptor;
};

/// Lists all plugged-in devices. Slow (milliseconds); not for a tick.
[[nodiscard]] std::vector<HidDeviceName> listHid();

/// Receives a line of text for the user; may be empty.
using Say = std::function<void(const std::string&)>;

/// Opens a device by its path, exclusively: two programs would each send a force. Throws
/// DeviceError: no such file, not a HID device, no permission, or the owner's name (claim).
[[nodiscard]] std::unique_ptr<ReportPort> openHid(const std::string& path, const Say& say = {});

/// Opens a device to read, even if another program uses it; each reader gets every report. Cannot
/// send. Throws DeviceError as openHid.
[[nodiscard]] std::unique_ptr<ReportPort> openHidToRead(const std::string& path);

/// Returns true while this process has the device open.
[[nodiscard]] bool isOpenHere(const std::string& path);

/// Locks a device for this process while the descriptor or a copy of it is open, until the lock is
/// released. A child with a copy, such as a guardian, keeps the lock. Throws DeviceError that names
/// the owner. Detects only programs that call claim().
///
/// If a program was killed, its guardian has the lock, takes the force off and ends within a
/// second. claim() waits for that, up to kLongestClaim, and reports it.
void claim(int descriptor, const std::string& path, const Say& say = {});
inline constexpr double kLongestClaim = 2.0;  ///< [s]

/// Returns the nodes, such as /dev/input/event5, by which the kernel's driver (hid-pidff) lets
/// programs play effects on a HID device. Empty if it does not.
///
/// @param sys  Directory in which the system shows its HID devices.
[[nodiscard]] std::vector<std::string> effectNodes(
    const std::string& path, const std::filesystem::path& sys = "/sys/class/hidraw");
/// Throws DeviceError if a program of this user has one of the nodes open to write; the error names
/// the program.
void refuseEffects(const std::string& path, const std::vector<std::string>& nodes);

/// Returns this user's programs that have a path open to write, as "name (pid)". Other users'
/// programs cannot be seen.
[[nodiscard]] std::vector<std::string> whoHas(const std::string& path);

}  // namespace palpate
