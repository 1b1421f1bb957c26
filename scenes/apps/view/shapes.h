/// Draws the volumes and guides of a scene as the backdrop of the hand.
#pragma once

#include <array>
#include <map>
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

using Colour = std::array<double, 3>;  ///< Red, green and blue, each 0 to 1.

/// Colours of Okabe and Ito, which every kind of colour vision can distinguish, and a grey.
inline constexpr Colour kHolds{0.00, 0.45, 0.70};
inline constexpr Colour kYields{0.84, 0.37, 0.00};
inline constexpr Colour kPushes{0.00, 0.62, 0.45};
inline constexpr Colour kIdle{0.55, 0.55, 0.55};
inline constexpr Colour kProbe{0.90, 0.62, 0.00};
inline constexpr Colour kProxy{0.34, 0.71, 0.91};
inline constexpr Colour kForce{0.80, 0.47, 0.65};
inline constexpr Colour kDark{0.10, 0.11, 0.13};  ///< Background of texts.

/// Returns the colour at a position on the colour scale, 0 (dark) to 1 (light).
[[nodiscard]] Colour onScale(double share);

/// Draws each field as its modes use it: as a surface, a cloud, or streamlines.
class Shapes {
 public:
  /// Reads all fields, which may take seconds. If `fine`, for still pictures, surfaces outside
  /// parts are sampled with more points. Draws only the first kMostParts parts of the scene.
  Shapes(const BuiltScene& built, bool fine);

  static constexpr std::size_t kMostParts = 48;

  /// Adds the shapes to the renderers: translucent ones to `through`, which draws after `solid`.
  /// `through` first draws the depths of these surfaces, so that only the nearest one is visible.
  void addTo(vtkRenderer& solid, vtkRenderer& through) const;
  static constexpr int kCoarsest = 4;
  /// Sets the level of detail, 1 (finest) to kCoarsest: a cloud has one ray for each square of
  /// `step` by `step` pixels. With kCoarsest, surfaces also have fewer triangles.
  void detail(int step);
  /// Moves all moving shapes to their pose at a time [s].
  void moveTo(double time);
  [[nodiscard]] bool moves() const noexcept;
  [[nodiscard]] const Box& bounds() const noexcept { return bounds_; }
  /// Returns the horizontal unit vector from the centre to the scene's front, where the viewer of
  /// the first picture is.
  [[nodiscard]] const Vec3& front() const noexcept { return front_; }
  /// Returns unit vectors to the right, front and top of the patient; without one, x, -y and z.
  [[nodiscard]] const Mat3& sides() const noexcept { return sides_; }

  struct Entry {
    std::string name;  ///< Name of the mode or the volume.
    Colour colour;
    double low = 0.0;   ///< Value of the darkest colour, in the unit of the data.
    double high = 0.0;  ///< Value of the lightest colour; not above `low`: one colour.
    bool grey = false;  ///< True for the grey scale of the slices.
    bool body = false;  ///< True for a surface or a cloud, which the slices replace.
  };
  [[nodiscard]] const std::vector<Entry>& legend() const noexcept { return legend_; }
  struct Volume {
    std::string name;
    FieldPtr field;
    MotionPtr motion;
  };
  [[nodiscard]] const std::vector<Volume>& volumes() const noexcept { return volumes_; }
  /// A letter for a direction of the patient (L, R, P, A, I, S), at a side of the scene's bounds.
  struct Letter {
    std::string letter;
    Vec3 at;  ///< [m]
  };
  /// Returns six letters; empty without a volume that has the space of a patient.
  [[nodiscard]] const std::vector<Letter>& letters() const noexcept { return letters_; }
  /// A surface of the scene, which slices show as a line.
  struct Level {
    std::string name;  ///< Name of its entry in the legend.
    std::shared_ptr<const ScalarField> field;
    double value = 0.0;
    Colour colour{};   ///< Colour of the line, visible on grey.
    MotionPtr motion;  ///< Null if the surface does not move.
  };
  [[nodiscard]] const std::vector<Level>& levels() const noexcept { return levels_; }
  /// Shows or hides surfaces and clouds, which would cover the slices, from the next detail() on.
  void showBodies(bool on);
  /// Returns notes about objects that are not drawn, or drawn coarsely, one line each.
  [[nodiscard]] const std::vector<std::string>& notes() const noexcept { return notes_; }

 private:
  enum class When : std::uint8_t { kAlways, kFine, kCoarse };
  struct Shape {
    vtkSmartPointer<vtkProp3D> prop;
    When when = When::kAlways;
    MotionPtr motion;
    Vec3 centre = Vec3::Zero();  ///< Centre in the rest pose [m].
    bool body = false;
    int surface = -1;  ///< Index of the surface, if it does not move; otherwise -1.
    vtkSmartPointer<vtkProp3D> depths = nullptr;  ///< Draws a translucent surface's depths.
    vtkSmartPointer<vtkPolyData> mesh = nullptr;
    vtkSmartPointer<vtkPoints> rest = nullptr;  ///< Points of this mesh in the rest pose.
  };
  void addGraph(const Graph& graph, bool fine);
  void addSurface(const Graph& graph, const IsosurfaceMode& mode, const std::string& name,
                  bool fine);
  void addCloud(const Graph& graph, std::size_t mode, bool of_vector, std::size_t field,
                const Transfer& strength, int own, const std::string& name);
  void addStreams(const Graph& graph, std::size_t field, Along along, const std::string& name);
  void addGuide(const GuideMode& guide, const MotionPtr& motion, const std::string& name);
  void addLetters();
  void add(vtkSmartPointer<vtkProp3D> prop, When when, const MotionPtr& motion);
  /// Makes each outermost surface translucent that encloses another surface, if both are at rest.
  /// Compares the bounding boxes of the surfaces.
  void seeThrough();

  std::vector<Shape> shapes_;
  std::vector<Entry> legend_;
  std::vector<Volume> volumes_;
  std::vector<Letter> letters_;
  std::vector<Level> levels_;
  std::vector<std::string> notes_;
  /// Keys of the shapes that were drawn, so that no shape is drawn twice.
  std::vector<std::string> known_;
  std::map<std::string, Colour> own_colours_;  ///< Colours in the files, by volume.
  std::size_t surfaces_ = 0;
  std::size_t clouds_ = 0;
  Box bounds_;
  Vec3 front_;
  Mat3 sides_;
  bool fine_ = false;
  bool bodies_ = true;
};

}  // namespace palpate::view
