/// `palpate`: the main program; docs/verbs.md describes its verbs.
#include <algorithm>
#include <array>
#include <csignal>
#include <cstdio>
#include <exception>
#include <fcntl.h>
#include <filesystem>
#include <functional>
#include <ios>
#include <new>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/engine/version.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

using Body = std::function<int()>;

// addView is in feel.cpp; each other function is in the source file of its verb. A function sets
// `body`, which returns the exit status.
void addInfo(CLI::App& app, Body& body);
void addImport(CLI::App& app, Body& body);
void addBrick(CLI::App& app, Body& body);
void addMake(CLI::App& app, Body& body);
void addScene(CLI::App& app, Body& body);
void addSample(CLI::App& app, Body& body);
void addSolve(CLI::App& app, Body& body);
void addCheck(CLI::App& app, Body& body);
void addExplain(CLI::App& app, Body& body);
void addPress(CLI::App& app, Body& body);
void addFeel(CLI::App& app, Body& body);
void addView(CLI::App& app, Body& body);
void addCompare(CLI::App& app, Body& body);
void addConvert(CLI::App& app, Body& body);
void addPlot(CLI::App& app, Body& body);
void addStability(CLI::App& app, Body& body);
void addDevices(CLI::App& app, Body& body);
void addSchema(CLI::App& app, Body& body);

namespace {

constexpr std::array kVerbs{addInfo,      addImport,  addBrick,   addScene,   addMake,
                            addSample,    addSolve,   addCheck,   addExplain, addPress,
                            addFeel,      addView,    addCompare, addConvert, addPlot,
                            addStability, addDevices, addSchema};

}  // namespace
}  // namespace palpate::cli

namespace {

std::string versionLines() {
  using namespace palpate;
  const bool with_vtk = std::filesystem::exists(cli::programFolder() / "palpate-import");
  return fmt::format("{}\n{}, {}; imports {}", versionText(), kCompiler, kBuildType,
                     with_vtk ? "with VTK" : "without VTK");
}

int run(const std::vector<std::string>& words);

void addHelp(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand("help", "Prints the help of a command");
  auto about = std::make_shared<std::string>();
  verb->add_option("VERB", *about, "The command; if omitted, prints the help of palpate");
  verb->footer("Example:\n  palpate help feel");
  verb->callback([=, &body] {
    body = [=] { return about->empty() ? run({"--help"}) : run({*about, "--help"}); };
  });
}

/// Runs the command line `words`, which excludes the program's name. Returns the exit status.
int run(const std::vector<std::string>& words) {
  using namespace palpate;
  // When synchronised with C's stdin, std::cin would report a read error as the end of the input.
  std::ios::sync_with_stdio(false);
  CLI::App app{
      "palpate: feel a volume. Loads .vdb volumes and scenes, and computes the forces on a hand "
      "that touches them."};
  app.name("palpate");
  app.set_version_flag("--version", versionLines);
  app.require_subcommand(1);
  app.footer("Example:\n  palpate feel head.vdb --seconds 10 --trace trace.csv --summary -");

  std::function<int()> body;
  for (const auto& add : cli::kVerbs) add(app, body);
  addHelp(app, body);

  // Reports an unknown verb before CLI11 does, and suggests the most similar verb.
  const std::string first = words.empty() ? "" : words[0];
  std::vector<std::string> verbs;
  for (const CLI::App* verb : app.get_subcommands({})) verbs.push_back(verb->get_name());
  if (!first.empty() && first[0] != '-' &&
      std::find(verbs.begin(), verbs.end(), first) == verbs.end()) {
    const std::string near = nearestName(first, verbs);
    throw Error("usage", "\"" + first + "\" is not a command of palpate",
                near.empty() ? "see palpate --help" : "did you mean \"" + near + "\"?");
  }

  try {
    app.parse(std::vector<std::string>(words.rbegin(), words.rend()));
  } catch (const CLI::Success& e) {  // a request for help or for the version
    std::ostringstream out;
    const int status = app.exit(e, out);
    cli::sayRaw(out.str());
    cli::flushOutput();
    return status;
  } catch (const CLI::ParseError& e) {
    std::string verb;
    for (const CLI::App* sub : app.get_subcommands()) verb = sub->get_name() + " ";
    cli::complain(fmt::format("usage: {}: see palpate {}--help", e.what(), verb));
    return cli::kBadInput;
  }
  const int status = body();
  // If the output is incomplete, the run has failed.
  cli::flushOutput();
  return status;
}

/// Opens /dev/null for each closed standard stream; otherwise a new file could get its descriptor.
void holdStandardStreams() {
  for (const int fd : {0, 1, 2}) {
    if (fcntl(fd, F_GETFD) == -1) (void)open("/dev/null", fd == 1 ? O_RDONLY : O_RDWR);
  }
  // If these signals are ignored, a write to a closed pipe or beyond the limit of a file's size
  // returns an error.
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
}

/// Restores the default of SIGCHLD: while SIGCHLD is ignored, children's exit statuses are lost.
void hearChildren() {
  std::signal(SIGCHLD, SIG_DFL);
}

}  // namespace

int main(int argc, char** argv) {
  using namespace palpate;
  try {
    holdStandardStreams();
    hearChildren();
    cli::endAtInterrupts();
    return run({argv + std::min(argc, 1), argv + argc});
  } catch (const Error& e) {
    cli::complain(e.what());
    return cli::kBadInput;
  } catch (const cli::Interrupted&) {
    cli::complain("interrupted: unfinished output was not written");
    return cli::kInterrupted;
  } catch (const std::bad_alloc&) {
    cli::complain(
        "memory: not enough memory is available: use smaller volumes, or volumes in bricks "
        "(palpate brick), or end other programs");
    return cli::kEndedEarly;
  } catch (const std::filesystem::filesystem_error& e) {
    cli::complain(
        fmt::format("{}: the file system reports an error ({}): check the path and its permissions",
                    e.path1().string(), e.code().message()));
    return cli::kBadInput;
  } catch (const std::system_error& e) {
    const bool output = std::ferror(stdout) != 0;
    cli::complain(fmt::format(
        "{} ({}): {}",
        output ? "standard output: it cannot be written" : "the system reports an error",
        e.code().message(),
        output ? "check the disk or the pipe" : "end other programs, or report this message"));
    return cli::kEndedEarly;
  } catch (const std::exception& e) {
    cli::complain(fmt::format(
        "internal error: {}: please report this message and your command line", e.what()));
    return cli::kInternal;
  }
}
