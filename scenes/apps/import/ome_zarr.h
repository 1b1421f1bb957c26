/// Private to the importer: parses the metadata of OME-Zarr images. Source: Next-generation file
/// formats (NGFF), version 0.4 (ngff.openmicroscopy.org/0.4).
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace palpate::importer {

/// A level of resolution. Position along an axis = scale * index + translation.
struct OmeLevel {
  std::string path;                 ///< Folder of its array, relative to that of the image.
  std::vector<double> scale;        ///< For each axis of the array, > 0.
  std::vector<double> translation;  ///< For each axis of the array.
};

struct OmeImage {
  std::string name;  ///< Empty: not stated.
  std::size_t axes = 0;
  /// Axes of the array along x, y and z.
  std::array<std::size_t, 3> space{};
  int time = -1;                      ///< Axis of the array; -1: none.
  int channel = -1;                   ///< Axis of the array; -1: none.
  std::string unit;                   ///< Unit of lengths, such as "um"; empty: unknown.
  std::string time_unit;              ///< Unit of times, such as "second"; empty: not stated.
  std::vector<OmeLevel> levels;       ///< In the file's order: by NGFF, from finest to coarsest.
  std::vector<std::string> channels;  ///< Labels; some may be empty or absent.
};

/// Parses the content of a file .zattrs with the key "multiscales". Converts positions to the unit
/// of x. If units differ and one is unknown, the result has no unit. Throws VolumeError, which
/// names `file`.
[[nodiscard]] OmeImage parseOmeImage(const nlohmann::json& json, const std::filesystem::path& file,
                                     std::vector<std::string>& notes);

}  // namespace palpate::importer
