/// A site that says of its scene whatever it is told to: palpate_stranger NAME@DOMAIN TEXT...
///
/// Each TEXT for 0.5 s, the last one until it is killed; it has no hand.
#include <chrono>
#include <cstdio>
#include <exception>
#include <thread>

#include "palpate/engine/hand_links.h"
#include "palpate/scenes/site/site.h"

int main(int argc, char** argv) {
  if (argc < 3) return 2;
  try {
    palpate::SiteParams params = palpate::siteFrom(argv[1], {});
    params.scene = true;
    palpate::HandLinks links(1);
    palpate::Site site(params, links);
    for (int i = 2; i < argc; ++i) {
      site.tellScene(argv[i]);
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
  } catch (const std::exception& error) {
    (void)std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
