#include "palpate/scenes/cli/common.h"

#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <unistd.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::cli {

volatile std::sig_atomic_t interrupted = 0;

std::function<void(double)> showProgress(const std::string& what) {
  if (isatty(STDERR_FILENO) == 0) return nullptr;
  using Clock = std::chrono::steady_clock;
  struct Line {
    Clock::time_point begin = Clock::now();
    int shown = -1;  ///< Percent.
    ~Line() {
      if (shown >= 0) sayAside("\r\x1b[K");
    }
  };
  return [what, line = std::make_shared<Line>()](double done) {
    const int percent = static_cast<int>(100.0 * done);
    if (percent == line->shown || Clock::now() - line->begin < std::chrono::milliseconds(500))
      return;
    line->shown = percent;
    sayAside("\r{}: {} %", what, percent);
    std::fflush(stderr);
  };
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
    path = path.parent_path() / std::filesystem::read_symlink(path, error);
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
  std::error_code error;
  path_ = behindLinks(path_);
  partial_ = path_;
  const auto status = std::filesystem::status(path_, error);
  const bool in_place =
      std::filesystem::exists(status) && !std::filesystem::is_regular_file(status);
  if (!in_place) partial_ += fmt::format(".partial-{}", getpid());
  file_ = std::fopen(partial_.c_str(), "wb");
  if (file_ == nullptr) {
    throw Error(path_.string(), std::string("it cannot be written (") + std::strerror(errno) + ")",
                "choose another place");
  }
}

WholeFile::~WholeFile() {
  if (file_ == nullptr || file_ == stdout) return;
  std::fclose(file_);
  if (partial_ != path_) std::remove(partial_.c_str());
}

void WholeFile::write(const std::string& text) {
  if (std::fwrite(text.data(), 1, text.size(), file_) != text.size()) {
    throw Error(path_.string(), std::string("writing failed (") + std::strerror(errno) + ")",
                "make room on the disk");
  }
}

int WholeFile::descriptor() const {
  return fileno(file_);
}

const std::filesystem::path& WholeFile::place() const {
  if (file_ == stdout) {
    throw Error("standard output", "this cannot be written to it", "give the name of a file");
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
  const bool in_place = partial_ == path_;
  if (flushed && !in_place) std::filesystem::rename(partial_, path_, error);
  if (!flushed || error) {
    if (!in_place) std::remove(partial_.c_str());
    throw Error(path_.string(), "it could not be finished", "check the disk and its permissions");
  }
}

WholeFolder::WholeFolder(const std::filesystem::path& path)
    : path_(path.has_filename() ? path : path.parent_path()) {  // "rubble/"
  if (path_.empty()) throw Error("the folder", "it has no name", "name one");
  std::error_code error;
  if (std::filesystem::exists(std::filesystem::symlink_status(path_, error))) {
    throw Error(path.string(), "it is there already", "remove it, or name another folder");
  }
  partial_ = path_;
  partial_ += fmt::format(".partial-{}", getpid());
  std::filesystem::create_directory(partial_, error);
  if (error) {
    partial_.clear();
    throw Error(path.string(), "the folder cannot be made (" + error.message() + ")",
                "choose another place");
  }
}

WholeFolder::~WholeFolder() {
  std::error_code error;
  if (!partial_.empty()) std::filesystem::remove_all(partial_, error);
}

void WholeFolder::commit() {
  std::error_code error;
  std::filesystem::rename(partial_, path_, error);
  if (error) {
    throw Error(path_.string(), "it could not be finished (" + error.message() + ")",
                "choose another place");
  }
  partial_.clear();
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
      throw Error(outputs[i], "two outputs would go there", "give each its own place");
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

void noteInterrupts() noexcept {
  const auto note = [](int) { interrupted = 1; };
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, note);
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
