
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
      say("  note      {} of these bricks were already written by an interrupted run\n",
          report.kept);
    } else if (report.written == 0) {
      say("  note      all bricks were already written\n");
    }
  } catch (const Interrupted&) {
    complain("interrupted: run the same command again to resume");
    return kInterrupted;
  }
  return kDone;
}

}  // namespace

void addBrick(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb = app.add_subcommand(
      "brick", "Writes a volume as bricks in several levels; needs memory for the whole grid");
  auto words = std::make_shared<BrickWords>();
  verb->add_option("FILE", words->file, "The .vdb to read")->required();
  verb->add_option("OUT", words->out, "The output folder; an interrupted export in it resumes")
      ->required();
  verb->add_option("--grid", words->grid, "Grid name; may be omitted if the file has only one");
  verb->add_flag("--half", words->half, "Store each value in 16 bits");
  verb->add_option("--compression", words->compression, "Compression level of zstd, 1 to 19")
      ->capture_default_str();
  verb->add_flag("--json", words->json, "Print JSON");
  verb->footer("Example:\n  palpate brick head.vdb head.bricks && palpate info head.bricks");
  verb->callback([=, &body] { body = [=] { return brick(*words); }; });
}

}  // namespace palpate::cli
