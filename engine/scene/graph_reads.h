/// Private to engine, for .cpp files: the properties that a graph reads from its volumes.
#pragma once

#include <set>
#include <string>

#include "palpate/engine/scene/graph.h"
#include "palpate/engine/scene/graph_names.h"

namespace palpate {

/// The index of a property in Properties.
struct Slot {
  bool vector = false;  ///< True for a vector, false for a scalar.
  int index = -1;       ///< Index into Properties::vectors or Properties::scalars.
};

/// The readings and properties of a graph under compilation. Each reading or property is made when
/// the first mode needs it, and then shared. The functions throw SceneError if the graph is full.
class GraphReads {
 public:
  /// `names` must belong to `spec`; both must outlive the object.
  GraphReads(const GraphSpec& spec, const GraphNames& names) : spec_(&spec), names_(&names) {}

  Graph graph;       ///< The graph so far, with its fields, readings and modes.
  FieldSet current;  ///< Fields that the mode under compilation has read so far.

  /// Returns the names of the spec.
  [[nodiscard]] const GraphNames& names() const noexcept { return *names_; }
  /// Returns the slot of a property; adds it if it is new. Throws if the name is unknown.
  [[nodiscard]] Slot resolve(const std::string& path, const std::string& name);

  // Indices of the properties of a volume. The volume must exist and be of the stated kind.
  /// Returns the index of a scalar volume in Graph::scalar_fields.
  [[nodiscard]] int scalarField(const std::string& name) { return scalarRead(name).field; }
  /// Returns the index of a vector volume in Graph::vector_fields.
  [[nodiscard]] int vectorField(const std::string& name) { return vectorRead(name).field; }
  /// Returns the index of a scalar volume's value in Properties::scalars.
  [[nodiscard]] int valueOf(const std::string& name);
  /// Returns the index of a scalar volume's continuous gradient in Properties::vectors.
  [[nodiscard]] int gradientOf(const std::string& name);
  /// Returns the index of a scalar volume's interpolated slope in Properties::vectors.
  [[nodiscard]] int cellGradientOf(const std::string& name);
  /// Returns the index of a vector volume's curl in Properties::vectors.
  [[nodiscard]] int curlOf(const std::string& name);
  /// Returns the index of |vectors[from]| in Properties::scalars.
  [[nodiscard]] int magnitudeOf(int from);

  /// Requests the slope of a scalar that a transfer function reads, if it is a value or a
  /// magnitude.
  void followSlope(int scalar);
  /// Requests the Jacobian of a vector that primitives follow.
  void followTurn(int vector);

  /// Returns the index of a volume's motion; -1 if the volume stands still.
  [[nodiscard]] int motionOf(const std::string& name);
  /// Returns the index of the motion that all fields of a set share; -1 without a common motion.
  [[nodiscard]] int motionOf(const FieldSet& set) const;
  /// Returns the frame of the finest field in a set. For an empty set, `voxel` is infinite.
  [[nodiscard]] FieldFrame frameOf(const FieldSet& set) const;

  /// Returns true if the graph so far samples that volume.
  [[nodiscard]] bool isRead(const std::string& volume) const { return read_.count(volume) != 0; }
  /// Returns true if the graph so far reads that derived field, or one that is derived from it.
  [[nodiscard]] bool isUsed(const std::string& derived) const { return used_.count(derived) != 0; }

 private:
  int newScalar(const std::string& name);
  int newVector(const std::string& name);
  int once(int& slot, bool vector, const std::string& name);
  [[nodiscard]] int unitOf(int from);
  /// Returns the reading of a volume; makes it at the first call.
  ScalarRead& scalarRead(const std::string& name);
  VectorRead& vectorRead(const std::string& name);

  const GraphSpec* spec_;
  const GraphNames* names_;
  std::set<std::string> read_;
  std::set<std::string> used_;
};

}  // namespace palpate
