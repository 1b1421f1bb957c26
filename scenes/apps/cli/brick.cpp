/// palpate brick: writes a volume as bricks, also if it is larger than memory.
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/scenes/apps/cli/bricks_told.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

struct BrickWords {
  std::string file;
  std::string out;
  std::string grid;
  bool half = false;
  int compression = BrickOptions{}.compression;
  bool json = false;
};

int brick(const BrickWords& words) {
  noteInterrupts();
  const auto stop = [](const std::function<void(double)>& told) {
    return [told](double done) {
      endIfInterrupted();
      if (told) told(done);
    };
  };
  const auto write = [&] {
    LoadOptions load;
    load.progress = stop(showProgress("loading"));
    const BrickInput input = brickInput(loadVolume(words.file, words.grid, load), words.half);
    load.progress = nullptr;
    return writeBricks(words.out, input, {words.compression, stop(showProgress("writing"))});
  };
  try {
    const BrickReport report = write();
    if (words.json) {
      OrderedJson json;
      json["file"] = words.out;
      json["written"] = report.written;
      json["kept"] = report.kept;
      json.update(bricksJson(report.manifest));
      sayJson(json);
      return kDone;
    }
    say("{}: {}\n", words.out, report.manifest.info().name);
    sayBricks(report.manifest);
    if (report.kept > 0) {
      say("  note      {} of them were there already, from a run that did not end\n", report.kept);
    } else if (report.written == 0) {
      say("  note      all of it was there already\n");
    }
  } catch (const Interrupted&) {
    complain("interrupted: the same command goes on from here");
    return kInterrupted;
  }
  return kDone;
}

}  // namespace

void addBrick(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "brick", "Writes a volume as bricks, in levels, for those larger than memory");
  auto words = std::make_shared<BrickWords>();
  verb->add_option("FILE", words->file, "The .vdb to read")->required();
  verb->add_option("OUT", words->out, "The folder to make, or to go on with")->required();
  verb->add_option("--grid", words->grid, "Which grid; not needed where there is one");
  verb->add_flag("--half", words->half, "Store 16 bits a value");
  verb->add_option("--compression", words->compression, "zstd's level, 1 to 19")
      ->capture_default_str();
  verb->add_flag("--json", words->json, "Print JSON");
  verb->footer("Example:\n  palpate brick head.vdb head.bricks && palpate info head.bricks");
  verb->callback([=, &body] { body = [=] { return brick(*words); }; });
}

}  // namespace palpate::cli
