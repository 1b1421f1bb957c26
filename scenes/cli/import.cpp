/// palpate import: hands over to palpate-import, so that nothing else loads VTK; where that is not
/// installed to palpate-import-light, which does without.
#include <cerrno>
#include <cstring>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

void addImport(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand("import", "Turns CT, MRI, CFD and the like into a .vdb");
  verb->prefix_command();
  verb->set_help_flag();  // they have their own
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
      throw Error(program, std::strerror(errno), "check the installation");
      return kInternal;
    };
  });
}

}  // namespace palpate::cli
