#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <unistd.h>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/cli/picture.h"
#include "palpate/scenes/apps/cli/script.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

constexpr std::size_t kMostTraces = 6;
constexpr std::size_t kLongestTitle = 40;  // [characters]

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
                "make room in /tmp, or make it writable");
  }
  return file;
}

/// Opens a trace for trace_picture.py, which inherits the descriptor. Throws Error.
File opened(const std::string& path) {
  std::error_code error;
  if (path != "-" && std::filesystem::is_directory(path, error)) {
    throw Error(path, "it is a folder", "give a file from palpate feel --trace");
  }
  File file(path == "-" ? fdopen(dup(STDIN_FILENO), "rb") : std::fopen(path.c_str(), "rb"));
  if (!file) {
    throw Error(path, std::string("it cannot be read (") + std::strerror(errno) + ")",
                "check the path and its permissions");
  }
  return file;
}

/// Returns a title for each trace. From its second occurrence on, a title gets a number: "a", "a
/// (2)".
std::vector<std::string> titlesOf(const std::vector<std::string>& traces) {
  std::vector<std::string> titles;
  std::vector<std::string> stems;
  for (const std::string& path : traces) {
    stems.push_back(path == "-" ? "stdin" : std::filesystem::path(path).stem().string());
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

/// Throws Error with the reason if trace_picture.py has refused a trace.
void checkRefused(const OrderedJson& told, const std::vector<std::string>& traces) {
  if (!told.is_object() || !told.contains("refused")) return;
  const OrderedJson& refused = told["refused"];
  std::string where = traces.at(refused["run"].get<std::size_t>());
  if (const auto line = refused["line"].get<std::int64_t>(); line > 0) {
    where += fmt::format(" line {}", line);
  }
  throw Error(where, refused["reason"].get<std::string>(), refused["remedy"].get<std::string>());
}

void sayRun(const OrderedJson& run) {
  const auto text = [](const OrderedJson& value) {
    return value.is_number() ? rounded(value.get<double>()) : std::string("unknown");
  };
  const auto& times = run["tick_us"];
  say("{}: {} ticks in {} s; at most {} N, {} mm from probe to proxy, error {} m; {} mJ given to "
      "the hand; tick {} us median, {} p99, {} p99.9, {} worst; the limiter acted in {}\n",
      run["name"].get<std::string>(), run["ticks"].get<long>(), text(run["seconds"]),
      text(run["force_max"]), text(run["gap_max_mm"]), text(run["error_bound_max"]),
      text(run["energy_mJ"]), text(times.value("p50", OrderedJson())),
      text(times.value("p99", OrderedJson())), text(times.value("p99.9", OrderedJson())),
      text(times["max"]), counted(run["limited"].get<long>(), "tick", "ticks"));
}

int plot(const PlotOptions& options) {
  const std::string format = formatOf(options.out);
  if (options.traces.size() > kMostTraces) {
    throw Error("usage", fmt::format("{} traces do not fit side by side", options.traces.size()),
                fmt::format("give at most {}", kMostTraces));
  }
  noteInterrupts();
  std::vector<File> traces;
  for (const std::string& path : options.traces) traces.push_back(opened(path));
  checkOutputsApart({options.out}, {options.traces.begin(), options.traces.end()});
  WholeFile file(options.out);
  const Script script("trace_picture.py", "plot");

  OrderedJson json;
  json["made_by"] = versionText();
  json["runs"] = OrderedJson::array();
  const std::vector<std::string> titles = titlesOf(options.traces);
  for (std::size_t i = 0; i < traces.size(); ++i) {
    json["runs"].push_back({{"name", titles[i]}, {"descriptor", fileno(traces[i].get())}});
  }
  const File told = scratch();
  try {
    script.draw(json, file, options.out,
                {format, "--told", fmt::format("/dev/fd/{}", fileno(told.get()))});
  } catch (const Error&) {
    endIfInterrupted();  // Ctrl-C interrupts the script too
    checkRefused(OrderedJson::parse(contentOf(told), nullptr, false), options.traces);
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
