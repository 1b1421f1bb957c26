/// A site that publishes texts as its scene: palpate_stranger NAME@DOMAIN TEXT... Publishes each
/// TEXT for 0.5 s, the last one until it is killed. Has no hand.
#include <chrono>
#include <cstdio>
#include <exception>
#include <thread>

#include "palpate/engine/loop/hand_links.h"
#include "palpate/scenes/network/sites/site.h"

int main(int argc, char** argv) {
  if (argc < 3) return 2;
  try {
    palpate::SiteParams params = palpate::siteFrom(argv[1], {});
    params.scene = true;
    palpate::HandLinks links(1);
    const auto site = palpate::openSite(params, links);
    for (int i = 2; i < argc; ++i) {
      site->tellScene(argv[i]);
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
  } catch (const std::exception& error) {
    (void)std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
