/// palpate import: starts the program palpate-import, so that other verbs need not load VTK. If
/// palpate-import is not installed, starts palpate-import-light, which has no VTK.
#include <cerrno>
#include <cstring>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

void addImport(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand("import", "Converts CT, MRI, CFD and other data to a .vdb");
  verb->prefix_command();
  verb->set_help_flag();  // palpate-import and palpate-import-light print their help
  verb->callback([verb, &body] {
    body = [verb] {
      std::vector<std::string> words = verb->remaining();
      words.emplace(words.begin());
      std::string program;
      for (const char* name : {"palpate-import", "palpate-import-light"}) {
        program = (programFolder() / name).string();
        words.front() = name;
        execv(program.c_str(), argumentsOf(words).data());
        if (errno != ENOENT) break;
      }
      throw Error(program, std::string("it cannot be started (") + std::strerror(errno) + ")",
                  "install palpate again");
      return kInternal;
    };
  });
}

}  // namespace palpate::cli
