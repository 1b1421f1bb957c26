#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <hdf5.h>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/module.h"
#include "palpate/scenes/apps/cli/as_hdf5.h"

namespace palpate::cli {
namespace {

/// Rows of one compressed block: 0.58 MB, which fits in a reader's default cache (1 MB).
constexpr hsize_t kBlock = 1024;

/// Returns why a call failed: HDF5's innermost message, or the system's message in it.
std::string reasonOf() {
  std::string reason;
  const auto keep = [](unsigned depth, const H5E_error2_t* error, void* kept) -> herr_t {
    if (depth == 0 && error->desc != nullptr) *static_cast<std::string*>(kept) = error->desc;
    return 0;
  };
  H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, keep, &reason);
  constexpr std::string_view kMark = "error message = '";
  const std::size_t begin = reason.find(kMark);
  if (begin == std::string::npos) return reason;
  const std::string said = reason.substr(begin + kMark.size());
  return said.substr(0, said.find('\''));
}

/// Closes an HDF5 handle at the end of its scope.
class Id {
 public:
  using Close = herr_t (*)(hid_t);
  Id(hid_t id, Close by) : id_(id), close_(by) {}
  Id(Id&& other) noexcept : id_(std::exchange(other.id_, -1)), close_(other.close_) {}
  Id(const Id&) = delete;
  Id& operator=(const Id&) = delete;
  Id& operator=(Id&&) = delete;
  ~Id() {
    if (id_ >= 0) close_(id_);
  }
  operator hid_t() const noexcept { return id_; }
  /// Closes the handle before the end of its scope, to get errors of delayed writes.
  herr_t close() { return close_(std::exchange(id_, -1)); }

 private:
  hid_t id_;
  Close close_;
};

class Hdf5File {
 public:
  /// `place` is the path to write; messages name the file `name`.
  Hdf5File(const std::string& place, std::string name) : name_(std::move(name)) {
    // palpate reports errors itself. HDF5 must not retry failed writes at exit.
    H5dont_atexit();
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
    const Id access = id(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
    // No other program uses the new file, and some file systems have no locks.
    check(H5Pset_file_locking(access, 0, 1));
    file_.emplace(id(H5Fcreate(place.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, access), H5Fclose));
  }

  void attribute(const char* name, double value) {
    const Id space = id(H5Screate(H5S_SCALAR), H5Sclose);
    const Id made =
        id(H5Acreate2(*file_, name, H5T_IEEE_F64LE, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
    check(H5Awrite(made, H5T_NATIVE_DOUBLE, &value));
  }

  void attribute(const char* name, const std::string& value) {
    const Id space = id(H5Screate(H5S_SCALAR), H5Sclose);
    const Id type = text();
    const Id made = id(H5Acreate2(*file_, name, type, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
    const char* const given = value.c_str();
    check(H5Awrite(made, type, &given));
  }

  void scenes(const std::vector<RecordedScene>& scenes) {
    struct Row {
      std::uint64_t id;
      const char* text;
    };
    std::vector<Row> rows;
    rows.reserve(scenes.size());
    for (const RecordedScene& scene : scenes) rows.push_back({scene.id, scene.text.c_str()});
    const Id word = text();
    const auto compound = [&](std::size_t size, hid_t number, std::size_t behind) {
      Id type = id(H5Tcreate(H5T_COMPOUND, size), H5Tclose);
      check(H5Tinsert(type, "id", 0, number));
      check(H5Tinsert(type, "text", behind, word));
      return type;
    };
    const Id in_memory = compound(sizeof(Row), H5T_NATIVE_UINT64, offsetof(Row, text));
    const Id in_file = compound(8 + H5Tget_size(word), H5T_STD_U64LE, 8);
    const hsize_t count = rows.size();
    const Id space = id(H5Screate_simple(1, &count, nullptr), H5Sclose);
    Id made = dataset("scenes", in_file, space, quiet());
    if (count > 0) check(H5Dwrite(made, in_memory, H5S_ALL, H5S_ALL, H5P_DEFAULT, rows.data()));
    check(made.close());
  }

  void ticks(const Recording& recording, const std::function<void(double)>& progress) {
    const Id in_memory = tickType(false);
    const Id in_file = tickType(true);
    const auto count = static_cast<hsize_t>(recording.size());
    const hsize_t endless = H5S_UNLIMITED;  // a block may be longer than all rows
    const Id space = id(H5Screate_simple(1, &count, &endless), H5Sclose);
    const Id layout = quiet();
    check(H5Pset_chunk(layout, 1, &kBlock));
    check(H5Pset_shuffle(layout));
    check(H5Pset_deflate(layout, 1));
    Id made = dataset("ticks", in_file, space, layout);
    std::vector<RecordedTick> rows;
    for (hsize_t first = 0; first < count; first += kBlock) {
      progress(static_cast<double>(first) / static_cast<double>(count));
      const hsize_t some = std::min(kBlock, count - first);
      rows.clear();
      for (hsize_t i = 0; i < some; ++i) {
        rows.push_back(recording.tick(static_cast<std::int64_t>(first + i)));
      }
      const Id of_block = id(H5Screate_simple(1, &some, nullptr), H5Sclose);
      check(H5Sselect_hyperslab(space, H5S_SELECT_SET, &first, nullptr, &some, nullptr));
      check(H5Dwrite(made, in_memory, of_block, space, H5P_DEFAULT, rows.data()));
    }
    check(made.close());
  }

  void close() { check(file_->close()); }

 private:
  void check(herr_t status) const {
    if (status >= 0) return;
    throw Error(name_, "writing failed (" + reasonOf() + ")",
                "make room on the disk, raise the limit of file sizes (ulimit -f), or choose "
                "another disk");
  }
  [[nodiscard]] Id id(hid_t made, Id::Close by) const {
    check(made < 0 ? -1 : 0);
    return {made, by};
  }
  [[nodiscard]] Id text() const {
    Id type = id(H5Tcopy(H5T_C_S1), H5Tclose);
    check(H5Tset_size(type, H5T_VARIABLE));
    check(H5Tset_cset(type, H5T_CSET_UTF8));
    return type;
  }
  /// Returns dataset properties without a creation time, so that equal recordings give equal bytes.
  [[nodiscard]] Id quiet() const {
    Id layout = id(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
    check(H5Pset_obj_track_times(layout, 0));
    return layout;
  }
  [[nodiscard]] Id dataset(const char* name, hid_t type, hid_t space, hid_t layout) const {
    return id(H5Dcreate2(*file_, name, type, space, H5P_DEFAULT, layout, H5P_DEFAULT), H5Dclose);
  }

  /// Returns the type of a row: as in memory, or little-endian without gaps if `in_file`.
  [[nodiscard]] Id tickType(bool in_file) const {
    struct Word {
      std::string_view name;
      hid_t in_memory;
      hid_t in_file;
      std::size_t size;
    };
    const std::array words{Word{"<f8", H5T_NATIVE_DOUBLE, H5T_IEEE_F64LE, 8},
                           Word{"<i8", H5T_NATIVE_INT64, H5T_STD_I64LE, 8},
                           Word{"<u8", H5T_NATIVE_UINT64, H5T_STD_U64LE, 8},
                           Word{"<i4", H5T_NATIVE_INT32, H5T_STD_I32LE, 4},
                           Word{"<u4", H5T_NATIVE_UINT32, H5T_STD_U32LE, 4},
                           Word{"u1", H5T_NATIVE_UINT8, H5T_STD_U8LE, 1}};
    const auto word_of = [&](const RecordedField& field) {
      const auto* const found = std::find_if(
          words.begin(), words.end(), [&](const Word& word) { return word.name == field.type; });
      if (found == words.end())
        throw Error(field.name, "palpate cannot write its type to HDF5", "report this message");
      return *found;
    };
    std::vector<RecordedField> fields;
    std::size_t size = 0;
    for (RecordedField field : recordedFields()) {
      if (std::string_view(field.name) == "zero") continue;
      if (in_file) field.offset = size;
      size += field.count * word_of(field).size;
      fields.push_back(field);
    }
    Id type = id(H5Tcreate(H5T_COMPOUND, in_file ? size : sizeof(RecordedTick)), H5Tclose);
    for (const RecordedField& field : fields) {
      const hid_t one = in_file ? word_of(field).in_file : word_of(field).in_memory;
      const hsize_t count = field.count;
      if (count == 1) {
        check(H5Tinsert(type, field.name, field.offset, one));
        continue;
      }
      const Id several = id(H5Tarray_create2(one, 1, &count), H5Tclose);
      check(H5Tinsert(type, field.name, field.offset, several));
    }
    return type;
  }

  std::string name_;
  std::optional<Id> file_;
};

void writeFile(const Recording& recording, const std::string& place, const std::string& name,
               const std::function<void(double)>& progress) {
  const auto head = nlohmann::ordered_json::parse(recordingHeader(recording.setting()));
  Hdf5File file(place, name);
  file.attribute("rate", recording.setting().rate);
  for (const char* part : {"units", "device", "about"}) {
    file.attribute(part, head.at(part).dump());
  }
  file.scenes(recording.scenes());
  file.ticks(recording, progress);
  file.close();
}

}  // namespace
}  // namespace palpate::cli

// NOLINTNEXTLINE(readability-identifier-naming): the name of the symbol in module.map.
extern "C" const palpate::ModuleEntry<palpate::cli::Hdf5Writer> palpate_module{
    &palpate::cli::writeFile};
