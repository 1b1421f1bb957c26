#include <algorithm>
#include <filesystem>
#include <fstream>

#include <vtkPNGWriter.h>
#include <vtkUnsignedCharArray.h>
#include <vtkWindowToImageFilter.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/view/window.h"

namespace palpate::view {

Told ViewWindow::told() const {
  Told told;
  const auto vector = [](const std::array<double, 3>& a) {
    return cli::toJson(Vec3(a[0], a[1], a[2]));
  };
  told["tick"] = tick_.tick;
  told["time"] = tick_.time;
  told["probe"] = vector(tick_.probe);
  told["proxy"] = vector(tick_.proxy);
  told["force"] = vector(tick_.force);
  const auto pixel = [&](const Vec3& p) {
    const auto at = onScreen(p);
    return Told{at[0], at[1]};
  };
  told["hand"] = cli::toJson(hand_);
  told["size"] = {window_->GetSize()[0], window_->GetSize()[1]};
  told["pixels"]["probe"] = pixel({tick_.probe[0], tick_.probe[1], tick_.probe[2]});
  told["pixels"]["proxy"] = pixel({tick_.proxy[0], tick_.proxy[1], tick_.proxy[2]});
  told["pixels"]["tip"] = pixel(overlay_->tip());
  told["pixels"]["centre"] = pixel(shapes_->bounds().centre());
  const auto area = [this](vtkTextActor& text) {
    const Area its = areaOf(text);
    return Told{its.left, its.low, its.right, its.high};
  };
  told["newtons"] = area(*newtons_);
  told["words"] = newtons_->GetInput() == nullptr ? "" : newtons_->GetInput();
  told["help"] = help_->GetVisibility() == 0 ? Told::array() : area(*help_);
  told["bars"] = Told::array();
  for (const Bar& bar : bars_) {
    told["bars"].push_back({{"name", bar.name},
                            {"load", bar.load},
                            {"strength", bar.strength},
                            {"state", cli::wordFor(bar.hold)},
                            {"dial", bar.felt.factor},
                            {"words", wordsOf(bar)}});
  }
  told["status"] = statusOf(tick_, options_.reengage);
  told["stalled"] = stalled_;
  told["late_ticks"] = tick_.late_ticks;
  told["rows"] = rows_.size();
  told["frames"] = frames_;
  told["frames_reading"] = frames_reading_;
  told["coarse"] = drawn_ > detail_;
  told["detail"] = drawn_;
  std::vector<double> costs = frame_costs_;
  std::sort(costs.begin(), costs.end());
  const auto of = [&costs](double share) {
    if (costs.empty()) return 0.0;
    return 1e3 * costs[static_cast<std::size_t>(share * static_cast<double>(costs.size() - 1))];
  };
  told["frame_cpu_ms"] = {{"p50", of(0.5)}, {"p90", of(0.9)}, {"p99", of(0.99)}};
  for (const auto& [name, cost] :
       {std::pair{"coarse_ms", coarse_cost_}, std::pair{"refined_ms", refined_cost_}}) {
    told[name] = {{"cpu", 1e3 * cost.cpu}, {"wall", 1e3 * cost.wall}};
  }
  told["sliced"] = sliced_ ? shapes_->volumes()[*sliced_].name : "";
  told["legend"] = Told::array();
  for (const auto& entry : legend()) told["legend"].push_back(entry.name);
  told["letters"] = Told::object();
  for (std::size_t i = 0; i < letters_.size(); ++i) {
    const auto& [letter, at] = shapes_->letters()[i];
    if (letters_[i]->GetVisibility() != 0) told["letters"][letter] = pixel(at);
  }
  told["notes"] = notes();
  return told;
}

void ViewWindow::draw(const std::string& file) {
  refresh();
  stalled_ = false;
  over_ = false;
  if (!options_.slice.empty()) slice();
  drawSlices();
  shapes_->detail(1);
  showLetters();
  if (shapes_->moves()) shapes_->moveTo(tick_.time);
  showHand();
  clip();
  help_->VisibilityOff();
  fillPanel();
  drawFrame();
  write(file, false);
}

void ViewWindow::write(const std::string& picture, bool rendered) {
  auto image = vtkSmartPointer<vtkWindowToImageFilter>::New();
  image->SetInput(window_);
  image->ReadFrontBufferOff();
  image->SetShouldRerender(rendered ? 0 : 1);
  auto writer = vtkSmartPointer<vtkPNGWriter>::New();
  writer->SetInputConnection(image->GetOutputPort());
  writer->WriteToMemoryOn();
  writer->Write();
  vtkUnsignedCharArray* bytes = writer->GetResult();
  const auto* all = reinterpret_cast<const char*>(bytes->GetPointer(0));
  // Inserts the PNG chunk pHYs after the header: 300 dpi (11811 pixels per metre).
  constexpr std::streamsize kHeader = 33;
  constexpr unsigned char kPrint[] = {0,    0, 0, 9,    'p',  'H', 'Y',  's',  0,    0,   0x2e,
                                      0x23, 0, 0, 0x2e, 0x23, 1,   0x78, 0xa5, 0x3f, 0x76};
  std::ofstream file(picture, std::ios::binary);
  file.write(all, kHeader);
  file.write(reinterpret_cast<const char*>(kPrint), sizeof kPrint);
  file.write(all + kHeader, bytes->GetNumberOfValues() - kHeader);
  file.close();
  if (!file) {
    throw Error(picture, "the picture cannot be written",
                "check the folder and the free disk space");
  }
}

void ViewWindow::tell(const std::string& shot, const std::string& told_file) {
  // Renames a file when it is complete, so that a reader never finds an incomplete file.
  if (!shot.empty()) {
    write(shot + ".partial", true);
    std::filesystem::rename(shot + ".partial", shot);
  }
  const std::string partial = told_file + ".partial";
  std::ofstream(partial) << told().dump(2) << "\n";
  std::filesystem::rename(partial, told_file);
}

}  // namespace palpate::view
