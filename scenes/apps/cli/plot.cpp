#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unistd.h>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/tick/step_report.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/script.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

constexpr std::size_t kMostTraces = 6;
constexpr std::size_t kLongestRow = 65536;     // [bytes]
constexpr std::size_t kLongestTitle = 40;      // [characters]
constexpr std::size_t kRowsAtOnce = 1U << 16;  // Rows between two checks for an interrupt
constexpr const char* kOut = "write one with palpate feel SCENE --trace T.csv";

struct PlotOptions {
  std::vector<std::string> traces;
  std::string out;
  bool json = false;
};

struct CloseFile {
  void operator()(std::FILE* file) const noexcept { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

File scratch() {
  File file(std::tmpfile());
  if (!file) {
    throw Error("temporary files",
                std::string("no file can be created (") + std::strerror(errno) + ")",
                "make room in /tmp");
  }
  return file;
}

/// Returns a path by which a child process opens a file whose descriptor it has inherited.
std::string handed(const File& file) {
  return fmt::format("/dev/fd/{}", fileno(file.get()));
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlank = " \t\r\n";
  const std::size_t first = text.find_first_not_of(kBlank);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlank) - first + 1);
}

std::vector<std::string_view> fieldsOf(std::string_view line) {
  std::vector<std::string_view> fields;
  while (true) {
    const std::size_t comma = line.find(',');
    fields.push_back(trimmed(line.substr(0, comma)));
    if (comma == std::string_view::npos) return fields;
    line.remove_prefix(comma + 1);
  }
}

/// An open trace file. The constructor checks the column names; checkRows() reads the rows.
class TraceFile {
 public:
  /// Throws Error if the file cannot be read, or if a needed column is missing.
  explicit TraceFile(const std::string& path) : path_(path) {
    std::error_code error;
    if (path != "-" && std::filesystem::is_directory(path, error)) {
      throw Error(path, "it is a folder", "give a trace");
    }
    file_.reset(path == "-" ? fdopen(dup(STDIN_FILENO), "rb") : std::fopen(path.c_str(), "rb"));
    if (!file_) {
      throw Error(path, std::string("it cannot be read (") + std::strerror(errno) + ")",
                  "check the path and its permissions");
    }
    // A pipe can be read only once, so its content is copied for trace_picture.py.
    if (path == "-" || !std::filesystem::is_regular_file(path, error)) copy_ = scratch();
    while (line_ = next(), line_ && trimmed(*line_).empty()) {
    }
    std::string_view header = line_ ? std::string_view(*line_) : std::string_view();
    constexpr std::string_view kMark = "\xEF\xBB\xBF";
    if (header.substr(0, kMark.size()) == kMark) header.remove_prefix(kMark.size());
    std::vector<std::string_view> names = fieldsOf(header);
    columns_ = names.size();
    for (const char* name : kNumbers) numbers_.push_back(columnOf(names, name));
    status_ = columnOf(names, "status");
  }

  /// Throws Error if a row is invalid, or if the trace has no rows.
  void checkRows() {
    std::size_t rows = 0;
    double before = 0.0;
    while (const std::optional<std::string_view> line = next()) {
      if (trimmed(*line).empty()) continue;
      const double now = checkRow(*line);
      if (rows > 0 && now < before) {
        throw Error(where(), "its time is earlier than in the row above",
                    "give a trace of one run");
      }
      before = now;
      if (++rows % kRowsAtOnce == 0) endIfInterrupted();
    }
    if (std::ferror(file_.get()) != 0) {
      throw Error(path_, fmt::format("reading failed after line {}", number_), "check the disk");
    }
    if (rows == 0) throw Error(path_, "it has no rows", kOut);
    if (copy_ && (std::fflush(copy_.get()) != 0 || std::ferror(copy_.get()) != 0)) {
      throw Error(path_, "its temporary copy could not be written", "make room in /tmp");
    }
  }

  /// Returns the path for trace_picture.py. Call checkRows() first, which copies a pipe.
  [[nodiscard]] std::string place() const { return handed(copy_ ? copy_ : file_); }
  [[nodiscard]] std::string stem() const {
    return path_ == "-" ? "stdin" : std::filesystem::path(path_).stem().string();
  }

 private:
  static constexpr const char* kNumbers[] = {
      "t",       "probe_x", "probe_y", "probe_z", "proxy_x",     "proxy_y", "proxy_z",
      "force_x", "force_y", "force_z", "tick_ns", "error_bound", "limited"};

  [[nodiscard]] std::string where() const { return fmt::format("{} line {}", path_, number_); }

  std::optional<std::string_view> next() {
    buffer_.resize(kLongestRow);
    if (std::fgets(buffer_.data(), static_cast<int>(buffer_.size()), file_.get()) == nullptr) {
      return std::nullopt;
    }
    ++number_;
    const std::string_view line(buffer_.data());
    if (line.size() + 1 == buffer_.size()) {
      throw Error(where(), fmt::format("it is longer than {} bytes", kLongestRow - 2), kOut);
    }
    if (copy_) (void)std::fwrite(line.data(), 1, line.size(), copy_.get());
    return line;
  }

  std::size_t columnOf(const std::vector<std::string_view>& names, const char* name) const {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) {
      throw Error(path_, fmt::format("it is not a trace: the column \"{}\" is missing", name),
                  kOut);
    }
    return static_cast<std::size_t>(found - names.begin());
  }

  double checkRow(std::string_view line) const {
    const std::vector<std::string_view> fields = fieldsOf(line);
    if (fields.size() != columns_) {
      throw Error(where(), fmt::format("it has {} fields instead of {}", fields.size(), columns_),
                  "correct or remove the row");
    }
    double time = 0.0;
    for (std::size_t i = 0; i < numbers_.size(); ++i) {
      const std::string_view field = fields[numbers_[i]];
      if (field.empty() && i > 0) continue;  // the tick has no value in this column
      double value = 0.0;
      const char* const end = field.data() + field.size();
      const auto [stop, error] = std::from_chars(field.data(), end, value);
      if (error != std::errc() || stop != end || !std::isfinite(value)) {
        throw Error(where(), fmt::format("{}: \"{}\" is not a finite number", kNumbers[i], field),
                    "correct or remove the row");
      }
      if (i == 0) time = value;
    }
    const std::string_view word = fields[status_];
    for (std::size_t i = 0; i < kStepStatuses; ++i) {
      if (word == wordFor(static_cast<StepStatus>(i))) return time;
    }
    throw Error(where(), fmt::format("\"{}\" is not a status", word), "correct or remove the row");
  }

  std::string path_;
  File file_;
  File copy_;
  std::string buffer_;
  std::optional<std::string_view> line_;
  std::size_t number_ = 0;
  std::size_t columns_ = 0;
  std::vector<std::size_t> numbers_;
  std::size_t status_ = 0;
};

/// Returns a title for each trace. A title that occurs several times gets a number.
std::vector<std::string> titlesOf(const std::vector<std::unique_ptr<TraceFile>>& traces) {
  std::vector<std::string> titles;
  std::vector<std::string> stems;
  for (const auto& trace : traces) {
    stems.push_back(trace->stem());
    const auto same = std::count(stems.begin(), stems.end(), stems.back());
    const std::string name = Legible(stems.back(), kLongestTitle).text();
    titles.push_back(same == 1 ? name : fmt::format("{} ({})", name, same));
  }
  return titles;
}

std::string contentOf(const File& file) {
  std::string text;
  std::rewind(file.get());
  char part[4096];
  while (const std::size_t got = std::fread(part, 1, sizeof part, file.get())) {
    text.append(part, got);
  }
  return text;
}

void sayRun(const OrderedJson& run) {
  const auto text = [](const OrderedJson& value) {
    return value.is_number() ? rounded(value.get<double>()) : std::string("unknown");
  };
  const auto& times = run["tick_us"];
  say("{}: {} ticks in {} s; at most {} N, {} mm from probe to proxy, error {} m; {} mJ given to "
      "the hand; tick {} us median, {} p99, {} p99.9, {} worst; {} limited ticks\n",
      run["name"].get<std::string>(), run["ticks"].get<long>(), text(run["seconds"]),
      text(run["force_max"]), text(run["gap_max_mm"]), text(run["error_bound_max"]),
      text(run["energy_mJ"]), text(times.value("p50", OrderedJson())),
      text(times.value("p99", OrderedJson())), text(times.value("p99.9", OrderedJson())),
      text(times["max"]), run["limited"].get<long>());
}

int plot(const PlotOptions& options) {
  const std::string format = formatOf(options.out);
  if (options.traces.size() > kMostTraces) {
    throw Error("usage", fmt::format("{} traces do not fit side by side", options.traces.size()),
                fmt::format("give at most {}", kMostTraces));
  }
  noteInterrupts();
  std::vector<std::unique_ptr<TraceFile>> traces;
  for (const std::string& path : options.traces) {
    traces.push_back(std::make_unique<TraceFile>(path));
  }
  checkOutputsApart({options.out}, {options.traces.begin(), options.traces.end()});
  WholeFile file(options.out);
  for (const auto& trace : traces) trace->checkRows();
  const Script script("trace_picture.py", "plot");

  OrderedJson json;
  json["made_by"] = versionText();
  json["runs"] = OrderedJson::array();
  const std::vector<std::string> titles = titlesOf(traces);
  for (std::size_t i = 0; i < traces.size(); ++i) {
    json["runs"].push_back({{"name", titles[i]}, {"file", traces[i]->place()}});
  }
  const File told = scratch();
  try {
    script.draw(json, file, options.out, {format, "--told", handed(told)});
  } catch (const Error&) {
    endIfInterrupted();  // Ctrl-C interrupts the script too
    throw;
  }
  endIfInterrupted();
  file.commit();
  OrderedJson drawn = OrderedJson::parse(contentOf(told));
  if (options.json) {
    sayJson(drawn, 1);
    return kDone;
  }
  for (const auto& run : drawn["runs"]) sayRun(run);
  return kDone;
}

}  // namespace

void addPlot(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("plot", "Draws traces side by side: paths, forces, errors, tick times");
  auto o = std::make_shared<PlotOptions>();
  verb->add_option("TRACE", o->traces, "Files from feel --trace, up to six; - is standard input")
      ->required();
  verb->add_option("--out", o->out, "The picture: .png (300 dpi), .pdf or .svg")->required();
  verb->add_flag("--json", o->json, "Print the drawn content as JSON");
  verb->footer("Example:\n  palpate plot soft.csv stiff.csv --out runs.pdf");
  verb->callback([=, &body] { body = [=] { return plot(*o); }; });
}

}  // namespace palpate::cli
