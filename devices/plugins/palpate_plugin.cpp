/// palpate-plugin: the program in whose process a plug-in runs. palpate starts this program: with
/// `serve` to drive an arm, with `list` to list a plug-in's arms.
#include <cstdio>
#include <fcntl.h>
#include <string>

#include "palpate/devices/plugins/plugin_server.h"

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  // Serves an arm only if palpate has started this process.
  if (what == "serve" && argc == 4 && fcntl(palpate::kPluginZero, F_GETFD) >= 0) {
    return palpate::servePlugin(argv[2], argv[3]);
  }
  if (what == "list" && argc == 3) return palpate::listPlugin(argv[2]);
  std::fputs("palpate-plugin: only palpate starts this program: use --device plugin:NAME\n",
             stderr);
  return 2;
}
