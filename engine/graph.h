/// The primitive graph: which property feeds which mode. Names at load, indices in the tick.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "engine/field.h"
#include "engine/mode.h"
#include "engine/properties.h"

namespace palpate {

/// A property computed from another, as the scene file's "fields" say.
enum class Derivation : std::uint8_t {
  kMagnitude,   ///< |v| of any vector.
  kGradient,    ///< Of a scalar volume.
  kCurl,        ///< Of a vector volume.
  kDivergence,  ///< Of a vector volume.
  kUnit,        ///< v / |v| of any vector; zero where it has no direction, see flow.h.
  kQ,           ///< The Q criterion of a vector volume: > 0 in a vortex.
  kLambda2,     ///< Of a vector volume: < 0 in a vortex.
};

/// All of them, in the order of the enumerators.
inline constexpr std::array kDerivations{
    Derivation::kMagnitude, Derivation::kGradient, Derivation::kCurl,   Derivation::kDivergence,
    Derivation::kUnit,      Derivation::kQ,        Derivation::kLambda2};

/// What a derivation is made of, and what it gives.
struct DerivationKind {
  bool of_vector = true;  ///< Else of a scalar.
  bool vector = false;    ///< What it gives; else a scalar.
  bool of_volume = true;  ///< Needs its operand's derivatives, hence a volume.
};
[[nodiscard]] constexpr DerivationKind kindOf(Derivation derivation) noexcept {
  switch (derivation) {
    case Derivation::kMagnitude:
      return {true, false, false};
    case Derivation::kUnit:
      return {true, true, false};
    case Derivation::kGradient:
      return {false, true, true};
    case Derivation::kCurl:
      return {true, true, true};
    case Derivation::kDivergence:
    case Derivation::kQ:
    case Derivation::kLambda2:
      break;
  }
  return {true, false, true};
}

struct DerivedSpec {
  Derivation derivation = Derivation::kMagnitude;
  std::string of;  ///< A volume or another derived field.
};

enum class ModeKind : std::uint8_t { kForce, kViscosity, kSurface, kIsosurface, kFollow };

/// Which side of a value is solid.
enum class Solid : std::uint8_t { kAbove, kBelow };

/// Whether a force pulls along its field or pushes against it.
enum class Sense : std::uint8_t { kAttract, kRepel };

/// One mode, as the scene file says it.
struct ModeSpec {
  std::string name;  ///< For people; may be empty.
  ModeKind kind = ModeKind::kSurface;
  std::string of;                   ///< The volume or derived field it is made of.
  TransferFunction strength = 0.0;  ///< [N]
  std::string by;                   ///< The scalar that `strength` reads; empty: the mode's own.
  double value = 0.0;               ///< isosurface: V0.
  Solid solid = Solid::kAbove;      ///< surface and isosurface.
  double depth_voxels = 3.0;        ///< isosurface: pushes back until so deep after yielding.
  std::optional<Sense> sense;       ///< force; default: along a vector, down a scalar's gradient.
};

/// Names and edges, as the scene file says.
struct GraphSpec {
  std::map<std::string, DerivedSpec> fields;
  std::vector<ModeSpec> modes;
};

/// One scalar field read once; an index below zero is wanted by nobody and not written.
struct ScalarRead {
  int field = 0;           ///< Index into Graph::scalar_fields.
  int value = -1;          ///< -> Properties::scalars
  int gradient = -1;       ///< -> Properties::vectors
  int cell_gradient = -1;  ///< -> Properties::vectors
};

/// One vector field read once.
struct VectorRead {
  int field = 0;        ///< Index into Graph::vector_fields.
  int value = -1;       ///< -> Properties::vectors
  int curl = -1;        ///< -> Properties::vectors
  int divergence = -1;  ///< -> Properties::scalars
  int q = -1;           ///< -> Properties::scalars
  int lambda2 = -1;     ///< -> Properties::scalars
};

/// The direction of vectors[from] -> vectors[to].
struct UnitStep {
  int from = 0;
  int to = 0;
};

/// |vectors[from]| -> scalars[to].
struct MagnitudeStep {
  int from = 0;
  int to = 0;
};

/// What the tick runs: a flat list, nothing sampled twice and nothing in vain.
struct Graph {
  std::vector<std::shared_ptr<const ScalarField>> scalar_fields;  ///< Only those read.
  std::vector<std::shared_ptr<const VectorField>> vector_fields;
  std::vector<std::string> scalar_names;  ///< Of the fields, and what each property is: for people.
  std::vector<std::string> vector_names;
  std::vector<std::string> scalar_properties;
  std::vector<std::string> vector_properties;
  std::vector<ScalarRead> scalar_reads;
  std::vector<VectorRead> vector_reads;
  std::vector<UnitStep> units;  ///< Each after the one that it is made of.
  std::vector<MagnitudeStep> magnitudes;
  std::vector<Mode> modes;
  std::vector<std::string> mode_names;
  std::vector<std::string> unused;  ///< Fields and derived fields that no mode reads: not sampled.
};

/// Most modes of one scene, and most fields that one scene reads.
inline constexpr std::size_t kMaxModes = 256;
inline constexpr std::size_t kMaxFields = 64;

/// Checks the names, types and edges and flattens them. Throws SceneError whose text begins with
/// the JSON path of what is wrong, as /modes/0/of.
[[nodiscard]] Graph compileGraph(const GraphSpec& spec,
                                 const std::map<std::string, FieldPtr>& fields);

/// The words of the scene file.
[[nodiscard]] const char* wordFor(ModeKind kind) noexcept;
[[nodiscard]] const char* wordFor(Derivation derivation) noexcept;

}  // namespace palpate
