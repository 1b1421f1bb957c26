/// palpate-plugin: the process that a plug-in runs in. Started by palpate, never by hand but to see
/// what a plug-in says: palpate-plugin list FILE.
#include <cstdio>
#include <fcntl.h>
#include <string>

#include "palpate/devices/plugin_server.h"

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  // Without a program at the other end there is nobody to serve.
  if (what == "serve" && argc == 4 && fcntl(palpate::kPluginZero, F_GETFD) >= 0) {
    return palpate::servePlugin(argv[2], argv[3]);
  }
  if (what == "list" && argc == 3) return palpate::listPlugin(argv[2]);
  std::fputs("palpate-plugin: palpate starts it: use --device plugin:NAME\n", stderr);
  return 2;
}
