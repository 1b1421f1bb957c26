#include <array>
#include <cctype>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include <fmt/format.h>

#include "palpate/devices/recording/recording.h"
#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/as_hdf5.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {
namespace {

struct ConvertOptions {
  std::string in;
  std::string out;
};

/// Returns the column name of element `i` of a field, such as "force_x" or "drives_0".
std::string columnOf(const RecordedField& field, std::size_t i) {
  if (field.count == 1) return field.name;
  constexpr std::array kAxes{"x", "y", "z"};
  return field.count == 3 ? fmt::format("{}_{}", field.name, kAxes[i])
                          : fmt::format("{}_{}", field.name, i);
}

template <class T>
T at(const RecordedTick& tick, std::size_t offset) {
  T value;
  std::memcpy(&value, reinterpret_cast<const char*>(&tick) + offset, sizeof(T));
  return value;
}

std::string valueOf(const RecordedTick& tick, const RecordedField& field, std::size_t i) {
  const std::string_view type = field.type;
  if (type == "<f8") return number(at<double>(tick, field.offset + 8 * i));
  if (type == "<i8") return std::to_string(at<std::int64_t>(tick, field.offset + 8 * i));
  if (type == "<u8") return std::to_string(at<std::uint64_t>(tick, field.offset + 8 * i));
  if (type == "<i4") return std::to_string(at<std::int32_t>(tick, field.offset + 4 * i));
  if (type == "<u4") return std::to_string(at<std::uint32_t>(tick, field.offset + 4 * i));
  return std::to_string(at<std::uint8_t>(tick, field.offset + i));
}

void writeCsv(const Recording& recording, const std::string& path) {
  WholeFile out(path);
  const auto line = [&](const auto& cell) {
    std::string text;
    for (const RecordedField& field : recordedFields()) {
      if (std::string_view(field.name) == "zero") continue;
      for (std::size_t i = 0; i < field.count; ++i) {
        if (!text.empty()) text += ',';
        text += cell(field, i);
      }
    }
    out.write(text + "\n");
  };
  line(columnOf);
  const auto progress = showProgress("converting");
  for (std::int64_t i = 0; i < recording.size(); ++i) {
    endIfInterrupted();
    const RecordedTick tick = recording.tick(i);
    line([&](const RecordedField& field, std::size_t j) { return valueOf(tick, field, j); });
    if (progress) progress(static_cast<double>(i) / static_cast<double>(recording.size()));
  }
  out.commit();
}

bool isHdf5(const std::string& path) {
  std::string ending = std::filesystem::path(path).extension().string();
  for (char& c : ending) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return ending == ".h5" || ending == ".hdf5";
}

int convert(const ConvertOptions& options) {
  checkOutputsApart({options.out}, {options.in});
  if (isHdf5(options.out)) checkHdf5(options.out);
  const Recording recording(options.in);
  if (const std::string words = recording.incomplete(); !words.empty()) {
    complain(options.in + ": " + words);
  }
  if (isHdf5(options.out)) {
    writeHdf5(recording, options.out);
  } else {
    writeCsv(recording, options.out);
  }
  return kDone;
}

}  // namespace

void addConvert(CLI::App& app, std::function<int()>& body) {
  CLI::App* verb =
      app.add_subcommand("convert", "Writes a recording as CSV or HDF5, one row a tick");
  auto options = std::make_shared<ConvertOptions>();
  verb->add_option("IN", options->in, "A recording (made by `palpate feel --record`)")->required();
  verb->add_option("OUT", options->out, "A .csv or .h5 file; - writes CSV to standard output")
      ->required();
  verb->footer("Example:\n  palpate convert hand.rec hand.h5");
  verb->callback([=, &body] { body = [=] { return convert(*options); }; });
}

}  // namespace palpate::cli
