/// `palpate`: the program. One file a verb; what they print and read is in docs/interfaces.md.
#include <exception>
#include <new>

#include <fmt/format.h>

#include "engine/error.h"
#include "scenes/cli/common.h"
#include "scenes/cli/version.h"

namespace {

int run(int argc, char** argv) {
  using namespace palpate;
  CLI::App app{
      "palpate: feel a volume. Loads .vdb volumes and scenes, and turns what a hand meets "
      "in them into forces."};
  app.set_version_flag("--version", cli::kVersion);
  app.require_subcommand(1);
  app.footer("Example:\n  palpate feel head.vdb --seconds 10 --trace trace.csv --summary -");

  std::function<int()> body;
  cli::addInfo(app, body);
  cli::addImport(app, body);
  cli::addSample(app, body);
  cli::addSolve(app, body);
  cli::addCheck(app, body);
  cli::addFeel(app, body);
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp& e) {
    return app.exit(e);
  } catch (const CLI::CallForAllHelp& e) {
    return app.exit(e);
  } catch (const CLI::CallForVersion& e) {
    return app.exit(e);
  } catch (const CLI::ParseError& e) {
    std::string verb;
    for (const CLI::App* sub : app.get_subcommands()) verb = sub->get_name() + " ";
    cli::complain(fmt::format("usage: {}: see palpate {}--help", e.what(), verb));
    return cli::kBadInput;
  }
  return body();
}

}  // namespace

int main(int argc, char** argv) {
  using namespace palpate;
  try {
    return run(argc, argv);
  } catch (const Error& e) {
    cli::complain(e.what());
    return cli::kBadInput;
  } catch (const std::bad_alloc&) {
    cli::complain("memory: there is not enough for this: use a smaller volume");
    return cli::kEndedEarly;
  } catch (const std::exception& e) {
    cli::complain(fmt::format("internal error: {}: please report it with the command", e.what()));
    return cli::kInternal;
  }
}
