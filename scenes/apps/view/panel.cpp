#include "palpate/scenes/apps/view/panel.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <fmt/format.h>
#include <vtkCellData.h>
#include <vtkPolyDataMapper2D.h>
#include <vtkProperty2D.h>
#include <vtkTextProperty.h>

#include "palpate/engine/safety/safety.h"
#include "palpate/scenes/apps/common/say.h"
#include "palpate/scenes/apps/view/overlay.h"

namespace palpate::view {
namespace {

constexpr Colour kInk{0.92, 0.92, 0.92};
constexpr Colour kFaint{0.62, 0.64, 0.67};
constexpr Colour kTrack{0.22, 0.24, 0.27};
constexpr double kMargin = 14.0;
constexpr double kInner = Panel::kWidth - 2.0 * kMargin;

/// Formats a number without an exponent. Magnitudes below 0.001 become 0.
std::string brief(double value) {
  const double size = std::abs(value);
  return size < 1e-3 || size >= 100.0 ? fmt::format("{:.0f}", value) : fmt::format("{:.3g}", value);
}

/// Breaks a text at its spaces into lines of at most `width` letters. A longer word is one line.
std::vector<std::string> wrapped(const std::string& text, std::size_t width) {
  std::vector<std::string> lines(1);
  std::istringstream words(text);
  for (std::string word; words >> word;) {
    std::string& line = lines.back();
    if (line.empty()) {
      line = word;
    } else if (line.size() + 1 + word.size() <= width) {
      line.append(" ").append(word);
    } else {
      lines.push_back(word);
    }
  }
  return lines;
}

const char* adviceFor(StepStatus status) {
  switch (status) {
    case StepStatus::kConverged:
    case StepStatus::kFault:
      break;
    case StepStatus::kHairpin:
      return "the stream turns back here: reduce the strength, or move the hand nearer";
    case StepStatus::kSubstepLimit:
      return "the proxy has not reached the balance: move the hand slower, or raise max_substeps";
    case StepStatus::kIterationLimit:
      return "the balance is not exact: its error bound is in the line above";
    case StepStatus::kDropped:
      return "the tick has too many primitives: use fewer modes";
  }
  return "";
}

}  // namespace

std::vector<Bar> barsOf(const LiveTick& tick, const LiveScene& scene, const LiveWishes& wishes) {
  std::vector<Bar> bars(std::min<std::size_t>(scene.mode_count, kLiveModes));
  std::vector<std::vector<cli::Load>> loads(bars.size());
  for (std::size_t i = 0; i < bars.size(); ++i) {
    const LiveScene::Mode& mode = scene.modes[i];
    bars[i].name = cli::Legible(mode.name.data(), 40).text();
    bars[i].felt = mode.dial;
    bars[i].wish = wishes.dials[i].factor;
  }
  if (tick.scene != scene.id) return bars;
  const std::size_t count = std::min<std::size_t>(tick.primitive_count, kLivePrimitives);
  for (std::size_t i = 0; i < count; ++i) {
    const LivePrimitive& primitive = tick.primitives[i];
    if (primitive.mode >= bars.size()) continue;
    const cli::Load load = loadIn(tick, primitive);
    loads[primitive.mode].push_back(load);
    if (load.friction && load.hold == cli::Hold::kYields) bars[primitive.mode].slips = true;
  }
  for (std::size_t i = 0; i < bars.size(); ++i) {
    const std::vector<cli::Load> bearers = cli::bearersOf(loads[i]);
    bars[i].load = cli::totalOf(bearers).norm();
    for (const cli::Load& load : bearers) {
      bars[i].strength = std::max(bars[i].strength, load.primitive.strength);
    }
    bars[i].hold = cli::holdOf(loads[i]);
  }
  return bars;
}

std::string wordsOf(const Bar& bar) {
  const bool felt = bar.wish == bar.felt.factor;
  std::string words = bar.name;
  if (bar.wish == 0.0F) {
    words += ": off";
  } else if (bar.felt.factor == 0.0F) {
    words += ": on";
  } else if (bar.strength > 0.0) {
    words += fmt::format(": {} {:.3g} of {:.3g} N{}", cli::wordFor(bar.hold), bar.load,
                         bar.strength, bar.slips ? ", slips" : "");
  } else {
    words += ": idle";
  }
  if (bar.wish != 0.0F && bar.wish != 1.0F) words += fmt::format("  x{:.2f}", bar.wish);
  return felt ? words : words + " (not yet)";
}

std::vector<std::string> statusOf(const LiveTick& tick, double reengage) {
  if (tick.tick == 0) return {"waiting for the loop"};
  std::vector<std::string> lines;
  if (tick.fault != Fault::kNone) {
    lines.push_back(fmt::format("FORCE OFF: {}", wordsFor(tick.fault)));
    lines.emplace_back(remedyFor(tick.fault));
    if (tick.fault == Fault::kLate && reengage > 0.0) {
      lines.push_back(fmt::format(
          "unless another fault or a pause over {} s occurs, the force returns {} s after "
          "the last late tick, at most {} times a minute",
          Reengagement::kPause, reengage, Reengagement::kMost));
    }
    lines.emplace_back("press Enter to restore the force");
    return lines;
  }
  constexpr double kFinest = 1e-3;  // [um]
  lines.push_back(fmt::format("{}, within {} um", wordFor(tick.status),
                              brief(std::max(kFinest, 1e6 * tick.error_bound))));
  if (*adviceFor(tick.status) != '\0') lines.emplace_back(adviceFor(tick.status));
  if (tick.limited) {
    lines.emplace_back("the gate reduced the force: a limit, an engagement or the energy tank");
  }
  if (tick.late_ticks > 0) {
    lines.push_back(fmt::format("{} late tick{}", tick.late_ticks, tick.late_ticks > 1 ? "s" : ""));
  }
  return lines;
}

Panel::Panel(vtkRenderer& renderer, double scale)
    : renderer_(renderer), scale_(scale), quads_(drawing()), lines_(drawing()) {
  quads_.data->SetPolys(quads_.cells);
  lines_.data->SetLines(lines_.cells);
}

Panel::Drawing Panel::drawing() const {
  Drawing drawing;
  drawing.points = vtkSmartPointer<vtkPoints>::New();
  drawing.cells = vtkSmartPointer<vtkCellArray>::New();
  drawing.colours = vtkSmartPointer<vtkUnsignedCharArray>::New();
  drawing.colours->SetNumberOfComponents(3);
  drawing.data = vtkSmartPointer<vtkPolyData>::New();
  drawing.data->SetPoints(drawing.points);
  drawing.data->GetCellData()->SetScalars(drawing.colours);
  auto mapper = vtkSmartPointer<vtkPolyDataMapper2D>::New();
  mapper->SetInputData(drawing.data);
  auto actor = vtkSmartPointer<vtkActor2D>::New();
  actor->SetMapper(mapper);
  actor->GetProperty()->SetLineWidth(static_cast<float>(1.5 * scale_));
  renderer_.AddActor2D(actor);
  return drawing;
}

void Panel::quad(double x0, double y0, double x1, double y1, const Colour& colour) {
  const auto corner = [this](double x, double y) {
    return quads_.points->InsertNextPoint(scale_ * x, scale_ * y, 0.0);
  };
  const vtkIdType corners[4] = {corner(x0, y0), corner(x1, y0), corner(x1, y1), corner(x0, y1)};
  quads_.cells->InsertNextCell(4, corners);
  quads_.colours->InsertNextTuple3(255 * colour[0], 255 * colour[1], 255 * colour[2]);
}

void Panel::line(const std::vector<std::array<double, 2>>& points, const Colour& colour) {
  lines_.cells->InsertNextCell(static_cast<int>(points.size()));
  for (const auto& p : points) {
    lines_.cells->InsertCellPoint(
        lines_.points->InsertNextPoint(scale_ * p[0], scale_ * p[1], 0.0));
  }
  lines_.colours->InsertNextTuple3(255 * colour[0], 255 * colour[1], 255 * colour[2]);
}

void Panel::text(double x, double y, const std::string& words, int size, const Colour& colour) {
  if (used_ == texts_.size()) {
    texts_.push_back(vtkSmartPointer<vtkTextActor>::New());
    renderer_.AddActor2D(texts_.back());
  }
  vtkTextActor& actor = *texts_[used_++];
  // VTK renders a text again only if it has changed.
  actor.SetInput(words.c_str());
  actor.SetPosition(scale_ * x, scale_ * y);
  actor.GetTextProperty()->SetFontSize(static_cast<int>(scale_ * size));
  actor.GetTextProperty()->SetColor(colour[0], colour[1], colour[2]);
  actor.VisibilityOn();
}

double Panel::strip(double top, const std::string& title, const std::vector<LiveRow>& rows,
                    float LiveRow::*value, double scale, const char* unit, const Colour& colour) {
  constexpr double kHeight = 44.0;
  constexpr double kTitle = 18.0;
  constexpr int kColumns = 136;
  const double bottom = top - kTitle - kHeight;
  quad(kMargin, bottom, kMargin + kInner, bottom + kHeight, kTrack);
  double most = 0.0;
  for (const LiveRow& row : rows) most = std::max(most, scale * static_cast<double>(row.*value));
  text(kMargin, top - kTitle + 4.0,
       fmt::format("{}: {} {}, at most {}", title,
                   brief(rows.empty() ? 0.0 : scale * static_cast<double>(rows.back().*value)),
                   unit, brief(most)),
       12, kFaint);
  if (rows.size() < 2) return bottom - 10.0;
  // Draws the highest value in each column of the plot, so that every peak is visible.
  std::array<double, kColumns> columns{};
  std::array<bool, kColumns> there{};
  const double first = rows.front().time;
  const double span = std::max(1e-9, rows.back().time - first);
  for (const LiveRow& row : rows) {
    const auto at = static_cast<std::size_t>(
        std::clamp((row.time - first) / span * (kColumns - 1), 0.0, kColumns - 1.0));
    columns[at] = std::max(columns[at], scale * static_cast<double>(row.*value));
    there[at] = true;
  }
  std::vector<std::array<double, 2>> points;
  for (std::size_t i = 0; i < kColumns; ++i) {
    if (!there[i]) continue;
    points.push_back({kMargin + kInner * static_cast<double>(i) / (kColumns - 1),
                      bottom + 2.0 + (kHeight - 4.0) * columns[i] / std::max(most, 1e-12)});
  }
  line(points, colour);
  return bottom - 10.0;
}

void Panel::show(const Content& content, double height) {
  for (const Drawing* drawing : {&quads_, &lines_}) {
    drawing->points->Reset();
    drawing->cells->Reset();
    drawing->colours->Reset();
  }
  used_ = 0;

  quad(0.0, 0.0, kWidth, height, kDark);
  double y = height - 26.0;
  for (const std::string& words : content.status) {
    const bool first = &words == &content.status.front();
    constexpr std::size_t kLetters = 42;  // characters in a line of the panel
    for (std::size_t at = 0; at < words.size();) {
      std::size_t end = std::min(words.size(), at + kLetters);
      if (end < words.size()) {
        const std::size_t space = words.rfind(' ', end);
        if (space != std::string::npos && space > at) end = space;
      }
      text(kMargin, y, words.substr(at, end - at), 13, first ? kInk : kFaint);
      y -= 18.0;
      at = end + (end < words.size() && words[end] == ' ' ? 1 : 0);
    }
  }
  y -= 8.0;
  for (std::size_t i = 0; i < std::min(content.bars.size(), kMostBars); ++i) {
    const Bar& bar = content.bars[i];
    text(kMargin, y, fmt::format("{} {}", i + 1, wordsOf(bar)), 13,
         content.selected == bar.felt.mode ? kInk : kFaint);
    y -= 12.0;
    quad(kMargin, y, kMargin + kInner, y + 7.0, kTrack);
    const double share = bar.strength > 0.0 ? std::min(1.0, bar.load / bar.strength) : 0.0;
    if (bar.felt.factor != 0.0F && share > 0.0)
      quad(kMargin, y, kMargin + share * kInner, y + 7.0, colourOf(bar.hold));
    y -= 22.0;
  }
  y -= 2.0;
  y = strip(y, "force", content.rows, &LiveRow::force, 1.0, "N", kForce);
  y = strip(y, "hand to proxy", content.rows, &LiveRow::apart, 1e3, "mm", kProxy);
  y = strip(y, "tick", content.rows, &LiveRow::took, 1e6, "us", kIdle);
  y -= 8.0;
  for (const Shapes::Entry& entry : content.legend) {
    if (y < 60.0) break;
    if (entry.high > entry.low) {
      constexpr int kSteps = 24;
      constexpr double kWide = 60.0;
      for (int i = 0; i < kSteps; ++i) {
        const double share = (i + 0.5) / kSteps;
        const Colour colour = entry.grey ? Colour{share, share, share} : onScale(share);
        quad(kMargin + kWide * i / kSteps, y, kMargin + kWide * (i + 1) / kSteps, y + 10.0, colour);
      }
      text(kMargin + kWide + 8.0, y - 1.0, entry.name, 12, kFaint);
      y -= 16.0;
      text(kMargin, y - 1.0,
           fmt::format("{:.4g} to {:.4g}, in the file's unit", entry.low, entry.high), 12, kFaint);
    } else {
      quad(kMargin, y, kMargin + 10.0, y + 10.0, entry.colour);
      text(kMargin + 18.0, y - 1.0, entry.name, 12, kFaint);
    }
    y -= 18.0;
  }
  double low = 12.0;
  for (auto note = content.notes.rbegin(); note != content.notes.rend(); ++note) {
    const std::vector<std::string> lines = wrapped(*note, 48);
    for (auto line = lines.rbegin(); line != lines.rend() && low <= y; ++line) {
      text(kMargin, low, *line, 11, kFaint);
      low += 15.0;
    }
  }
  for (std::size_t i = used_; i < texts_.size(); ++i) texts_[i]->VisibilityOff();

  for (const Drawing* drawing : {&quads_, &lines_}) {
    drawing->points->Modified();
    drawing->cells->Modified();
    drawing->colours->Modified();
    drawing->data->Modified();
  }
}

}  // namespace palpate::view
