/// Private to engine: what a graph reads of its volumes. Include it in .cpp files only.
#pragma once

#include <set>
#include <string>

#include "palpate/engine/graph.h"
#include "palpate/engine/graph_names.h"

namespace palpate {

/// Which property a name stands for.
struct Slot {
  bool vector = false;
  int index = -1;  ///< Into Properties::vectors or ::scalars.
};

/// The reads and properties of a graph that is being compiled: each is made when the first mode
/// asks for it, and then shared. Throws SceneError where there is no room for more.
class GraphReads {
 public:
  GraphReads(const GraphSpec& spec, const GraphNames& names) : spec_(&spec), names_(&names) {}

  Graph graph;
  FieldSet current;  ///< What the mode at hand has read so far.

  [[nodiscard]] const GraphNames& names() const noexcept { return *names_; }
  /// The property that a name stands for. Throws where it is unknown.
  [[nodiscard]] Slot resolve(const std::string& path, const std::string& name);

  // Of a volume of that name, which is there and of that kind.
  [[nodiscard]] int scalarField(const std::string& name) { return scalarRead(name).field; }
  [[nodiscard]] int vectorField(const std::string& name) { return vectorRead(name).field; }
  [[nodiscard]] int valueOf(const std::string& name);
  [[nodiscard]] int gradientOf(const std::string& name);
  [[nodiscard]] int cellGradientOf(const std::string& name);
  [[nodiscard]] int curlOf(const std::string& name);
  /// |vectors[from]|.
  [[nodiscard]] int magnitudeOf(int from);

  /// How a scalar that a strength follows changes with the place is wanted as well, where it can
  /// be known: derivatives of derivatives are not stored.
  void followSlope(int scalar);
  /// And how a vector does that primitives are along.
  void followTurn(int vector);

  /// The motion of a volume, -1 where it stands still.
  [[nodiscard]] int motionOf(const std::string& name);
  /// The one motion of all fields of a set, -1 where there are several, or none.
  [[nodiscard]] int motionOf(const FieldSet& set) const;
  /// The finest of a set's fields.
  [[nodiscard]] FieldFrame frameOf(const FieldSet& set) const;

  [[nodiscard]] bool isRead(const std::string& volume) const { return read_.count(volume) != 0; }
  [[nodiscard]] bool isUsed(const std::string& derived) const { return used_.count(derived) != 0; }

 private:
  int newScalar(const std::string& name);
  int newVector(const std::string& name);
  int once(int& slot, bool vector, const std::string& name);
  [[nodiscard]] int unitOf(int from);
  /// The read of a volume, made at the first call.
  ScalarRead& scalarRead(const std::string& name);
  VectorRead& vectorRead(const std::string& name);

  const GraphSpec* spec_;
  const GraphNames* names_;
  std::set<std::string> read_;  ///< Volumes that are sampled.
  std::set<std::string> used_;  ///< Derived fields that are.
};

}  // namespace palpate
