/// Reports to and from one device; hidapi behind it, or a test.
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

/// What waited.
enum class Got : std::uint8_t {
  kReport,
  kNothing,
  kGone,  ///< The device is unplugged, or its file is not one any more: nothing comes any more.
};

/// One device that is open. Reads are one thread's, writes another's; neither waits for the other.
class ReportPort {
 public:
  ReportPort() = default;
  ReportPort(const ReportPort&) = delete;
  ReportPort& operator=(const ReportPort&) = delete;
  virtual ~ReportPort() = default;

  /// The oldest report that waits, its number first where the device numbers them; never blocks.
  ///
  /// @param to    Room for the longest; a longer one is cut off.
  /// @param size  Its bytes.
  /// RT: no allocation but at the device's end, a system call or two (3 us).
  [[nodiscard]] virtual Got read(std::span<std::byte> to,
                                 std::size_t& size) noexcept PALPATE_NONBLOCKING = 0;
  /// Sends a report, its number (0: none) first. Blocks until the device has it, over USB a
  /// millisecond. False: gone.
  [[nodiscard]] virtual bool write(std::span<const std::byte> report) noexcept = 0;
  /// A feature report, its number first. False: refused or gone. With writes.
  [[nodiscard]] virtual bool sendFeature(std::span<const std::byte> report) noexcept = 0;
  /// Asks for a feature report. With writes; blocks as they do.
  ///
  /// @param report  Its number (0: none) first, and room for the longest.
  /// @param size    Its bytes, the number among them.
  /// @return        False: refused, or gone, or nothing can be asked for here.
  [[nodiscard]] virtual bool getFeature([[maybe_unused]] std::span<std::byte> report,
                                        [[maybe_unused]] std::size_t& size) noexcept {
    return false;
  }
  /// A descriptor of its own that takes what write() does, for a guardian; -1: there is none.
  [[nodiscard]] virtual int guardDescriptor() const noexcept { return -1; }
};

/// A device that is plugged in.
struct HidDeviceName {
  std::string path;              ///< As /dev/hidraw0; another one after each plugging in.
  std::uint16_t vendor = 0;      ///< USB's idVendor.
  std::uint16_t product = 0;     ///< USB's idProduct.
  std::uint16_t usage_page = 0;  ///< Of a top-level collection: a device with several
  std::uint16_t usage = 0;       ///< of them is listed once for each.
  std::string serial;            ///< May be empty, or the same for all of a kind.
  std::string maker;             ///< Words.
  std::string product_name;      ///< Words; may be empty.
  std::string port;              ///< Where it is plugged in, as the kernel says; may be empty.
  /// Its own report descriptor (parseHidDescriptor); empty where the system does not show it.
  std::vector<std::byte> descriptor;
};

/// All that are plugged in. Slow (milliseconds); never in a tick.
[[nodiscard]] std::vector<HidDeviceName> listHid();

/// Told a line for people; may be empty.
using Say = std::function<void(const std::string&)>;

/// Opens one by its path, for this program alone: two would each send a force of their own. Throws
/// DeviceError, in words: no such file, not a HID device, no permission, who has it (claim).
[[nodiscard]] std::unique_ptr<ReportPort> openHid(const std::string& path, const Say& say = {});

/// Opens one to read, whoever else has it: each reader gets every report. Nothing can be sent by
/// it. Throws DeviceError as openHid.
[[nodiscard]] std::unique_ptr<ReportPort> openHidToRead(const std::string& path);

/// True while this process has it open.
[[nodiscard]] bool isOpenHere(const std::string& path);

/// Makes a device this process' own as long as the descriptor, or one that is its copy, is open and
/// nobody unlocks it; a child that has one as well, as a guardian has, keeps it. Throws
/// DeviceError: who has it. Only those that ask by this are seen.
///
/// A program that was killed leaves it to its guardian, which takes the force off and ends within
/// the second: that is waited for, up to kLongestClaim, and said.
void claim(int descriptor, const std::string& path, const Say& say = {});
inline constexpr double kLongestClaim = 2.0;  ///< [s]

/// Where the kernel's own driver lets programs play effects on a HID device (hid-pidff): nodes as
/// /dev/input/event5. None where it does not.
///
/// @param sys  Where the system shows its HID devices.
[[nodiscard]] std::vector<std::string> effectNodes(
    const std::string& path, const std::filesystem::path& sys = "/sys/class/hidraw");
/// Throws DeviceError where a program of this user has one of them open to write: who.
void refuseEffects(const std::string& path, const std::vector<std::string>& nodes);

/// Programs of this user that have a path open to write, as "name (pid)"; those of others cannot be
/// seen.
[[nodiscard]] std::vector<std::string> whoHas(const std::string& path);

}  // namespace palpate
