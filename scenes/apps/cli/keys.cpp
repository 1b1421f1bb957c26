#include "palpate/scenes/apps/cli/keys.h"

#include <chrono>
#include <cmath>
#include <poll.h>
#include <unistd.h>
#include <utility>

#include "palpate/scenes/apps/common/say.h"

namespace palpate::cli {
namespace {

/// Returns true if this process is in the foreground. A background process must not change or read
/// the terminal.
bool ours() {
  return tcgetpgrp(0) == getpgrp();
}

}  // namespace

Keys::Keys(const std::vector<HapticThread*>& hands, PlayClock& clock,
           std::vector<FrameTimes> played)
    : hands_(hands),
      clock_(clock),
      played_(std::move(played)),
      shown_(isatty(0) != 0 && tcgetattr(0, &usual_) == 0) {
  if (!shown_) return;
  sayAside("Esc: force off; Enter: force on; Ctrl-C: end\n");
  if (!played_.empty()) {
    sayAside(
        "space: pause or resume; , and .: previous or next frame; 0: first frame; - and +: half or "
        "double speed; r: repeat or play once\n");
  }
  thread_ = std::thread([this] { run(); });
}

Keys::~Keys() {
  quit_ = true;
  if (thread_.joinable()) thread_.join();
  if (raw_ && ours()) tcsetattr(0, TCSANOW, &usual_);
}

void Keys::play(std::vector<FrameTimes> played) {
  const std::lock_guard lock(mutex_);
  played_ = std::move(played);
}

void Keys::run() {
  constexpr int kLook = 10;  // [ms]: time between two checks of the keyboard
  while (!quit_) {
    if (ours()) {
      look();
      pollfd terminal{0, POLLIN, 0};
      (void)poll(&terminal, 1, kLook);
    } else {
      raw_ = false;
      std::this_thread::sleep_for(std::chrono::milliseconds(kLook));
    }
  }
}

void Keys::look() {
  // A shell resets the terminal's mode while this process is stopped, so look() checks the mode
  // each time.
  if (termios now{}; !raw_ || (tcgetattr(0, &now) == 0 && (now.c_lflag & ICANON) != 0)) {
    termios raw = usual_;
    raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
    raw.c_cc[VMIN] = 0;
    raw.c_cc[VTIME] = 0;
    raw_ = tcsetattr(0, TCSANOW, &raw) == 0;
  }
  constexpr char kEscape = 27;
  char key = 0;
  while (raw_ && read(0, &key, 1) == 1) {
    for (HapticThread* hand : hands_) {
      if (key == kEscape) hand->cut();
      if (key == '\n' || key == '\r') hand->clear();
    }
    steer(key);
  }
}

/// Moves play by one frame of the sequence with the shortest step (FrameTimes::stepFrom). At the
/// end of a play that repeats, continues at the other end.
void Keys::stepFrame(bool forward) {
  double shortest = 0.0;
  for (const FrameTimes& times : played_) {
    const double step = times.stepFrom(clock_.position(), forward);
    if (step == 0.0) continue;
    if (shortest == 0.0 || std::abs(step) < std::abs(shortest)) shortest = step;
  }
  if (shortest != 0.0) return clock_.nudge(shortest);
  if (const PlayParams now = clock_.params(); now.repeat) clock_.seek(forward ? now.from : now.to);
}

void Keys::steer(char key) {
  const std::lock_guard lock(mutex_);
  if (played_.empty()) return;
  const PlayParams now = clock_.params();
  constexpr double kFaster = 2.0;
  switch (key) {
    case ' ':
      return clock_.pause(!now.paused);
    case ',':
      return stepFrame(false);
    case '.':
      return stepFrame(true);
    case '0':
      return clock_.seek(now.begin);
    case '-':
      return clock_.setSpeed(now.speed / kFaster);
    case '+':
      return clock_.setSpeed(now.speed * kFaster);
    case 'r':
      return clock_.repeat(!now.repeat);
    default:
      return;
  }
}

}  // namespace palpate::cli
