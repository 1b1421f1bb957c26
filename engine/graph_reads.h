/// Private to engine: what a graph reads of its volumes. Include it in .cpp files only.
#pragma once

#include <set>
#include <string>

#include "palpate/engine/graph.h"
#include "palpate/engine/graph_names.h"

namespace palpate {

/// The property that a name stands for.
struct Slot {
  bool vector = false;  ///< The property is a vector; false: a scalar.
  int index = -1;       ///< Index into Properties::vectors or Properties::scalars.
};

/// The readings and properties of a graph that is being compiled: each is made when the first mode
/// asks for it, and then shared. Throws SceneError where there is no room for more.
class GraphReads {
 public:
  /// Begins with nothing read. `names` is that of `spec`; both must outlive it.
  GraphReads(const GraphSpec& spec, const GraphNames& names) : spec_(&spec), names_(&names) {}

  Graph graph;  ///< The graph so far: its fields, their readings, and the modes that were added.
  FieldSet current;  ///< Fields that the mode being compiled has read so far.

  /// What the names in the spec stand for, and the checks of them.
  [[nodiscard]] const GraphNames& names() const noexcept { return *names_; }
  /// The property that a name stands for. Throws where the name is unknown.
  [[nodiscard]] Slot resolve(const std::string& path, const std::string& name);

  // Indices of what is read of a volume, which must be there and of that kind.
  /// Index of a scalar volume in Graph::scalar_fields.
  [[nodiscard]] int scalarField(const std::string& name) { return scalarRead(name).field; }
  /// Index of a vector volume in Graph::vector_fields.
  [[nodiscard]] int vectorField(const std::string& name) { return vectorRead(name).field; }
  /// Index of a scalar volume's value in Properties::scalars.
  [[nodiscard]] int valueOf(const std::string& name);
  /// Index of a scalar volume's continuous gradient in Properties::vectors.
  [[nodiscard]] int gradientOf(const std::string& name);
  /// Index of ScalarField::cellGradient of a scalar volume in Properties::vectors.
  [[nodiscard]] int cellGradientOf(const std::string& name);
  /// Index of a vector volume's curl in Properties::vectors.
  [[nodiscard]] int curlOf(const std::string& name);
  /// Index of |vectors[from]| in Properties::scalars.
  [[nodiscard]] int magnitudeOf(int from);

  /// Asks for the slope of a scalar on which a strength depends, where it can be known: derivatives
  /// of derivatives are not stored.
  void followSlope(int scalar);
  /// Asks for the Jacobian of a vector along which primitives are.
  void followTurn(int vector);

  /// Index of a volume's motion; -1 where the volume stands still.
  [[nodiscard]] int motionOf(const std::string& name);
  /// Index of the one motion of all fields of a set; -1 where they have several, or none.
  [[nodiscard]] int motionOf(const FieldSet& set) const;
  /// The frame of the finest field of a set.
  [[nodiscard]] FieldFrame frameOf(const FieldSet& set) const;

  /// True if the graph so far samples that volume.
  [[nodiscard]] bool isRead(const std::string& volume) const { return read_.count(volume) != 0; }
  /// True if the graph so far reads that derived field, or one that is derived from it.
  [[nodiscard]] bool isUsed(const std::string& derived) const { return used_.count(derived) != 0; }

 private:
  int newScalar(const std::string& name);
  int newVector(const std::string& name);
  int once(int& slot, bool vector, const std::string& name);
  [[nodiscard]] int unitOf(int from);
  /// The reading of a volume, made at the first call.
  ScalarRead& scalarRead(const std::string& name);
  VectorRead& vectorRead(const std::string& name);

  const GraphSpec* spec_;
  const GraphNames* names_;
  std::set<std::string> read_;  ///< Volumes that are sampled.
  std::set<std::string> used_;  ///< Derived fields that are read.
};

}  // namespace palpate
