#include "palpate/scenes/apps/import/mpi_group.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <string>
#include <thread>
#include <vector>

// With these macros, MPI's headers declare only the C interface.
#define OMPI_SKIP_MPICXX 1
#define MPICH_SKIP_MPICXX 1
#include <mpi.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

/// Message of each rank in a synchronization of all ranks.
struct Word {
  std::uint64_t bytes = 0;  ///< Number of bytes that the rank will send.
  std::uint64_t gives_up = 0;
};

class MpiGroup final : public ProcessGroup {
 public:
  MpiGroup() {
    int given = 0;
    check(MPI_Init_thread(nullptr, nullptr, MPI_THREAD_FUNNELED, &given));
    MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
    check(MPI_Comm_rank(MPI_COMM_WORLD, &rank_));
    check(MPI_Comm_size(MPI_COMM_WORLD, &size_));
  }
  MpiGroup(const MpiGroup&) = delete;
  MpiGroup& operator=(const MpiGroup&) = delete;
  ~MpiGroup() override {
    // MPI_Finalize waits for all ranks, and would block forever if a rank is lost.
    if (!lost_) MPI_Finalize();
  }

  [[nodiscard]] int rank() const noexcept override { return rank_; }
  [[nodiscard]] int size() const noexcept override { return size_; }

  [[nodiscard]] std::vector<Bytes> gather(std::span<const std::byte> own) override {
    const std::vector<Word> words = meet({own.size(), 0});
    for (const Word& word : words) {
      if (word.gives_up != 0) throw GroupEnded();
    }
    std::vector<Bytes> all(words.size());
    // From here on, every rank must send the bytes that it has announced. If this rank fails, the
    // others cannot continue with it.
    try {
      for (std::size_t r = 0; r < words.size(); ++r) {
        all[r].resize(words[r].bytes);
        if (static_cast<int>(r) == rank_) std::copy(own.begin(), own.end(), all[r].begin());
        share(all[r], static_cast<int>(r));
      }
    } catch (...) {
      lost_ = true;
      throw;
    }
    return all;
  }

  [[nodiscard]] bool giveUp() noexcept override {
    if (lost_) return true;
    try {
      const std::vector<Word> words = meet({0, 1});
      const auto first = std::find_if(words.begin(), words.end(),
                                      [](const Word& word) { return word.gives_up != 0; });
      return first - words.begin() == rank_;
    } catch (...) {
      lost_ = true;
      return true;
    }
  }

 private:
  /// Sends data from one rank to all ranks, in parts of at most 1 GiB: MPI counts bytes by an int.
  void share(Bytes& bytes, int from) {
    constexpr std::uint64_t kMost = 1U << 30U;
    // wait() completes the request.
    // NOLINTNEXTLINE(clang-analyzer-optin.mpi.MPI-Checker)
    for (std::uint64_t at = 0; at < bytes.size(); at += kMost) {
      MPI_Request request{};
      const auto part = static_cast<int>(std::min<std::uint64_t>(kMost, bytes.size() - at));
      check(MPI_Ibcast(bytes.data() + at, part, MPI_BYTE, from, MPI_COMM_WORLD, &request));
      wait(request);
    }
  }

  std::vector<Word> meet(const Word& own) {
    std::vector<Word> all(static_cast<std::size_t>(size_));
    MPI_Request request{};
    check(MPI_Iallgather(&own, sizeof(Word), MPI_BYTE, all.data(), sizeof(Word), MPI_BYTE,
                         MPI_COMM_WORLD, &request));
    wait(request);
    return all;  // NOLINT(clang-analyzer-optin.mpi.MPI-Checker): as above
  }

  /// Waits for a request, and sleeps between tests: MPI's own wait would occupy a core.
  void wait(MPI_Request& request) {
    using std::chrono::microseconds;
    constexpr microseconds kLongest(2000);
    microseconds pause(20);
    for (int done = 0;;) {
      check(MPI_Test(&request, &done, MPI_STATUS_IGNORE));
      if (done != 0) return;
      std::this_thread::sleep_for(pause);
      pause = std::min(2 * pause, kLongest);
    }
  }

  /// Throws Error with MPI's text. MPI has no portable code for a lost connection.
  void check(int status) {
    if (status == MPI_SUCCESS) return;
    lost_ = true;
    std::array<char, MPI_MAX_ERROR_STRING> text{};
    int size = 0;
    (void)MPI_Error_string(status, text.data(), &size);
    throw Error(
        "mpirun",
        "MPI reports an error (" + std::string(text.data(), static_cast<std::size_t>(size)) + ")",
        "if another process has ended, read its message, and check the network; then run "
        "the same command again");
  }

  int rank_ = 0;
  int size_ = 1;
  bool lost_ = false;
};

}  // namespace

bool canJoinGroup() {
  return true;
}

std::unique_ptr<ProcessGroup> joinGroup() {
  return std::make_unique<MpiGroup>();
}

}  // namespace palpate::importer
