/// Private to the importer: opens a netCDF file, and finds which dimensions are x, y, z and time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <netcdf.h>
#include <string>
#include <vector>

namespace palpate::importer {

enum class Is : std::uint8_t { kUnknown, kX, kY, kZ, kTime, kNoSpace };

struct Dimension {
  std::string name;
  std::size_t length = 0;
  int variable = -1;  ///< Index of the variable with its positions; -1: none.
  Is is = Is::kUnknown;
  /// For faces of cells, as in WRF's staggered grid: dimension of the centres; otherwise -1.
  int centres = -1;
};

struct Variable {
  std::string name;
  nc_type type = NC_NAT;
  std::vector<int> dimensions;
};

/// An open netCDF file. The constructor and the functions that read numbers throw VolumeError if
/// the file is damaged.
class NetcdfFile {
 public:
  explicit NetcdfFile(const std::filesystem::path& path);
  NetcdfFile(const NetcdfFile&) = delete;
  NetcdfFile& operator=(const NetcdfFile&) = delete;
  ~NetcdfFile() { nc_close(id_); }

  [[nodiscard]] const std::vector<Variable>& variables() const { return variables_; }
  [[nodiscard]] const Variable& variable(int v) const {
    return variables_[static_cast<std::size_t>(v)];
  }
  [[nodiscard]] const Dimension& dimension(int d) const {
    return dimensions_[static_cast<std::size_t>(d)];
  }
  /// Returns the dimension of the centres if d is a dimension of faces, otherwise d.
  [[nodiscard]] int centresOf(int d) const {
    return dimension(d).centres < 0 ? d : dimension(d).centres;
  }
  /// Return the index of a name; -1 if it is absent.
  [[nodiscard]] int dimensionNamed(const std::string& name) const;
  [[nodiscard]] int variableNamed(const std::string& name) const;

  /// Returns true if the values of the variable are the positions along a dimension.
  [[nodiscard]] bool isPositions(int variable) const;
  /// Returns all dimensions except time.
  [[nodiscard]] std::vector<int> spaceOf(int variable) const;

  /// Return the text or the numbers of an attribute; empty if it is absent, too long or of another
  /// type.
  [[nodiscard]] std::string text(int variable, const char* name) const;
  [[nodiscard]] std::vector<double> numbers(int variable, const char* name) const;
  /// Returns the text of an attribute of a group in the file; "" if it is absent.
  [[nodiscard]] std::string groupText(const char* group, const char* name) const;
  /// Reads `count` values along each dimension of a variable, from the indices `start` on.
  void read(int variable, const std::vector<std::size_t>& start,
            const std::vector<std::size_t>& count, double* to) const;
  /// Returns the positions along a dimension; indices from 0 if the file has no positions.
  [[nodiscard]] std::vector<double> positions(int d) const;

  /// Throws VolumeError for more values than the file can contain at the best compression, or more
  /// than kMostVoxels.
  void checkAbsurd(double values) const;

 private:
  void check(int status) const;
  [[noreturn]] void refuse(const std::string& why) const;
  void findMeaning(int d);
  void findCentres(int d);

  std::filesystem::path path_;
  int id_ = -1;
  std::vector<Dimension> dimensions_;
  std::vector<Variable> variables_;
};

}  // namespace palpate::importer
