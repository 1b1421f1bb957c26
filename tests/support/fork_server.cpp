/// A library to preload. It stops a program before its main(), and forks it for each request.
/// A short run spends most of its time on loading libraries. A fork has them loaded, but has
/// separate memory, files and exit status. A request contains arguments, environment, folder and
/// standard streams (tests/support/process.py). PALPATE_FORK_SERVER is the descriptor of the
/// socket. Without this variable, the program runs normally.
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>
#include <iostream>
#include <string>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include "palpate/samplers/fork_at_rest.h"

namespace {

using Main = int (*)(int, char**, char**);
Main program_main = nullptr;

/// Header of a request. The strings follow it.
struct Header {
  std::uint32_t bytes;  ///< Length of all strings, with their terminating zeros.
  /// Number of arguments. The folder is before them, the environment after them.
  std::uint32_t arguments;
};

[[noreturn]] void fail() {
  _exit(125);
}

/// Reads exactly `count` bytes. Returns false at the end of the requests or after an error.
bool readAll(int socket, void* to, std::size_t count) {
  auto* at = static_cast<char*>(to);
  while (count > 0) {
    const ssize_t got = read(socket, at, count);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return false;
    at += got;
    count -= static_cast<std::size_t>(got);
  }
  return true;
}

/// Reads a header, and the descriptors of stdin, stdout and stderr.
bool readHeader(int socket, Header& header, std::array<int, 3>& streams) {
  iovec part{&header, sizeof header};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * 3)> control{};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t got = recvmsg(socket, &message, MSG_WAITALL);
  if (got != sizeof header) return false;
  const cmsghdr* rights = CMSG_FIRSTHDR(&message);
  if (rights == nullptr || rights->cmsg_len != CMSG_LEN(sizeof(int) * 3)) fail();
  std::memcpy(streams.data(), CMSG_DATA(rights), sizeof(int) * 3);
  return true;
}

/// Ends a fork after the exit handlers that its main() registered. Handlers of libraries would wait
/// for threads that a fork does not have, such as those of log4cplus (used by OpenVDB). So forks
/// are not checked for leaks.
void endBeforeLibraries(int status, void*) {
  std::cout.flush();
  std::fflush(nullptr);
  _exit(status);
}

void sendNumber(int socket, std::int32_t number) {
  if (write(socket, &number, sizeof number) != sizeof number) fail();
}

int serve(int, char**, char**) {
  const int socket = std::atoi(std::getenv("PALPATE_FORK_SERVER"));
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  for (;;) {
    Header header{};
    std::array<int, 3> streams{};
    if (!readHeader(socket, header, streams)) _exit(0);
    std::string text(header.bytes, '\0');
    if (!readAll(socket, text.data(), text.size())) fail();

    const pid_t child = palpate::forkAtRest();
    if (child < 0) fail();
    if (child == 0) {
      close(socket);
      for (int stream = 0; stream < 3; ++stream) {
        if (dup2(streams[stream], stream) < 0) fail();
      }
      for (const int stream : streams) {
        if (stream > 2) close(stream);
      }
      std::vector<char*> strings;
      for (std::size_t at = 0; at < text.size(); at += std::strlen(text.data() + at) + 1) {
        strings.push_back(text.data() + at);
      }
      if (chdir(strings[0]) != 0) fail();
      std::vector<char*> arguments(strings.begin() + 1, strings.begin() + 1 + header.arguments);
      clearenv();
      for (std::size_t i = 1 + header.arguments; i < strings.size(); ++i) putenv(strings[i]);
      arguments.push_back(nullptr);
      on_exit(endBeforeLibraries, nullptr);
      std::exit(program_main(static_cast<int>(header.arguments), arguments.data(), environ));
    }
    for (const int stream : streams) close(stream);
    sendNumber(socket, child);
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    sendNumber(socket, status);
  }
}

}  // namespace

/// Replaces glibc's function. If PALPATE_FORK_SERVER is set, serve() runs instead of main().
extern "C" __attribute__((visibility("default"))) int __libc_start_main(Main real_main, int argc,
                                                                        char** argv, void (*init)(),
                                                                        void (*fini)(),
                                                                        void (*loader_fini)(),
                                                                        void* stack_end) {
  using Start = int (*)(Main, int, char**, void (*)(), void (*)(), void (*)(), void*);
  const auto start = reinterpret_cast<Start>(dlsym(RTLD_NEXT, "__libc_start_main"));
  program_main = real_main;
  return start(std::getenv("PALPATE_FORK_SERVER") == nullptr ? real_main : serve, argc, argv, init,
               fini, loader_fini, stack_end);
}
