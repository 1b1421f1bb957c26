/// palpate import: hands over to palpate-import, so that nothing else loads VTK.
#include <cerrno>
#include <cstring>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

void addImport(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("import", "Turns CT, MRI, CFD and the like into a .vdb, through VTK");
  verb->prefix_command();
  verb->set_help_flag();  // palpate-import has its own
  verb->callback([verb, &body] {
    body = [verb] {
      std::vector<std::string> words = verb->remaining();
      const std::string program = (programFolder() / "palpate-import").string();
      std::vector<char*> argv;
      std::string name = "palpate-import";
      argv.push_back(name.data());
      for (std::string& word : words) argv.push_back(word.data());
      argv.push_back(nullptr);
      execv(program.c_str(), argv.data());
      if (errno == ENOENT) {
        throw Error("import", "palpate-import is not there: it comes apart, for VTK is large",
                    "install the package palpate-import, or build with libvtk9-dev");
      }
      throw Error(program, std::strerror(errno), "check the installation");
      return kInternal;
    };
  });
}

}  // namespace palpate::cli
