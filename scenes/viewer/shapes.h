/// What there is to see in a scene: the backdrop that the hand is drawn in front of.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkProp3D.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/viewer/streams.h"

namespace palpate::view {

using Colour = std::array<double, 3>;  ///< Red, green, blue, 0 to 1.

/// Colours that everybody tells apart (Okabe and Ito), by what a mode does.
inline constexpr Colour kHolds{0.00, 0.45, 0.70};
inline constexpr Colour kYields{0.84, 0.37, 0.00};
inline constexpr Colour kPushes{0.00, 0.62, 0.45};
inline constexpr Colour kIdle{0.55, 0.55, 0.55};
inline constexpr Colour kProbe{0.90, 0.62, 0.00};
inline constexpr Colour kProxy{0.34, 0.71, 0.91};
inline constexpr Colour kForce{0.80, 0.47, 0.65};

/// A share of what is shown, 0 to 1, as a colour that every eye finds lighter the more it is.
[[nodiscard]] Colour onScale(double share);

/// Draws each field as the modes that are made of it: a surface for an isosurface, a cloud as dense
/// as a strength, streams along a vector, guides as they are. What moves is drawn where it is.
class Shapes {
 public:
  /// Reads all fields anew: takes a second or two. `fine`: for pictures, eight times as many
  /// triangles. Of more than kMostParts parts the first are drawn.
  Shapes(const BuiltScene& built, bool fine);

  static constexpr std::size_t kMostParts = 48;

  /// Adds all of it: what is seen through to a layer in front of what is solid, depths first, so
  /// that of it only what is nearest is seen.
  void addTo(vtkRenderer& solid, vtkRenderer& through) const;
  static constexpr int kCoarsest = 4;
  /// How it is drawn: clouds by a ray for so many pixels each way, 1 to kCoarsest; by then surfaces
  /// are coarse too.
  void detail(int step);
  /// Puts what moves where it is at a time [s].
  void moveTo(double time);
  [[nodiscard]] bool moves() const noexcept;
  /// Of all there is [m].
  [[nodiscard]] const Box& bounds() const noexcept { return bounds_; }

  /// What is drawn, for the panel.
  struct Entry {
    std::string name;  ///< The mode's, or the volume's.
    Colour colour;
    double low = 0.0;   ///< In the data's unit: what is darkest,
    double high = 0.0;  ///< and lightest; not more than `low`: of one colour.
    bool grey = false;  ///< Of slices.
  };
  [[nodiscard]] const std::vector<Entry>& legend() const noexcept { return legend_; }
  /// A volume, as it is read.
  struct Volume {
    std::string name;
    FieldPtr field;
    MotionPtr motion;
  };
  /// All of them.
  [[nodiscard]] const std::vector<Volume>& volumes() const noexcept { return volumes_; }
  /// Surfaces and clouds, which hide slices.
  void showBodies(bool on);
  /// What was left out, a line each.
  [[nodiscard]] const std::vector<std::string>& notes() const noexcept { return notes_; }

 private:
  enum class When : std::uint8_t { kAlways, kFine, kCoarse };
  struct Shape {
    vtkSmartPointer<vtkProp3D> prop;
    When when = When::kAlways;
    MotionPtr motion;
    Vec3 centre = Vec3::Zero();  ///< At rest [m].
    bool body = false;
    int surface = -1;                             ///< Its number, of a surface that does not move.
    vtkSmartPointer<vtkProp3D> depths = nullptr;  ///< Of one that is seen through.
    vtkSmartPointer<vtkPolyData> mesh = nullptr;  ///< Of a surface that deforms: what is drawn,
    vtkSmartPointer<vtkPoints> rest = nullptr;    ///< and its points where they rest.
  };
  void addGraph(const Graph& graph, bool fine);
  void addSurface(const Graph& graph, std::size_t field, double level, const std::string& name,
                  bool fine);
  void addCloud(const Graph& graph, std::size_t mode, bool of_vector, std::size_t field,
                const Transfer& strength, int own, const std::string& name);
  void addStreams(const Graph& graph, std::size_t field, Along along, const std::string& name);
  void addGuide(const GuideMode& guide, const MotionPtr& motion, const std::string& name);
  void add(vtkSmartPointer<vtkProp3D> prop, When when, const MotionPtr& motion);
  /// Lets see through what has another surface in it.
  void seeThrough();

  std::vector<Shape> shapes_;
  std::vector<Entry> legend_;
  std::vector<Volume> volumes_;
  std::vector<std::string> notes_;
  std::vector<std::string> known_;  ///< Each drawn once.
  std::size_t surfaces_ = 0;
  std::size_t clouds_ = 0;
  Box bounds_;
  bool fine_ = false;
  bool bodies_ = true;
};

}  // namespace palpate::view
