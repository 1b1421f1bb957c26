/// Measures the cost of a plug-in in a separate process, compared with one in this process: added
/// time in a tick, age of a position when it is read, and delay of a force.
///
///     palpate_bench_plugin [--rate HZ] [--seconds S]
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/machine.h"
#include "palpate/devices/plugins/plugin_process.h"
#include "palpate/engine/loop/realtime.h"
#include "tests/devices/plugins/odd_arm.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;

struct Options {
  double rate = 1000.0;
  double seconds = 10.0;
};

double us(std::int64_t ns) {
  return 1e-3 * static_cast<double>(ns);
}

void say(const char* where, const char* what, std::vector<double> all) {
  std::printf("%-8s %-28s %8.2f %8.2f %8.2f\n", where, what, bench::percentile(all, 0.5),
              bench::percentile(all, 0.99), bench::percentile(all, 1.0));
}

void run(const char* where, std::unique_ptr<PluginPort> port, const test::OddArm& odd,
         const Options& options) {
  PluginArm arm(std::move(port), "plugin:odd", true);
  const StayAwake awake(true);
  (void)becomeRealtime({}, awake);
  const auto count = static_cast<std::size_t>(options.rate * options.seconds);
  const double period = 1e9 / options.rate;
  std::vector<double> reads, writes, both, ages, late;
  for (auto* all : {&reads, &writes, &both, &ages, &late}) all->reserve(count);
  const std::int64_t begin = nowNs();
  std::int64_t wrote_at = 0;
  for (std::size_t i = 0; i < count; ++i) {
    sleepUntil(begin + static_cast<std::int64_t>(period * static_cast<double>(i)));
    // At this point the plug-in has received the previous force.
    if (wrote_at != 0) late.push_back(us(odd.wrote_at - wrote_at));
    const std::int64_t before = nowNs();
    const HandState hand = arm.read();
    const std::int64_t between = nowNs();
    wrote_at = between;
    arm.write(Vec3(1e-3 * static_cast<double>(i % 100), 0.0, 0.0));
    const std::int64_t after = nowNs();
    reads.push_back(us(between - before));
    writes.push_back(us(after - between));
    both.push_back(us(after - before));
    ages.push_back(1e6 * hand.age);
  }
  say(where, "read [us]", reads);
  say(where, "write [us]", writes);
  say(where, "both, in a tick [us]", both);
  say(where, "a position's age [us]", ages);
  say(where, "a force until it is given [us]", late);
}

int go(const Options& options) {
  std::printf("%s\n", bench::describe(bench::takeMachine(false)).c_str());
  std::string file = std::filesystem::temp_directory_path() / "palpate_odd_XXXXXX";
  const int made = mkstemp(file.data());
  if (made < 0) return 1;
  setenv(test::OddArm::kFile, file.c_str(), 1);
  const test::OddArm* odd = test::OddArm::at(file.c_str());
  std::printf("%-8s %-28s %8s %8s %8s\n", "plug-in", "", "p50", "p99", "max");
  run("inside", openPluginInside(PALPATE_ODD_PLUGIN, "inside", {}), *odd, options);
  run("process", openPluginProcess(PALPATE_ODD_PLUGIN, "good", {}, PALPATE_PLUGIN_PROGRAM), *odd,
      options);
  std::filesystem::remove(file);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("What a plug-in in a process of its own costs a tick");
  app.add_option("--rate", options.rate, "Ticks a second [Hz]")->check(CLI::Range(10.0, 20000.0));
  app.add_option("--seconds", options.seconds, "How long each [s]")->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  try {
    return go(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "palpate_bench_plugin: %s\n", error.what());
    return 1;
  }
}
