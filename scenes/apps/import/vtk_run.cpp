#include "palpate/scenes/apps/import/vtk_run.h"

#include <cctype>
#include <functional>
#include <string_view>

#include <fmt/format.h>
#include <vtkCallbackCommand.h>
#include <vtkCommand.h>
#include <vtkLogger.h>
#include <vtkNew.h>
#include <vtkOutputWindow.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

/// Returns the part "what" of VTK's message "ERROR: In FILE, line N\nvtkClass (0x...): what\n\n".
std::string shortened(const std::string& text) {
  std::string out = text;
  if (out.rfind("ERROR: In ", 0) == 0 || out.rfind("Warning: In ", 0) == 0 ||
      out.rfind("Generic", 0) == 0) {
    const auto colon = out.find("): ");
    const auto line = out.find('\n');
    if (colon != std::string::npos) {
      out.erase(0, colon + 3);
    } else if (line != std::string::npos) {
      out.erase(0, line + 1);
    }
  }
  while (!out.empty() && (std::isspace(static_cast<unsigned char>(out.back())) != 0 ||
                          out.back() == '.' || out.back() == '!')) {
    out.pop_back();
  }
  // Replaces all characters other than printable ASCII: the message may quote a damaged file.
  for (char& c : out) {
    if (c < 0x20 || c > 0x7e) c = '?';
  }
  constexpr std::size_t kLongest = 160;
  if (out.size() > kLongest) {
    out.resize(kLongest);
    out += " ...";
  }
  return out;
}

/// Receives VTK's messages, including those of nested readers, to which no observer can be added.
class Ear final : public vtkOutputWindow {
 public:
  static Ear* New() {
    auto* ear = new Ear;  // VTK counts the references to the object
    ear->InitializeObjectBase();
    return ear;
  }

  void DisplayErrorText(const char* text) override {
    if (first_.empty()) first_ = text == nullptr ? "unknown error" : text;
  }
  void DisplayText(const char* /*text*/) override {}
  void DisplayWarningText(const char* text) override { hearWarning(text); }
  void DisplayGenericWarningText(const char* text) override { hearWarning(text); }
  void DisplayDebugText(const char* /*text*/) override {}

  [[nodiscard]] const std::string& heard() const { return first_; }

 private:
  /// Treats a warning as an error if the result may be wrong.
  void hearWarning(const char* text) {
    if (text == nullptr) return;
    for (const std::string_view bad : {"rror reading", "higher than this reader supports"}) {
      if (std::string_view(text).find(bad) != std::string_view::npos) DisplayErrorText(text);
    }
  }

  std::string first_;
};

/// Sends VTK's messages to an Ear, as long as this object exists.
class Listening {
 public:
  Listening() : before_(vtkOutputWindow::GetInstance()) {
    vtkOutputWindow::SetInstance(ear_);
    vtkLogger::SetStderrVerbosity(vtkLogger::VERBOSITY_OFF);
  }
  Listening(const Listening&) = delete;
  Listening& operator=(const Listening&) = delete;
  ~Listening() { vtkOutputWindow::SetInstance(before_); }

  [[nodiscard]] const std::string& heard() const { return ear_->heard(); }

 private:
  vtkNew<Ear> ear_;
  vtkSmartPointer<vtkOutputWindow> before_;
};

void tell(vtkObject* caller, unsigned long /*event*/, void* client, void* /*data*/) {
  const auto& progress = *static_cast<const Progress*>(client);
  if (auto* algorithm = vtkAlgorithm::SafeDownCast(caller)) progress(algorithm->GetProgress());
}

}  // namespace

void runQuietly(const std::function<void()>& task) {
  const Listening listening;
  task();
}

void run(vtkAlgorithm* algorithm, const std::string& what, const Progress& progress,
         const std::string& remedy) {
  vtkNew<vtkCallbackCommand> command;
  command->SetClientData(const_cast<Progress*>(&progress));
  command->SetCallback(tell);
  const Listening listening;
  const unsigned long tag =
      progress ? algorithm->AddObserver(vtkCommand::ProgressEvent, command) : 0;
  algorithm->Update();
  if (progress) algorithm->RemoveObserver(tag);
  if (listening.heard().empty() && algorithm->GetErrorCode() == 0) return;
  const std::string failure = algorithm->GetNumberOfInputPorts() == 0
                                  ? "VTK cannot read the file"
                                  : fmt::format("VTK has read the file, but {} cannot process it",
                                                algorithm->GetClassName());
  const std::string said = shortened(listening.heard());
  throw VolumeError(what,
                    said.empty()
                        ? fmt::format("{} (error code {})", failure,
                                      static_cast<unsigned long>(algorithm->GetErrorCode()))
                        : fmt::format("{} ({})", failure, said),
                    remedy);
}

}  // namespace palpate::importer
