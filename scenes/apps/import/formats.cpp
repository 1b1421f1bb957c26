/// Selects the reader of an input: of a folder by its files, and of a file by its first bytes or
/// its name.
#include <algorithm>
#include <array>
#include <cctype>
#include <cstdint>
#include <string_view>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/dicom_bytes.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/slice_names.h"
#include "palpate/scenes/apps/import/unpacked.h"

namespace palpate::importer {
namespace {

std::string beginningOf(const std::filesystem::path& file) {
  constexpr std::size_t kBytes = 4096;
  std::string text(kBytes, '\0');
  Unpacked in(file, file);
  text.resize(in.readSome(text.data(), kBytes));
  return text;
}

bool has(const std::string& text, std::size_t at, std::string_view what) {
  return text.size() >= at + what.size() && text.compare(at, what.size(), what) == 0;
}

bool hasKey(const std::string& text, std::string_view key) {
  for (auto at = text.find(key); at != std::string::npos; at = text.find(key, at + 1)) {
    if (at > 0 && text[at - 1] != '\n') continue;
    const auto next = text.find_first_not_of(" \t", at + key.size());
    if (next != std::string::npos && text[next] == '=') return true;
  }
  return false;
}

/// Returns name.hdr, else name.hdr.gz, for name.img and name.img.gz, if it exists; otherwise
/// `file`.
std::filesystem::path headerOf(const std::filesystem::path& file) {
  std::filesystem::path plain = file;
  if (plain.extension() == ".gz") plain.replace_extension();
  if (plain.extension() != ".img") return file;
  plain.replace_extension(".hdr");
  std::filesystem::path packed = plain;
  packed += ".gz";
  std::error_code error;
  if (std::filesystem::exists(plain, error)) return plain;
  return std::filesystem::exists(packed, error) ? packed : file;
}

constexpr const char* kRawValues = "raw values";

struct Format {
  const char* name;
  bool (*begins)(const std::string& bytes);
  /// Opens the file; null: the importer recognizes this format but cannot import it.
  std::unique_ptr<Reader> (*open)(const Request& request);
  const char* remedy = nullptr;
  const char* option = "";
};

std::string remedyForUnused(const Request& request, const std::string& format,
                            std::string_view option) {
  if (option == "--as" && request.as == "displacement") {
    return "let the registration write the field as NIfTI, MetaImage or NRRD";
  }
  if (format == kRawValues && option == "--as" && request.as == "vector") {
    return R"(omit this option, and give "components": 3 in --raw)";
  }
  if (format == kRawValues && option == "--spacing") {
    return R"(omit this option, and give "spacing" in --raw)";
  }
  return "omit this option";
}

void refuseUnused(const Request& request, const std::string& format, std::string_view used) {
  const auto refuse = [&](const char* name, bool given) {
    if (!given || used == name) return;
    throw Error(name,
                fmt::format("{} is read as {}, which does not use this option",
                            request.file.string(), format),
                remedyForUnused(request, format, name));
  };
  refuse("--series", !request.series.empty());
  refuse("--as", !request.as.empty());
  refuse("--solution", !request.solution.empty());
  refuse("--level", request.level.has_value());
  refuse("--spacing", request.spacing.has_value());
}

bool isNetcdf(const std::string& b) {
  return has(b, 0, "CDF\1") || has(b, 0, "CDF\2") || has(b, 0, "CDF\5") || has(b, 0, "\x89HDF");
}
bool isNifti(const std::string& b) {
  using namespace std::string_view_literals;
  return has(b, 344, "n+1\0"sv) || has(b, 344, "ni1\0"sv) || has(b, 4, "n+2\0"sv) ||
         has(b, 4, "ni2\0"sv);
}
bool isDicom(const std::string& b) {
  return beginsAsDicom(b);
}
/// Recognizes MINC 2, an HDF5 file. MINC 1 is a netCDF file (openNetcdf).
bool isMinc2(const std::string& b) {
  return has(b, 0, "\x89HDF") && b.find("minc-2.0") != std::string::npos;
}
/// Recognizes MGH, FreeSurfer's format: version, four sizes and type as big-endian integers.
bool isMgh(const std::string& b) {
  if (b.size() < 284 || !has(b, 0, {"\0\0\0\1", 4})) return false;
  const auto number = [&](std::size_t at) {
    std::uint32_t value = 0;
    for (std::size_t i = 4 * at; i < 4 * at + 4; ++i) {
      value = value << 8U | static_cast<unsigned char>(b[i]);
    }
    return value;
  };
  for (std::size_t axis = 1; axis <= 4; ++axis) {
    if (number(axis) == 0 || number(axis) > 100000) return false;
  }
  return number(5) <= 10;
}
bool isNrrd(const std::string& b) {
  return has(b, 0, "NRRD000") || has(b, 0, "NRRD00.01");
}
bool isMetaImage(const std::string& b) {
  return hasKey(b, "ObjectType") || hasKey(b, "NDims");
}
bool isVtkLegacy(const std::string& b) {
  return has(b, 0, "# vtk DataFile");
}
bool isVtkXml(const std::string& b) {
  return b.find("<VTKFile") != std::string::npos;
}
/// Recognizes ParaView's list of VTK files (JSON).
bool isVtkSeries(const std::string& b) {
  return b.find("\"file-series-version\"") != std::string::npos;
}
bool isPng(const std::string& b) {
  return pictureKind(b) == PictureKind::kPng;
}
bool isTiff(const std::string& b) {
  return pictureKind(b) == PictureKind::kTiff;
}
bool isJpeg(const std::string& b) {
  return pictureKind(b) == PictureKind::kJpeg;
}
/// Recognizes the file `info` of a neuroglancer precomputed volume. Old volumes have no "@type".
bool isNeuroglancer(const std::string& b) {
  return b.find("\"neuroglancer_multiscale_volume\"") != std::string::npos ||
         (b.find("\"num_channels\"") != std::string::npos &&
          b.find("\"scales\"") != std::string::npos);
}

constexpr const char* kExportNeuroglancer =
    "convert it to OME-Zarr 0.4, NRRD or NIfTI, for example with CloudVolume and SimpleITK in "
    "Python";

constexpr const char* kConvertJpeg =
    "convert all slices of the volume to PNG, for example with ImageMagick, and give their folder";

const std::array kFormats = {
    Format{"NIfTI", isNifti, openNifti, nullptr, "--as"},
    Format{"DICOM", isDicom, openDicom, nullptr, "--series"},
    Format{"NRRD", isNrrd, openNrrd, nullptr, "--as"},
    Format{"MetaImage", isMetaImage, openMetaImage, nullptr, "--as"},
    Format{"MINC 2", isMinc2, nullptr, "convert it to NIfTI, for example with mnc2nii"},
    Format{"VTK (legacy)", isVtkLegacy, openVtkLegacy},
    Format{"VTK (XML)", isVtkXml, openVtkXml},
    Format{"a ParaView series", isVtkSeries, openVtkSeries},
    Format{"netCDF or HDF5", isNetcdf, openNetcdf},
    Format{"CGNS", [](const std::string& b) { return b.find("ADF Database Version") < 32; },
           openCgns},
    Format{"TIFF", isTiff, openSlices, nullptr, "--spacing"},
    // The importer recognizes these formats but cannot import them.
    Format{"OpenVDB", [](const std::string& b) { return has(b, 0, " BDV"); }, nullptr,
           "open it with palpate feel, without an import"},
    Format{"MRC (an electron density)", [](const std::string& b) { return has(b, 208, "MAP"); },
           nullptr,
           R"(describe the layout of its values with --raw and "skip": -1, see docs/import.md)"},
    Format{"NumPy (.npy)", [](const std::string& b) { return has(b, 0, "\x93NUMPY"); }, nullptr,
           R"(describe the layout of its values with --raw and "skip": -1, see docs/import.md)"},
    Format{"MGH (FreeSurfer, .mgh or .mgz)", isMgh, nullptr,
           "convert it to NIfTI, for example with mri_convert"},
    Format{"XDMF", [](const std::string& b) { return b.find("<Xdmf") != std::string::npos; },
           nullptr, "save the data as VTK XML, for example with ParaView"},
    Format{"OpenDX",
           [](const std::string& b) { return b.find("class gridpositions") != std::string::npos; },
           nullptr,
           "if its values are binary, describe their layout with --raw, see docs/import.md; "
           "otherwise convert it to VTK or NRRD"},
    Format{"Analyze 7.5 (a header without NIfTI's magic number)",
           [](const std::string& b) {
             return has(b, 0, {"\x5c\x01\0\0", 4}) && b.size() >= 348;
           },
           nullptr, "convert it to NIfTI, for example with nifti_tool"},
    Format{"an STL or PLY surface",
           [](const std::string& b) {
             return has(b, 0, "solid ") || has(b, 0, "ply\n") || has(b, 0, "ply\r");
           },
           nullptr, "convert the surface to a level set, for example with OpenVDB's tools"},
    Format{"SLC (a volume of VolVis)", [](const std::string& b) { return has(b, 0, "11111\n"); },
           nullptr, "convert it to NRRD or VTK, for example with ParaView"},
    Format{"the description of a neuroglancer precomputed volume", isNeuroglancer, nullptr,
           kExportNeuroglancer},
    Format{"a PNG picture", isPng, nullptr, "give the folder of all slices of the volume"},
    Format{"a JPEG picture", isJpeg, nullptr, kConvertJpeg},
    Format{"a zip archive", [](const std::string& b) { return has(b, 0, "PK\3\4"); }, nullptr,
           "unpack it"},
    Format{"a tar archive", [](const std::string& b) { return has(b, 257, "ustar"); }, nullptr,
           "unpack it"},
    Format{"a PDF", [](const std::string& b) { return has(b, 0, "%PDF"); }, nullptr,
           "give a file of volume data"},
};

/// Recognizes GRIB also by its name, because the heading of a bulletin may precede the bytes
/// "GRIB".
bool isGrib(const std::filesystem::path& file, const std::string& bytes) {
  std::string end = file.extension().string();
  for (char& c : end) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  constexpr std::array<std::string_view, 4> kNames{".grib", ".grib2", ".grb", ".grb2"};
  return has(bytes, 0, "GRIB") || std::find(kNames.begin(), kNames.end(), end) != kNames.end();
}

/// Returns true for the name of a PLOT3D grid, or with --solution. A PLOT3D file has no magic
/// number.
bool isPlot3d(const Request& request) {
  if (!request.solution.empty()) return true;
  const std::string end = request.file.extension().string();
  for (const char* known : {".xyz", ".x", ".p3d", ".g", ".grd", ".fmt"}) {
    if (end == known) return true;
  }
  return false;
}

/// Returns the remedy; if the file is gzipped and the remedy names --raw or palpate feel, adds that
/// the file must be unpacked.
std::string unpackedFor(const std::filesystem::path& file, const std::string& remedy) {
  if (!isGzip(file)) return remedy;
  for (const char* reader : {"--raw", "palpate feel"}) {
    if (remedy.find(reader) == std::string::npos) continue;
    return fmt::format("unpack the file with gunzip, which {} does not do; then {}", reader,
                       remedy);
  }
  return remedy;
}

bool isText(const std::string& bytes) {
  return std::all_of(bytes.begin(), bytes.end(), [](char c) {
    return std::isprint(static_cast<unsigned char>(c)) != 0 ||
           std::isspace(static_cast<unsigned char>(c)) != 0;
  });
}

/// Returns true for the folder of a Zarr array or group of version 2.
bool isZarr(const std::filesystem::path& folder) {
  std::error_code error;
  return std::filesystem::exists(folder / ".zarray", error) ||
         std::filesystem::exists(folder / ".zgroup", error) ||
         std::filesystem::exists(folder / ".zattrs", error);
}

/// Throws VolumeError for folders of chunks in other formats than Zarr version 2.
void refuseChunks(const std::filesystem::path& folder) {
  const auto refuse = [&](const char* name, const char* remedy) {
    throw VolumeError(folder.string(),
                      fmt::format("the folder is {}, which palpate does not import", name), remedy);
  };
  std::error_code error;
  const auto beginning = [&](const char* name) {
    const bool is_file = std::filesystem::is_regular_file(folder / name, error);
    return is_file ? firstBytesOf(folder / name) : std::string();
  };
  if (std::filesystem::exists(folder / "zarr.json", error)) {
    refuse("a Zarr store of version 3",
           "convert it to OME-Zarr 0.4 (Zarr version 2) or NRRD, for example with zarr-python");
  }
  if (isNeuroglancer(beginning("info"))) {
    refuse("a neuroglancer precomputed volume", kExportNeuroglancer);
  }
  const std::string n5 = beginning("attributes.json");
  if (n5.find("\"n5\"") != std::string::npos || n5.find("\"blockSize\"") != std::string::npos) {
    refuse("an N5 container", "convert it to OME-Zarr 0.4 or NRRD, for example with Fiji");
  }
  if (folder.extension() == ".zarr") {
    throw VolumeError(folder.string(),
                      "the folder has none of the files .zarray, .zgroup and .zattrs, which "
                      "describe a Zarr store",
                      "copy the whole folder again, with the files whose names begin with a dot");
  }
}

/// Returns true if a folder, or a folder at most `levels` below it, has a DICOM file.
bool hasDicom(const std::filesystem::path& folder, int levels) {
  std::error_code error;
  std::filesystem::directory_iterator entry(folder, error);
  for (; !error && entry != std::filesystem::directory_iterator(); entry.increment(error)) {
    std::error_code ignored;
    const bool is_folder = entry->is_directory(ignored) && !entry->is_symlink(ignored);
    if (is_folder && levels > 0 && hasDicom(entry->path(), levels - 1)) return true;
    if (entry->is_regular_file(ignored) && isDicom(firstBytesOf(entry->path()))) return true;
  }
  return false;
}

/// Returns true for a folder of slices as PNG or TIFF pictures. Pictures beside a DICOM file, or
/// beside folders that have DICOM files, are previews. Throws VolumeError for a folder of JPEG
/// pictures.
bool hasSlices(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::directory_iterator entry(folder, error);
  bool has_slices = false;
  bool has_jpeg = false;
  // openDicom rejects an unreadable folder.
  for (; !error && entry != std::filesystem::directory_iterator(); entry.increment(error)) {
    std::error_code ignored;
    if (!entry->is_regular_file(ignored)) continue;
    const std::string bytes = firstBytesOf(entry->path());
    if (isDicom(bytes)) return false;
    has_slices = has_slices || isPng(bytes) || isTiff(bytes);
    has_jpeg = has_jpeg || isJpeg(bytes);
  }
  constexpr int kDeepest = 3;  // openDicom searches as many levels of folders
  if ((!has_slices && !has_jpeg) || hasDicom(folder, kDeepest)) return false;
  if (has_slices) return true;
  throw VolumeError(folder.string(),
                    "the folder has JPEG pictures, which palpate does not import: their "
                    "compression changes the values",
                    kConvertJpeg);
}

std::unique_ptr<Reader> openFolder(const Request& request) {
  std::error_code error;
  if (std::filesystem::exists(request.file / "system" / "controlDict", error)) {
    refuseUnused(request, "an OpenFOAM case", "");
    return openFoam(request);
  }
  if (isZarr(request.file)) {
    refuseUnused(request, "Zarr", "--level");
    return openZarr(request);
  }
  refuseChunks(request.file);
  if (hasSlices(request.file)) {
    refuseUnused(request, "slices", "--spacing");
    return openSlices(request);
  }
  refuseUnused(request, "a DICOM folder", "--series");
  return openDicom(request);
}

}  // namespace

std::unique_ptr<Reader> openAny(const Request& given) {
  Request request = given;
  if (given.raw.empty()) request.file = headerOf(given.file);
  std::error_code error;
  const auto status = std::filesystem::status(request.file, error);
  if (!std::filesystem::status_known(status)) {
    throw VolumeError(request.file.string(),
                      fmt::format("the file cannot be read ({})", error.message()),
                      "check the path and its permissions");
  }
  if (!std::filesystem::exists(status)) {
    throw VolumeError(request.file.string(), "no such file", "check the path");
  }
  if (std::filesystem::is_directory(status)) return openFolder(request);
  if (!std::filesystem::is_regular_file(status)) {
    throw VolumeError(request.file.string(), "the path is neither a file nor a folder",
                      "give a file, a folder of slices, a Zarr folder or an OpenFOAM case");
  }
  if (!request.raw.empty()) {
    refuseUnused(request, kRawValues, "");
    return openRaw(request);
  }
  if (request.file.extension() == ".foam" || request.file.extension() == ".OpenFOAM") {
    refuseUnused(request, "an OpenFOAM case", "");
    return openFoam(request);
  }
  const std::string bytes = beginningOf(request.file);
  if (bytes.empty()) {
    throw VolumeError(request.file.string(), "the file is empty", "copy the file again");
  }
  for (const Format& format : kFormats) {
    if (!format.begins(bytes)) continue;
    if (format.open != nullptr) {
      refuseUnused(request, format.name, format.option);
      if (format.open != openNifti && isGzip(request.file)) {
        throw VolumeError(
            request.file.string(),
            fmt::format("the file is {}, compressed as a whole with gzip", format.name),
            "unpack it with gunzip");
      }
      return format.open(request);
    }
    throw VolumeError(
        request.file.string(),
        fmt::format("the file looks like {}, which palpate does not import", format.name),
        unpackedFor(request.file, format.remedy));
  }
  // In a JSON file, the key that isVtkSeries() searches may be beyond the first bytes, after a long
  // list.
  if (request.file.extension() == ".series") {
    refuseUnused(request, "a ParaView series", "");
    return openVtkSeries(request);
  }
  if (isGrib(request.file, bytes)) {
    throw VolumeError(
        request.file.string(), "the file looks like GRIB, which palpate does not import",
        "convert it to netCDF, for example with ecCodes' grib_to_netcdf or cdo -f nc copy");
  }
  if (isPlot3d(request)) {
    refuseUnused(request, "PLOT3D", "--solution");
    return openPlot3d(request);
  }
  throw VolumeError(
      request.file.string(),
      isText(bytes) ? "the file looks like text in an unknown format"
                    : "the format is unknown, or the beginning of the file is damaged",
      unpackedFor(
          request.file,
          "see palpate import --help for the known formats, or describe the layout with --raw"));
}

}  // namespace palpate::importer
