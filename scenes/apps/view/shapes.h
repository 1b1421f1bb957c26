/// Draws a scene's volumes and guides: the backdrop behind the hand.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkProp3D.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/apps/view/streams.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::view {

using Colour = std::array<double, 3>;  ///< Red, green, blue, 0 to 1.

/// Colours by the effect of a mode, distinct for every kind of colour vision (Okabe and Ito).
inline constexpr Colour kHolds{0.00, 0.45, 0.70};
inline constexpr Colour kYields{0.84, 0.37, 0.00};
inline constexpr Colour kPushes{0.00, 0.62, 0.45};
inline constexpr Colour kIdle{0.55, 0.55, 0.55};
inline constexpr Colour kProbe{0.90, 0.62, 0.00};
inline constexpr Colour kProxy{0.34, 0.71, 0.91};
inline constexpr Colour kForce{0.80, 0.47, 0.65};

/// Returns the colour of a share of the scale, 0 to 1. A larger share is lighter, for every kind of
/// colour vision.
[[nodiscard]] Colour onScale(double share);

/// Draws each field by its modes: a surface for an isosurface, a cloud as dense as a strength,
/// streamlines along a vector, guides as they are. Moving shapes are drawn at their present place.
class Shapes {
 public:
  /// Reads all fields; takes a second or two. `fine`: for pictures, eight times as many triangles.
  /// If there are more than kMostParts parts, draws the first ones.
  Shapes(const BuiltScene& built, bool fine);

  static constexpr std::size_t kMostParts = 48;

  /// Adds all shapes. Translucent shapes go into `through`, a layer in front of `solid`. The depths
  /// of that layer are drawn first, so that only its nearest surface is visible.
  void addTo(vtkRenderer& solid, vtkRenderer& through) const;
  static constexpr int kCoarsest = 4;
  /// Sets the detail of the drawing: a cloud has one ray per `step` pixels each way, 1 to
  /// kCoarsest. At kCoarsest surfaces are coarse too.
  void detail(int step);
  /// Puts moving shapes at their place at a time [s].
  void moveTo(double time);
  [[nodiscard]] bool moves() const noexcept;
  /// Returns the scene's bounds [m].
  [[nodiscard]] const Box& bounds() const noexcept { return bounds_; }

  /// A drawn shape, for the panel's legend.
  struct Entry {
    std::string name;  ///< Name of the mode or the volume.
    Colour colour;
    double low = 0.0;   ///< Value of the darkest colour, in the data's unit.
    double high = 0.0;  ///< Value of the lightest colour; not more than `low`: one colour.
    bool grey = false;  ///< A grey scale, for slices.
  };
  [[nodiscard]] const std::vector<Entry>& legend() const noexcept { return legend_; }
  /// A volume with its field and motion.
  struct Volume {
    std::string name;
    FieldPtr field;
    MotionPtr motion;
  };
  /// Returns all volumes.
  [[nodiscard]] const std::vector<Volume>& volumes() const noexcept { return volumes_; }
  /// Shows or hides surfaces and clouds, because these hide slices.
  void showBodies(bool on);
  /// Returns notes on parts that were left out, one line each.
  [[nodiscard]] const std::vector<std::string>& notes() const noexcept { return notes_; }

 private:
  enum class When : std::uint8_t { kAlways, kFine, kCoarse };
  struct Shape {
    vtkSmartPointer<vtkProp3D> prop;
    When when = When::kAlways;
    MotionPtr motion;
    Vec3 centre = Vec3::Zero();  ///< Centre at rest [m].
    bool body = false;
    int surface = -1;                             ///< Number of a surface that does not move.
    vtkSmartPointer<vtkProp3D> depths = nullptr;  ///< Depths of a translucent surface.
    vtkSmartPointer<vtkPolyData> mesh = nullptr;  ///< Drawn mesh of a surface that deforms.
    vtkSmartPointer<vtkPoints> rest = nullptr;    ///< Points of this mesh at rest.
  };
  void addGraph(const Graph& graph, bool fine);
  void addSurface(const Graph& graph, std::size_t field, double level, const std::string& name,
                  bool fine);
  void addCloud(const Graph& graph, std::size_t mode, bool of_vector, std::size_t field,
                const Transfer& strength, int own, const std::string& name);
  void addStreams(const Graph& graph, std::size_t field, Along along, const std::string& name);
  void addGuide(const GuideMode& guide, const MotionPtr& motion, const std::string& name);
  void add(vtkSmartPointer<vtkProp3D> prop, When when, const MotionPtr& motion);
  /// Makes a surface translucent if it has another surface in it.
  void seeThrough();

  std::vector<Shape> shapes_;
  std::vector<Entry> legend_;
  std::vector<Volume> volumes_;
  std::vector<std::string> notes_;
  std::vector<std::string> known_;  ///< Keys of drawn shapes; each is drawn once.
  std::size_t surfaces_ = 0;
  std::size_t clouds_ = 0;
  Box bounds_;
  bool fine_ = false;
  bool bodies_ = true;
};

}  // namespace palpate::view
