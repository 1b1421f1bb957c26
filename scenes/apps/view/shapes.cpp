#include "palpate/scenes/apps/view/shapes.h"

#include <algorithm>
#include <optional>
#include <random>
#include <utility>

#include <fmt/format.h>
#include <tbb/parallel_for.h>
#include <vtkActor.h>
#include <vtkCellArray.h>
#include <vtkColorTransferFunction.h>
#include <vtkFixedPointVolumeRayCastMapper.h>
#include <vtkFloatArray.h>
#include <vtkFlyingEdges3D.h>
#include <vtkImageShiftScale.h>
#include <vtkLineSource.h>
#include <vtkLookupTable.h>
#include <vtkMatrix4x4.h>
#include <vtkOutlineSource.h>
#include <vtkPiecewiseFunction.h>
#include <vtkPointData.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkPolyDataMapper.h>
#include <vtkProperty.h>
#include <vtkRegularPolygonSource.h>
#include <vtkSphereSource.h>
#include <vtkVolume.h>
#include <vtkVolumeProperty.h>

#include "palpate/scenes/apps/common/front.h"
#include "palpate/scenes/apps/view/felt_part.h"
#include "palpate/scenes/apps/view/sampled.h"

namespace palpate::view {
namespace {

// Numbers of points along the longest side of a sampled field.
constexpr int kCoarsePoints = 80;
constexpr int kPoints = 176;
constexpr int kFinePoints = 320;
constexpr double kPointsPerVoxel = 4.0;  ///< more points would not show more details of the data
constexpr int kCloudPoints = 112;
constexpr int kStreamPoints = 64;
constexpr std::size_t kMostClouds = 2;

/// Light, warm colours of surfaces, on which the hand is clearly visible.
constexpr std::array<Colour, 6> kBodies{{{0.87, 0.74, 0.64},
                                         {0.93, 0.91, 0.84},
                                         {0.72, 0.62, 0.66},
                                         {0.66, 0.72, 0.66},
                                         {0.80, 0.78, 0.62},
                                         {0.64, 0.68, 0.76}}};
/// Colours of the lines of surfaces on grey slices.
constexpr std::array<Colour, 4> kLines{
    {{1.00, 0.80, 0.00}, {0.25, 0.90, 0.50}, {1.00, 0.40, 0.75}, {0.40, 0.75, 1.00}}};
/// Colour scale with even steps for every kind of colour vision (similar to the map cividis).
constexpr std::array<Colour, 5> kScale{{{0.00, 0.13, 0.30},
                                        {0.26, 0.31, 0.42},
                                        {0.49, 0.48, 0.47},
                                        {0.73, 0.66, 0.42},
                                        {1.00, 0.91, 0.27}}};

MotionPtr motionOf(const Graph& graph, int index) {
  return index < 0 ? nullptr : graph.motions[static_cast<std::size_t>(index)];
}

vtkSmartPointer<vtkActor> actorOf(vtkAlgorithmOutput* output) {
  auto mapper = vtkSmartPointer<vtkPolyDataMapper>::New();
  mapper->SetInputConnection(output);
  mapper->ScalarVisibilityOff();
  auto actor = vtkSmartPointer<vtkActor>::New();
  actor->SetMapper(mapper);
  return actor;
}

int scalarFieldOf(const Graph& graph, int property) {
  for (const ScalarRead& read : graph.scalar_reads) {
    if (property >= 0 && read.value == property) return read.field;
  }
  return -1;
}
int vectorFieldOfScalar(const Graph& graph, int property) {
  for (const MagnitudeStep& step : graph.magnitudes) {
    if (step.to != property) continue;
    for (const VectorRead& read : graph.vector_reads) {
      if (read.value == step.from) return read.field;
    }
  }
  return -1;
}
/// Returns the index of the vector field from which a vector, a curl or a direction is computed.
int vectorFieldOf(const Graph& graph, int property) {
  for (const UnitStep& step : graph.units) {
    if (step.to == property) property = step.from;
  }
  for (const VectorRead& read : graph.vector_reads) {
    if (property >= 0 && (read.value == property || read.curl == property)) return read.field;
  }
  return -1;
}
int scalarFieldOfGradient(const Graph& graph, int property) {
  for (const ScalarRead& read : graph.scalar_reads) {
    if (property >= 0 && read.gradient == property) return read.field;
  }
  return -1;
}

/// Returns the factors of a strength as masks. Leaves out factors that the drawn value itself sets,
/// and fields that move otherwise than the drawn field or load data during the run (attends()).
std::vector<Mask> masksOf(const Graph& graph, const Transfer& strength, int own, int motion) {
  std::vector<Mask> masks;
  for (const Transfer::Factor& factor : strength.factors) {
    const int read = factor.scalar == own ? -1 : scalarFieldOf(graph, factor.scalar);
    if (read < 0) continue;
    const auto by = static_cast<std::size_t>(read);
    const ScalarField& field = *graph.scalar_fields[by];
    if (graph.scalar_motions[by] != motion || field.attends()) continue;
    masks.push_back({&field, &factor.curve});
  }
  return masks;
}

/// Moves the points of a mesh to their positions at a time [s].
void deform(vtkPolyData& mesh, vtkPoints& rest, const Motion& motion, double time) {
  auto moved = vtkSmartPointer<vtkPoints>::New();
  const vtkIdType count = rest.GetNumberOfPoints();
  moved->SetNumberOfPoints(count);
  tbb::parallel_for(vtkIdType{0}, count, [&](vtkIdType i) {
    double p[3];  // NOLINT(modernize-avoid-c-arrays): VTK takes a C array
    rest.GetPoint(i, p);
    const Vec3 at = Eigen::Map<const Vec3>(p);
    const Vec3 to = motion.poseOf(at, time)(at);
    moved->SetPoint(i, to.data());
  });
  mesh.SetPoints(moved);
}

}  // namespace

Colour onScale(double share) {
  const double at = std::clamp(share, 0.0, 1.0) * (kScale.size() - 1);
  const auto i = std::min<std::size_t>(kScale.size() - 2, static_cast<std::size_t>(at));
  Colour mixed;
  for (std::size_t c = 0; c < 3; ++c) {
    mixed[c] = kScale[i][c] + (at - static_cast<double>(i)) * (kScale[i + 1][c] - kScale[i][c]);
  }
  return mixed;
}

Shapes::Shapes(const BuiltScene& built, bool fine)
    : bounds_(built.bounds), front_(cli::frontOf(built)), fine_(fine) {
  for (const auto& [name, volume] : built.volumes) {
    if (const auto& own = volume->info().colour) {
      own_colours_[name] = {own->x(), own->y(), own->z()};
    }
  }
  addGraph(built.scene->graph, fine);
  seeThrough();
  const auto& parts = built.scene->parts;
  for (std::size_t i = 0; i < std::min(parts.size(), kMostParts); ++i) {
    addGraph(parts[i].graph, false);
  }
  if (parts.size() > kMostParts) {
    notes_.push_back(
        fmt::format("{} of {} parts are drawn; all are felt", kMostParts, parts.size()));
  }
  if (!built.sequences.empty()) notes_.push_back("sequences: only the first frame is drawn");
  for (const auto& [name, field] : built.fields) {
    const auto moved = built.motions.find(name);
    volumes_.push_back({name, field, moved == built.motions.end() ? nullptr : moved->second});
  }
  auto outline = vtkSmartPointer<vtkOutlineSource>::New();
  const Vec3& a = bounds_.lower;
  const Vec3& b = bounds_.upper;
  outline->SetBounds(a.x(), b.x(), a.y(), b.y(), a.z(), b.z());
  auto box = actorOf(outline->GetOutputPort());
  box->GetProperty()->SetColor(0.45, 0.45, 0.45);
  box->GetProperty()->LightingOff();
  add(box, When::kAlways, nullptr);
  sides_.col(0) = Vec3::UnitX();
  sides_.col(1) = -Vec3::UnitY();
  sides_.col(2) = Vec3::UnitZ();
  if (const std::optional<Mat3> patient = cli::patientOf(built)) {
    sides_ = *patient;
    addLetters();
  }
}

void Shapes::addLetters() {
  constexpr std::array<std::array<const char*, 2>, 3> kLetters{
      {{"L", "R"}, {"P", "A"}, {"I", "S"}}};
  constexpr double kOutside = 1.06;  // distance from the centre, relative to that of the bounds
  for (int axis = 0; axis < 3; ++axis) {
    const Vec3 along = sides_.col(axis);
    const double reach = 0.5 * along.cwiseAbs().dot(bounds_.size());
    for (std::size_t end = 0; end < 2; ++end) {
      const double sign = end == 0 ? -1.0 : 1.0;
      letters_.push_back({kLetters[static_cast<std::size_t>(axis)][end],
                          bounds_.centre() + sign * kOutside * reach * along});
    }
  }
}

void Shapes::add(vtkSmartPointer<vtkProp3D> prop, When when, const MotionPtr& motion) {
  const Vec3 centre = motion ? Vec3(prop->GetCenter()) : Vec3::Zero();
  shapes_.push_back({std::move(prop), when, motion, centre});
}

void Shapes::seeThrough() {
  constexpr double kOpacity = 0.4;
  constexpr double kSlack = 0.02;  // relative; both surfaces may end at the border of the data
  const auto holds = [](const Shape& outer, const Shape& inner) {
    double a[6];
    double b[6];
    outer.prop->GetBounds(a);
    inner.prop->GetBounds(b);
    for (int i = 0; i < 6; i += 2) {
      const double slack = kSlack * (a[i + 1] - a[i]);
      if (b[i] < a[i] - slack || b[i + 1] > a[i + 1] + slack) return false;
    }
    return true;
  };
  // If two surfaces enclose each other, the first one counts as the outer one.
  const auto outside = [&](const Shape& a, const Shape& b) {
    return a.surface >= 0 && b.surface >= 0 && a.surface != b.surface && holds(a, b) &&
           (a.surface < b.surface || !holds(b, a));
  };
  vtkMapper::SetResolveCoincidentTopologyToPolygonOffset();
  vtkMapper::SetResolveCoincidentTopologyPolygonOffsetParameters(0.0, 0.0);
  vtkMapper::SetResolveCoincidentTopologyLineOffsetParameters(0.0, 0.0);
  const std::vector<Shape> all = shapes_;
  for (Shape& shape : shapes_) {
    const auto has = [&](const Shape& b) { return outside(shape, b); };
    const auto in = [&](const Shape& b) { return outside(b, shape); };
    if (std::none_of(all.begin(), all.end(), has) || std::any_of(all.begin(), all.end(), in)) {
      continue;
    }
    auto* actor = static_cast<vtkActor*>(shape.prop.Get());
    // The depths are slightly behind the surface, so that the surface passes the depth test.
    auto behind = vtkSmartPointer<vtkPolyDataMapper>::New();
    behind->SetInputData(static_cast<vtkPolyDataMapper*>(actor->GetMapper())->GetInput());
    behind->ScalarVisibilityOff();
    behind->SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 4.0);
    auto depths = vtkSmartPointer<vtkActor>::New();
    depths->SetMapper(behind);
    depths->GetProperty()->SetOpacity(1e-3);
    depths->ForceOpaqueOn();
    shape.depths = depths;
    actor->GetProperty()->SetOpacity(kOpacity);
  }
}

void Shapes::addGraph(const Graph& graph, bool fine) {
  const auto draw = [&](std::size_t i, int scalar, int vector, const Transfer& strength,
                        const std::string& name) {
    if (const int field = scalarFieldOf(graph, scalar); field >= 0) {
      addCloud(graph, i, false, static_cast<std::size_t>(field), strength, scalar, name);
    } else if (const int of = vectorFieldOfScalar(graph, scalar); of >= 0) {
      addCloud(graph, i, true, static_cast<std::size_t>(of), strength, scalar, name);
    } else if (const int along = vectorFieldOf(graph, vector); along >= 0) {
      addStreams(graph, static_cast<std::size_t>(along), Along::kValue, name);
    } else if (const int up = scalarFieldOfGradient(graph, vector); up >= 0) {
      addCloud(graph, i, false, static_cast<std::size_t>(up), strength, -2, name);
    }
  };
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    const std::string& name = graph.mode_names[i];
    const Mode& mode = graph.modes[i];
    if (const auto* iso = std::get_if<IsosurfaceMode>(&mode)) {
      addSurface(graph, *iso, name, fine);
    } else if (const auto* surface = std::get_if<SurfaceMode>(&mode)) {
      addCloud(graph, i, false, static_cast<std::size_t>(surface->skin.field), surface->strength,
               surface->skin.value, name);
    } else if (const auto* drag = std::get_if<ViscosityMode>(&mode)) {
      draw(i, drag->scalar, -1, drag->strength, name);
    } else if (const auto* force = std::get_if<ForceMode>(&mode)) {
      draw(i, -1, force->vector, force->strength, name);
    } else if (const auto* follow = std::get_if<FollowMode>(&mode)) {
      draw(i, -1, follow->vector, follow->strength, name);
    } else if (const auto* front = std::get_if<FrontShapeMode>(&mode)) {
      draw(i, -1, front->vector, front->strength, name);
    } else if (const auto* tube = std::get_if<VortexTubeMode>(&mode)) {
      if (const int of = vectorFieldOf(graph, tube->curl); of >= 0) {
        addStreams(graph, static_cast<std::size_t>(of), Along::kCurl, name);
      }
    } else if (const auto* guide = std::get_if<GuideMode>(&mode)) {
      addGuide(*guide, motionOf(graph, graph.mode_motions[i]), name);
    }
  }
}

void Shapes::addSurface(const Graph& graph, const IsosurfaceMode& mode, const std::string& name,
                        bool fine) {
  const auto field = static_cast<std::size_t>(mode.skin.field);
  const double level = mode.level;
  const ScalarField& of = *graph.scalar_fields[field];
  // The whole surface has the same value, and so the same factor by this value.
  const std::vector<Mask> masks =
      masksOf(graph, mode.strength, mode.skin.value, graph.scalar_motions[field]);
  const std::string key = fmt::format("surface {} {}{}", of.id(), level, textOf(masks));
  if (std::find(known_.begin(), known_.end(), key) != known_.end()) return;
  known_.push_back(key);
  const auto own = own_colours_.find(graph.scalar_names[field]);
  const bool has_own = own != own_colours_.end();
  const Colour colour = has_own ? own->second : kBodies[surfaces_ % kBodies.size()];
  const MotionPtr motion = motionOf(graph, graph.scalar_motions[field]);
  bool exists = false;
  const auto mesh = [&](int points, When when) {
    auto contour = vtkSmartPointer<vtkFlyingEdges3D>::New();
    // The points beyond the data close the surface at the edge of the data. A hand feels it there,
    // except in a level set.
    contour->SetInputData(sampled(of, points, of.frame().distance ? 0 : 1));
    contour->SetValue(0, level);
    contour->ComputeNormalsOn();
    contour->ComputeGradientsOff();
    contour->ComputeScalarsOff();
    contour->Update();
    exists = exists || contour->GetOutput()->GetNumberOfCells() > 0;
    moveToData(*contour->GetOutput(), of);
    const auto kept = feltPart(*contour->GetOutput(), of, level, masks);
    if (kept->GetNumberOfCells() == 0) return false;
    auto actor = actorOf(contour->GetOutputPort());
    // Frees the image and the contour filter: the mapper gets its own copy of the surface.
    contour->SetInputData(nullptr);
    static_cast<vtkPolyDataMapper*>(actor->GetMapper())->SetInputData(kept);
    vtkProperty* look = actor->GetProperty();
    look->SetColor(colour[0], colour[1], colour[2]);
    look->SetSpecular(0.15);
    look->SetSpecularPower(20.0);
    add(actor, when, motion);
    shapes_.back().body = true;
    if (!motion) shapes_.back().surface = static_cast<int>(surfaces_);
    if (motion && motion->warp()) {
      shapes_.back().rest = kept->GetPoints();
      shapes_.back().mesh = kept;
    }
    return true;
  };
  const FieldFrame frame = of.frame();
  const double voxels = frame.bounds.size().maxCoeff() / frame.voxel;
  const int most = fine_ && fine ? kFinePoints : graph.scalar_fields.size() > 8 ? 48 : kPoints;
  const int points =
      static_cast<int>(std::clamp(kPointsPerVoxel * voxels, 48.0, static_cast<double>(most)));
  const double step = voxels / (points - 1);
  if (!mesh(points, When::kFine)) {
    notes_.push_back(exists ? fmt::format("{}: not drawn: its strength is zero on all of it", name)
                     : step > 1.0
                         ? fmt::format("{}: not drawn: too small, or no surface at {}", name, level)
                         : fmt::format("{}: no surface to draw at the value {}", name, level));
    return;
  }
  (void)mesh(std::min(points, kCoarsePoints), When::kCoarse);
  if (step > 1.5) {
    notes_.push_back(fmt::format("{}: drawn {:.1f} times coarser than it is felt", name, step));
  }
  ++surfaces_;
  legend_.push_back({name, colour});
  legend_.back().body = true;
  const Colour line = has_own ? colour : kLines[levels_.size() % kLines.size()];
  levels_.push_back({name, graph.scalar_fields[field], level, line, motion});
}

void Shapes::addCloud(const Graph& graph, std::size_t mode, bool of_vector, std::size_t field,
                      const Transfer& strength, int own, const std::string& name) {
  const std::uint64_t id =
      of_vector ? graph.vector_fields[field]->id() : graph.scalar_fields[field]->id();
  const std::string key = fmt::format("cloud {} {}", id, mode);
  if (std::find(known_.begin(), known_.end(), key) != known_.end()) return;
  known_.push_back(key);
  if (clouds_ == kMostClouds) {
    notes_.push_back(name + ": not drawn: two clouds are drawn already");
    return;
  }
  const auto image = of_vector ? sampled(*graph.vector_fields[field], Along::kValue, kCloudPoints)
                               : sampled(*graph.scalar_fields[field], kCloudPoints);
  const auto [low, high] = usual(*image);
  // Scales the values to 16-bit integers, which the volume mapper needs.
  constexpr double kMost = 65535.0;
  auto scaled = vtkSmartPointer<vtkImageShiftScale>::New();
  scaled->SetInputData(image);
  scaled->SetShift(-low);
  scaled->SetScale(kMost / (high - low));
  scaled->SetOutputScalarTypeToUnsignedShort();
  scaled->ClampOverflowOn();
  scaled->Update();
  // The opacity follows the mode's strength if the strength depends on the value, and otherwise the
  // value.
  const auto strong = [&](double value) {
    double product = 1.0;
    bool follows = false;
    for (const Transfer::Factor& factor : strength.factors) {
      const bool reads = factor.scalar == own && own >= 0 && !factor.curve.isConstant();
      follows = follows || reads;
      product *= reads ? factor.curve(value) : factor.curve.highest();
    }
    return std::pair(product, follows);
  };
  auto opacity = vtkSmartPointer<vtkPiecewiseFunction>::New();
  auto colours = vtkSmartPointer<vtkColorTransferFunction>::New();
  constexpr int kKnots = 64;
  double most = 0.0;
  for (int i = 0; i <= kKnots; ++i) {
    most = std::max(most, strong(low + (high - low) * i / kKnots).first);
  }
  for (int i = 0; i <= kKnots; ++i) {
    const double share = static_cast<double>(i) / kKnots;
    const auto [force, follows] = strong(low + (high - low) * share);
    const double dense = follows && most > 0.0 ? force / most : share * share;
    opacity->AddPoint(kMost * share, i == 0 ? 0.0 : 0.35 * dense);
    const Colour colour = onScale(share);
    colours->AddRGBPoint(kMost * share, colour[0], colour[1], colour[2]);
  }
  auto mapper = vtkSmartPointer<vtkFixedPointVolumeRayCastMapper>::New();
  const int motion = of_vector ? graph.vector_motions[field] : graph.scalar_motions[field];
  const std::vector<Mask> masks = masksOf(graph, strength, own, motion);
  auto look = vtkSmartPointer<vtkVolumeProperty>::New();
  if (masks.empty()) {
    mapper->SetInputData(scaled->GetOutput());
  } else {
    mapper->SetInputData(feltCloud(*scaled->GetOutput(), *opacity, masks));
    opacity->RemoveAllPoints();
    opacity->AddPoint(0.0, 0.0);
    opacity->AddPoint(kMost, 1.0);
    look->IndependentComponentsOff();
  }
  mapper->AutoAdjustSampleDistancesOff();
  mapper->SetSampleDistance(static_cast<float>(image->GetSpacing()[0]));
  look->SetScalarOpacity(opacity);
  look->SetColor(colours);
  look->SetInterpolationTypeToLinear();
  look->SetScalarOpacityUnitDistance(6.0 * image->GetSpacing()[0]);
  auto volume = vtkSmartPointer<vtkVolume>::New();
  volume->SetMapper(mapper);
  volume->SetProperty(look);
  add(volume, When::kAlways, motionOf(graph, motion));
  shapes_.back().body = true;
  ++clouds_;
  legend_.push_back({name, onScale(0.8), low, high});
  legend_.back().body = true;
}

void Shapes::addStreams(const Graph& graph, std::size_t field, Along along,
                        const std::string& name) {
  const VectorField& of = *graph.vector_fields[field];
  const std::string key = fmt::format("streams {} {}", of.id(), static_cast<int>(along));
  if (std::find(known_.begin(), known_.end(), key) != known_.end()) {
    legend_.push_back({name, onScale(0.8)});
    return;
  }
  known_.push_back(key);
  const auto image = sampled(of, along, kStreamPoints);
  const auto [low, high] = usual(*image);
  // Starts streamlines at random points where the vector is large, or the curl for vortices.
  const bool core = along == Along::kCurl;
  const int seeds = core ? 60 : 160;
  const double least = (core ? 0.5 : 0.1) * high;
  std::vector<Vec3> from;
  std::mt19937 random(7);  // NOLINT(cert-msc51-cpp): fixed, so that each run gives the same picture
  const auto* sizes = static_cast<float*>(image->GetPointData()->GetScalars()->GetVoidPointer(0));
  const auto count = static_cast<std::uint64_t>(image->GetNumberOfPoints());
  for (int i = 0; i < 500 * seeds && from.size() < static_cast<std::size_t>(seeds); ++i) {
    const auto at = static_cast<vtkIdType>(random() % count);
    if (sizes[at] > least) from.emplace_back(image->GetPoint(at));
  }
  std::vector<std::vector<Vec3>> lines(from.size());
  const double length = 0.35 * of.frame().bounds.size().maxCoeff();
  tbb::parallel_for(std::size_t{0}, from.size(),
                    [&](std::size_t i) { lines[i] = lineThrough(of, along, from[i], length); });
  auto points = vtkSmartPointer<vtkPoints>::New();
  auto cells = vtkSmartPointer<vtkCellArray>::New();
  auto values = vtkSmartPointer<vtkFloatArray>::New();
  FieldCache cache;
  of.reset(cache);
  for (const auto& line : lines) {
    if (line.size() < 2) continue;
    cells->InsertNextCell(static_cast<int>(line.size()));
    for (const Vec3& p : line) {
      cells->InsertCellPoint(points->InsertNextPoint(p.data()));
      values->InsertNextValue(static_cast<float>(vectorAt(of, along, p, cache).norm()));
    }
  }
  if (cells->GetNumberOfCells() == 0) {
    notes_.push_back(name + ": no streams: no strong " + (core ? "curl" : "vector") + " was found");
    return;
  }
  auto data = vtkSmartPointer<vtkPolyData>::New();
  data->SetPoints(points);
  data->SetLines(cells);
  data->GetPointData()->SetScalars(values);
  auto mapper = vtkSmartPointer<vtkPolyDataMapper>::New();
  mapper->SetInputData(data);
  auto table = vtkSmartPointer<vtkLookupTable>::New();
  constexpr int kColours = 64;
  table->SetNumberOfTableValues(kColours);
  for (int i = 0; i < kColours; ++i) {
    const Colour colour = onScale(static_cast<double>(i) / (kColours - 1));
    table->SetTableValue(i, colour[0], colour[1], colour[2]);
  }
  mapper->SetLookupTable(table);
  mapper->SetScalarRange(low, high);
  auto actor = vtkSmartPointer<vtkActor>::New();
  actor->SetMapper(mapper);
  actor->GetProperty()->SetLineWidth(core ? 3.0F : 1.5F);
  actor->GetProperty()->LightingOff();
  add(actor, When::kAlways, motionOf(graph, graph.vector_motions[field]));
  legend_.push_back({name, onScale(0.8), low, high});
}

void Shapes::addGuide(const GuideMode& guide, const MotionPtr& motion, const std::string& name) {
  const double size = bounds_.empty() ? 0.1 : bounds_.size().maxCoeff();
  vtkSmartPointer<vtkActor> actor;
  const Vec3& p = guide.position;
  const Vec3& q = guide.direction;
  if (guide.shape == PrimitiveKind::kPoint) {
    auto ball = vtkSmartPointer<vtkSphereSource>::New();
    ball->SetCenter(p.x(), p.y(), p.z());
    ball->SetRadius(0.01 * size);
    actor = actorOf(ball->GetOutputPort());
  } else if (guide.shape == PrimitiveKind::kLine) {
    auto line = vtkSmartPointer<vtkLineSource>::New();
    const Vec3 a = p - size * q;
    const Vec3 b = p + size * q;
    line->SetPoint1(a.x(), a.y(), a.z());
    line->SetPoint2(b.x(), b.y(), b.z());
    actor = actorOf(line->GetOutputPort());
  } else {
    auto disc = vtkSmartPointer<vtkRegularPolygonSource>::New();
    disc->SetNumberOfSides(48);
    disc->SetCenter(p.x(), p.y(), p.z());
    disc->SetNormal(q.x(), q.y(), q.z());
    disc->SetRadius(0.4 * size);
    disc->GeneratePolygonOff();
    actor = actorOf(disc->GetOutputPort());
  }
  const Colour colour{0.85, 0.85, 0.85};
  actor->GetProperty()->SetColor(colour[0], colour[1], colour[2]);
  actor->GetProperty()->SetLineWidth(2.0F);
  add(actor, When::kAlways, motion);
  legend_.push_back({name, colour});
}

void Shapes::addTo(vtkRenderer& solid, vtkRenderer& through) const {
  for (const Shape& shape : shapes_) {
    (shape.depths ? through : solid).AddViewProp(shape.prop);
    if (shape.depths) through.AddViewProp(shape.depths);
  }
}

void Shapes::detail(int step) {
  for (const Shape& shape : shapes_) {
    if (shape.when != When::kAlways || shape.body) {
      const bool asked =
          shape.when == When::kAlways || (shape.when == When::kCoarse) == (step == kCoarsest);
      const bool on = asked && (bodies_ || !shape.body);
      shape.prop->SetVisibility(on);
      if (shape.depths) shape.depths->SetVisibility(on);
    }
    if (auto* volume = vtkVolume::SafeDownCast(shape.prop)) {
      auto* mapper = static_cast<vtkFixedPointVolumeRayCastMapper*>(volume->GetMapper());
      mapper->SetImageSampleDistance(static_cast<float>(step));
    }
  }
}

void Shapes::showBodies(bool on) {
  bodies_ = on;
}

void Shapes::moveTo(double time) {
  for (const Shape& shape : shapes_) {
    if (!shape.motion) continue;
    if (shape.mesh != nullptr) {
      deform(*shape.mesh, *shape.rest, *shape.motion, time);
      continue;
    }
    // A deforming shape other than a mesh moves like its centre.
    const Pose pose = shape.motion->poseOf(shape.centre, time);
    auto matrix = vtkSmartPointer<vtkMatrix4x4>::New();
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) matrix->SetElement(i, j, pose.linear(i, j));
      matrix->SetElement(i, 3, pose.translate[i]);
    }
    shape.prop->SetUserMatrix(matrix);
  }
}

bool Shapes::moves() const noexcept {
  return std::any_of(shapes_.begin(), shapes_.end(), [](const Shape& s) { return !!s.motion; });
}

}  // namespace palpate::view
