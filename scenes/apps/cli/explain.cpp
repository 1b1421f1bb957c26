/// palpate explain: runs one tick, and prints the causes of its force.
#include "palpate/scenes/apps/cli/explain_words.h"
#include "palpate/scenes/apps/common/explain_tick.h"

namespace palpate::cli {
namespace {

struct ExplainOptions {
  std::string scene;
  std::string at;
  std::string push;
  double rate = 1000.0;
  bool json = false;
};

int explain(const ExplainOptions& options) {
  checkRate("--rate", options.rate);
  const Vec3 at = readVector("--at", options.at);
  const Vec3 push = readVector("--push", options.push);
  checkReach("--push", at + push);
  const Explained told = explainTick(openScene(options.scene, showProgress("loading")), at, push,
                                     options.rate, showProgress("loading"), complainOf);
  if (options.json) {
    sayJson(told.json);
  } else {
    printTick(told.json);
  }
  if (!told.fault) return kDone;
  complain("explain: the force was cut: a sample was not finite: mend the volume");
  return kEndedEarly;
}

}  // namespace

void addExplain(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("explain", "Runs one tick and says why its force is what it is");
  auto options = std::make_shared<ExplainOptions>();
  verb->add_option("SCENE", options->scene, "A scene file, a .vdb, or a folder of .vdb or bricks")
      ->required();
  verb->add_option("--at", options->at, "x,y,z: where the proxy is; the hand rests there first [m]")
      ->required();
  verb->add_option("--push", options->push,
                   "x,y,z: how far the hand then moves, within one tick [m]; the spring makes the "
                   "force")
      ->required();
  verb->add_option("--rate", options->rate,
                   "Ticks a second (default 1000): the damper and the limiter go by it");
  verb->add_flag("--json", options->json, "Print JSON");
  verb->footer("Example:\n  palpate explain head.json --at 0,0,0.05 --push 0,0.001,-0.002");
  verb->callback([=, &body] { body = [=] { return explain(*options); }; });
}

}  // namespace palpate::cli
