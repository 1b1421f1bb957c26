/// Sends and receives the reports of one device.
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

  /// Reads the oldest waiting report, with its number first if reports are numbered. Never blocks.
  ///
  /// @param to  Buffer for a report; a report that is longer than the buffer is cut off.
  /// @param size  Length of the report in the buffer [bytes]; 0 without a report.
  ///
  /// RT: no allocation except when the device is gone; a system call or two.
  [[nodiscard]] virtual ReadStatus read(std::span<std::byte> to,
                                        std::size_t& size) noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a report, with its number first (0 without numbers). Blocks until the device has it,
  /// about a millisecond over USB. Returns false if the device refuses it or is gone.
  [[nodiscard]] virtual bool write(std::span<const std::byte> report) noexcept = 0;
  /// Sends a feature report, with its number first. Returns false if the device refuses it or is
  /// gone. Call it on the thread that writes.
  [[nodiscard]] virtual bool sendFeature(std::span<const std::byte> report) noexcept = 0;
  /// Requests a feature report. Call it on the thread that writes; blocks as write() does.
  ///
  /// @param report  Its number (0: none) first, and room for the longest report.
  /// @param size    Length of the answer, with the number [bytes].
  /// @return        False: the device refuses the request or is gone, or this port cannot request.
  [[nodiscard]] virtual bool getFeature([[maybe_unused]] std::span<std::byte> report,
                                        [[maybe_unused]] std::size_t& size) noexcept {
    return false;
  }
  /// Returns a second file descriptor that accepts the bytes of write(), for a guardian; -1: none.
  [[nodiscard]] virtual int guardDescriptor() const noexcept { return -1; }
};

/// A plugged-in device.
struct HidDeviceName {
  /// Path such as /dev/hidraw0. It may change each time the device is plugged in.
  std::string path;
  std::uint16_t vendor = 0;      ///< Vendor number, USB's idVendor.
  std::uint16_t product = 0;     ///< Product number, USB's idProduct.
  std::uint16_t usage_page = 0;  ///< Usage page of one of its top-level collections.
  /// Usage of the collection. A device is listed once for each collection.
  std::uint16_t usage = 0;
  /// Serial number; may be empty, or the same for all devices of a kind.
  std::string serial;
  std::string maker;         ///< Name of the maker; may be empty.
  std::string product_name;  ///< Name of the product; may be empty.
  /// Port where the device is plugged in, from the kernel; may be empty.
  std::string port;
  /// The device's report descriptor (parseHidDescriptor); empty if the system does not show it.
  std::vector<std::byte> descriptor;
};

/// Lists all plugged-in devices. Slow (milliseconds); not for a tick.
[[nodiscard]] std::vector<HidDeviceName> listHid();

/// Receives a line of text for the user; may be empty.
using Say = std::function<void(const std::string&)>;

/// Opens a device by its path, exclusively, because two programs would each send a force. Throws
/// DeviceError if the file does not exist, is not a HID device or may not be opened, or if another
/// program has claimed it (claim).
[[nodiscard]] std::unique_ptr<ReportPort> openHid(const std::string& path, const Say& say = {});

/// Opens a device for reading, even if another program has claimed it; each reader gets every
/// report. Otherwise throws DeviceError as openHid.
[[nodiscard]] std::unique_ptr<ReportPort> openHidToRead(const std::string& path);

/// Returns true while this process has the device of this path open by openHid().
[[nodiscard]] bool isOpenHere(const std::string& path);

/// Locks a device for this process until the lock is released, or until the descriptor and all its
/// copies (in child processes, too) are closed. Throws DeviceError, which names the owner if the
/// system shows it. Detects only programs that lock the device.
///
/// The guardian of a killed program keeps the lock until it has taken the force off, about 1.2 s at
/// most.
/// claim() tells the user and waits for the lock, up to kLongestClaim. For an owner that is alive,
/// it waits 50 ms.
void claim(int descriptor, const std::string& path, const Say& say = {});
inline constexpr double kLongestClaim = 2.0;  ///< [s], longest wait of claim()

/// Returns the nodes, such as /dev/input/event5, through which programs play effects on a HID
/// device by the kernel's driver (hid-pidff); may be empty. `sys`: the system's folder of HID
/// devices.
[[nodiscard]] std::vector<std::string> effectNodes(
    const std::string& path, const std::filesystem::path& sys = "/sys/class/hidraw");
/// If a program of this user has a node open for writing, throws DeviceError that names it.
void refuseEffects(const std::string& path, const std::vector<std::string>& nodes);

/// Returns the other programs that have a path open for writing, as "name (pid)". Sees only
/// programs whose descriptors this user may list.
[[nodiscard]] std::vector<std::string> whoHas(const std::string& path);

}  // namespace palpate
