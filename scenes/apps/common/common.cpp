#include "palpate/scenes/apps/common/common.h"

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <string_view>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"
#include "palpate/scenes/library/new_file.h"

namespace palpate::cli {

volatile std::sig_atomic_t interrupted = 0;

namespace {

/// Paths of unfinished files; endNow() removes these files. An unused entry is null.
constexpr std::size_t kMostPartials = 16;
std::array<std::atomic<const char*>, kMostPartials> partials{};
std::atomic<bool> line_shown = false;
static_assert(std::atomic<const char*>::is_always_lock_free);

void addPartial(const std::filesystem::path& file) {
  for (auto& place : partials) {
    const char* expected = nullptr;
    if (place.compare_exchange_strong(expected, file.c_str())) return;
  }
}

/// Returns what to do if a file cannot be written or completed, by its `errno`.
std::string remedyForWriting(int error) {
  if (error == EFBIG) return "raise the limit of file sizes (ulimit -f), or choose another disk";
  if (error == ENOSPC || error == EDQUOT) return "make room on the disk, or choose another disk";
  return "check the disk and the folder's permissions, or choose another disk";
}

void forgetPartial(const std::filesystem::path& file) {
  for (auto& place : partials) {
    const char* expected = file.c_str();
    if (place.compare_exchange_strong(expected, nullptr)) return;
  }
}

/// Async-signal-safe.
void removePartials() noexcept {
  for (const auto& place : partials) {
    if (const char* file = place.load()) unlink(file);
  }
}

/// Signal handler: calls only async-signal-safe functions.
void endNow(int /*signal*/) {
  removePartials();
  constexpr std::string_view kClear = "\r\x1b[K";
  constexpr std::string_view kSaid = "palpate: interrupted: unfinished output was not written\n";
  if (line_shown) (void)!write(STDERR_FILENO, kClear.data(), kClear.size());
  (void)!write(STDERR_FILENO, kSaid.data(), kSaid.size());
  _exit(kInterrupted);
}

void handle(void (*handler)(int)) noexcept {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction now {};
    sigaction(signal, nullptr, &now);
    // Signals that the parent process ignores, as nohup does, stay ignored.
    if (now.sa_handler == SIG_IGN) continue;
    struct sigaction action {};
    action.sa_handler = handler;
    action.sa_flags = SA_RESTART;
    sigemptyset(&action.sa_mask);
    sigaction(signal, &action, nullptr);
  }
}

/// A progress line. Its own thread updates the elapsed time, even while no progress is reported.
class Line {
 public:
  explicit Line(std::string what) : what_(std::move(what)), drawer_([this] { draw(); }) {}
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;
  ~Line() {
    {
      const std::lock_guard lock(mutex_);
      over_ = true;
    }
    wake_.notify_one();
    drawer_.join();
  }
  void at(double done) { percent_ = static_cast<int>(100.0 * done); }

 private:
  void draw() {
    constexpr auto kPatience = std::chrono::seconds(1);
    constexpr auto kOften = std::chrono::milliseconds(250);
    std::unique_lock lock(mutex_);
    const auto over = [this] { return over_; };
    const auto begin = std::chrono::steady_clock::now();
    for (auto pause = std::chrono::milliseconds(kPatience); !wake_.wait_for(lock, pause, over);
         pause = kOften) {
      const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(
          std::chrono::steady_clock::now() - begin);
      line_shown = true;
      const int percent = percent_;
      sayAside("\r{}: {}{} s\x1b[K", what_, percent < 0 ? "" : fmt::format("{} %, ", percent),
               seconds.count());
      std::fflush(stderr);
    }
    if (line_shown.exchange(false)) sayAside("\r\x1b[K");
  }

  std::string what_;
  std::atomic<int> percent_ = -1;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool over_ = false;
  std::thread drawer_;
};

}  // namespace

std::function<void(double)> showProgress(const std::string& what) {
  if (isatty(STDERR_FILENO) == 0) return nullptr;
  return [line = std::make_shared<Line>(what)](double done) { line->at(done); };
}

std::string number(double value) {
  return std::isfinite(value) ? fmt::format("{}", value) : "";
}

std::string rounded(double value) {
  return fmt::format("{:.4g}", value);
}

OrderedJson toJson(const Vec3& v) {
  return OrderedJson::array({v.x(), v.y(), v.z()});
}

std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file) {
  std::error_code error;
  const auto time = std::filesystem::last_write_time(file, error);
  if (error) return std::nullopt;
  return time;
}

std::vector<char*> argumentsOf(std::vector<std::string>& words) {
  std::vector<char*> argv;
  argv.reserve(words.size() + 1);
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  return argv;
}

std::string shellWord(const std::string& text) {
  const std::string plain =
      "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./+-=:,@%";
  if (!text.empty() && text.find_first_not_of(plain) == std::string::npos) return text;
  std::string quoted = "'";
  for (const char c : text) quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return quoted + "'";
}

std::filesystem::path behindLinks(std::filesystem::path path) {
  std::error_code error;
  for (int links = 0; links < 40 && std::filesystem::is_symlink(path, error); ++links) {
    const auto behind = path.parent_path() / std::filesystem::read_symlink(path, error);
    // A link such as /dev/stdout can lead to a pipe, which has no file name: then the result is the
    // link.
    if (!std::filesystem::exists(std::filesystem::symlink_status(behind, error)) &&
        std::filesystem::exists(std::filesystem::status(path, error))) {
      break;
    }
    path = behind;
  }
  return path;
}

void checkReplaceable(const std::filesystem::path& file) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (!std::filesystem::exists(status) || std::filesystem::is_regular_file(status)) return;
  throw Error(file.string(),
              std::filesystem::is_directory(status) ? "it is a folder" : "it is a pipe or a device",
              "name a file to write");
}

WholeFile::WholeFile(std::filesystem::path path) : path_(std::move(path)) {
  if (path_ == "-") {
    file_ = stdout;
    return;
  }
  path_ = behindLinks(path_);
  checkReplaceable(path_);
  partial_ = partialOf(path_);
  addPartial(partial_);
  Descriptor descriptor(createNewFile(partial_));
  if (descriptor.get() >= 0) file_ = fdopen(descriptor.get(), "wb");
  if (file_ == nullptr) {
    forgetPartial(partial_);
    throw Error(path_.string(), std::string("it cannot be written (") + std::strerror(errno) + ")",
                "check the folder and its permissions, or choose another folder");
  }
  (void)descriptor.release();
}

WholeFile::~WholeFile() {
  if (file_ == nullptr || file_ == stdout) return;
  std::fclose(file_);
  std::remove(partial_.c_str());
  forgetPartial(partial_);
}

void WholeFile::write(const std::string& text) {
  if (std::fwrite(text.data(), 1, text.size(), file_) != text.size()) {
    const int error = errno;
    const std::string why = std::string("writing failed (") + std::strerror(error) + ")";
    if (file_ == stdout) throw Error("standard output", why, "check the disk or the pipe");
    throw Error(path_.string(), why, remedyForWriting(error));
  }
}

int WholeFile::descriptor() const {
  return fileno(file_);
}

std::filesystem::path WholeFile::place() const {
  if (file_ == stdout) {
    throw Error("standard output", "it cannot receive this output, which must be a file",
                "give the name of a file");
  }
  return partial_;
}

void WholeFile::commit() {
  if (file_ == stdout) {
    std::fflush(stdout);
    return;
  }
  std::FILE* file = std::exchange(file_, nullptr);
  const bool flushed = std::fclose(file) == 0;
  std::error_code error;
  if (!flushed) error.assign(errno, std::generic_category());
  if (flushed) std::filesystem::rename(partial_, path_, error);
  const bool whole = !error;
  if (!whole) std::remove(partial_.c_str());
  forgetPartial(partial_);
  if (!whole) {
    throw Error(path_.string(), "the file could not be completed (" + error.message() + ")",
                remedyForWriting(error.value()));
  }
}

bool isSamePlace(const std::filesystem::path& a, const std::filesystem::path& b) {
  if (a == "-" || b == "-") return a == b;
  const auto place = [](const std::filesystem::path& path) {
    std::error_code error;
    const std::filesystem::path whole = std::filesystem::absolute(behindLinks(path), error);
    const std::filesystem::path real = std::filesystem::weakly_canonical(whole, error);
    return error ? whole : real;
  };
  return place(a) == place(b);
}

void checkOutputsApart(const std::vector<std::string>& outputs,
                       const std::vector<std::filesystem::path>& inputs) {
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (outputs[i].empty() || outputs[j].empty() || !isSamePlace(outputs[i], outputs[j])) {
        continue;
      }
      if (outputs[i] == "-") {
        throw Error("standard output", "two outputs would be mixed", "send only one of them there");
      }
      throw Error(outputs[i], "two outputs are the same file", "give each output its own file");
    }
  }
  for (const std::string& output : outputs) {
    for (const std::filesystem::path& input : inputs) {
      std::error_code error;
      if (output.empty() || output == "-" || !std::filesystem::equivalent(output, input, error)) {
        continue;
      }
      throw Error(output, "it is an input of this run", "write to another file");
    }
  }
}

void endWithoutFiles(int status) noexcept {
  removePartials();
  _exit(status);
}

void endAtInterrupts() noexcept {
  handle(endNow);
}

void noteInterrupts() noexcept {
  handle([](int) { interrupted = 1; });
}

void endIfInterrupted() {
  if (interrupted != 0) throw Interrupted{};
}

std::filesystem::path programFolder() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return error ? std::filesystem::path(".") : self.parent_path();
}

}  // namespace palpate::cli
